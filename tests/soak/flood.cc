// Sends hostile and valid messages beside a replay, none of which may change the map: damaged ones
// on the scan and pose channels, repeats of what was just heard, late ones, and others' traffic.
#include <arpa/inet.h>
#include <fmt/format.h>
#include <sys/socket.h>

#include <CLI/CLI.hpp>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/wire/encode.h"
#include "lib/wire/lcm_bus.h"
#include "lib/wire/sensor_messages.h"
#include "tests/soak/bus_group.h"
#include "tests/support/raw_message.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;
using Random = std::mt19937_64;
using Bytes = std::vector<uint8_t>;

constexpr uint32_t kWholeMagic = 0x4c433032;
constexpr uint32_t kFragmentMagic = 0x4c433033;
constexpr size_t kUtimeAt = 8;  // after the fingerprint, in all types
constexpr size_t kCountAt = 16;
constexpr size_t kPositionAt = 16;
constexpr size_t kOrientationAt = 16 + 6 * 8;

struct Flags {
  std::string scan = "LASER";
  std::string pose = "POSE";
  double seconds = 60;
  double rate = 20'000;
  uint64_t seed = 1;
};

template <typename Integer>
void Put(Bytes& bytes, size_t at, Integer value) {
  for (size_t k = 0; k < sizeof(value) && at + k < bytes.size(); ++k) {
    bytes[at + k] = static_cast<uint8_t>(static_cast<std::make_unsigned_t<Integer>>(value) >>
                                         (8 * (sizeof(value) - 1 - k)));
  }
}

void PutDouble(Bytes& bytes, size_t at, double value) {
  Put(bytes, at, std::bit_cast<uint64_t>(value));
}

// The newest genuine message of a channel: what the flood itself sends is never newer.
class Newest {
 public:
  void Take(Utime utime, absl::Span<const uint8_t> message) {
    MutexLock lock(mutex_);
    const bool is_first = bytes_.empty();
    if (!is_first && utime <= utime_) return;
    utime_ = utime;
    bytes_.assign(message.begin(), message.end());
    heard_ = Clock::now();
  }

  struct Copy {
    Utime utime{0};
    Bytes bytes;
    bool is_fresh = false;  // else what is late by it might be late by a jump in time
  };
  Copy Get() const {
    MutexLock lock(mutex_);
    return {utime_, bytes_, Clock::now() - heard_ < milliseconds(200)};
  }

 private:
  mutable Mutex mutex_;
  Utime utime_ ABSL_GUARDED_BY(mutex_){0};
  Bytes bytes_ ABSL_GUARDED_BY(mutex_);
  Clock::time_point heard_ ABSL_GUARDED_BY(mutex_);
};

struct Message {
  std::string channel;  // empty: the bytes are a datagram
  Bytes bytes;
};

// Makes the messages, from the newest genuine scan and pose.
class Source {
 public:
  Source(const Flags& flags, const Newest& scan, const Newest& pose)
      : flags_(flags), newest_scan_(scan), newest_pose_(pose), random_(flags.seed) {}

  static const std::vector<std::pair<const char*, Message (Source::*)()>>& Kinds() {
    static const std::vector<std::pair<const char*, Message (Source::*)()>> kinds = {
        {"random_bytes", &Source::RandomBytes},   {"wrong_fingerprint", &Source::WrongFingerprint},
        {"truncated", &Source::Truncated},        {"trailing_bytes", &Source::TrailingBytes},
        {"wrong_count", &Source::WrongCount},     {"wrong_type", &Source::WrongType},
        {"wrong_time", &Source::WrongTime},       {"no_pose", &Source::NoPose},
        {"endless_name", &Source::EndlessName},   {"broken_fragment", &Source::BrokenFragment},
        {"repeated_scan", &Source::RepeatedScan}, {"repeated_pose", &Source::RepeatedPose},
        {"late_scan", &Source::LateScan},         {"late_pose", &Source::LatePose},
        {"other_scan", &Source::OtherScan},       {"other_pose", &Source::OtherPose},
        {"other_text", &Source::OtherText},       {"other_large", &Source::OtherLarge},
    };
    return kinds;
  }

  // The kind of the next message.
  size_t NextKind() { return Index(Kinds().size()); }

 private:
  size_t Index(size_t n) { return std::uniform_int_distribution<size_t>(0, n - 1)(random_); }

  Bytes Noise(size_t size) {
    Bytes bytes(size);
    for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random_());
    return bytes;
  }
  Message Scan() { return {flags_.scan, newest_scan_.Get().bytes}; }
  Message Pose() { return {flags_.pose, newest_pose_.Get().bytes}; }
  Message ScanOrPose() { return Index(2) == 0 ? Scan() : Pose(); }

  Message RandomBytes() { return {Index(2) == 0 ? flags_.scan : flags_.pose, Noise(Index(600))}; }
  Message WrongFingerprint() {
    Message message = ScanOrPose();
    message.bytes[Index(8)] ^= static_cast<uint8_t>(1 << Index(8));
    return message;
  }
  Message Truncated() {
    Message message = ScanOrPose();
    message.bytes.resize(Index(message.bytes.size()));
    return message;
  }
  Message TrailingBytes() {
    Message message = ScanOrPose();
    const Bytes more = Noise(1 + Index(50));
    message.bytes.insert(message.bytes.end(), more.begin(), more.end());
    return message;
  }
  Message WrongCount() {
    constexpr int32_t kCounts[] = {-1,
                                   0,
                                   1,
                                   2'000'000'000,
                                   std::numeric_limits<int32_t>::max(),
                                   std::numeric_limits<int32_t>::min()};
    Message message = Scan();
    Put(message.bytes, kCountAt, kCounts[Index(std::size(kCounts))]);
    return message;
  }
  Message WrongType() {
    return Index(2) == 0 ? Message{flags_.scan, Pose().bytes} : Message{flags_.pose, Scan().bytes};
  }
  Message WrongTime() {
    Message message = ScanOrPose();
    Put(message.bytes, kUtimeAt, Index(2) == 0 ? int64_t{-1} : std::numeric_limits<int64_t>::max());
    return message;
  }
  Message NoPose() {
    Message message = Pose();
    switch (Index(4)) {
      case 0:
        PutDouble(message.bytes, kPositionAt, std::nan(""));
        break;
      case 1:
        PutDouble(message.bytes, kPositionAt + 8, std::numeric_limits<double>::infinity());
        break;
      case 2:
        PutDouble(message.bytes, kPositionAt, 1e30);
        break;
      default:
        PutDouble(message.bytes, kOrientationAt, 2);
    }
    return message;
  }

  // Where another process sends datagrams, bytes of them may be left behind this one's end.
  Message EndlessName() {
    Bytes datagram(8);
    Put(datagram, 0, kWholeMagic);
    datagram.insert(datagram.end(), flags_.scan.begin(), flags_.scan.end());
    return {"", std::move(datagram)};
  }
  Message BrokenFragment() {
    constexpr uint32_t kPlaces[] = {0, 1, 5000, 1 << 28, 0xffff'ff00, 0xffff'ffff};
    Bytes datagram(20);
    Put(datagram, 0, kFragmentMagic);
    Put(datagram, 4, static_cast<uint32_t>(Index(3)));
    Put(datagram, 8, Index(2) == 0 ? uint32_t{10'000} : uint32_t{250'000'000});
    Put(datagram, 12, kPlaces[Index(std::size(kPlaces))]);
    Put(datagram, 16, static_cast<uint16_t>(Index(3)));
    Put(datagram, 18, static_cast<uint16_t>(Index(4)));
    datagram.insert(datagram.end(), flags_.scan.begin(), flags_.scan.end());
    if (Index(2) == 0) datagram.resize(500);  // and the name ends
    return {"", std::move(datagram)};
  }

  Message RepeatedScan() { return Scan(); }
  Message RepeatedPose() { return Pose(); }
  // Older than what is mapped, and not by so much that it is a jump in time.
  Message Late(const std::string& channel, Newest::Copy newest) {
    if (newest.is_fresh) {
      const milliseconds lateness(300 + Index(300));
      Put(newest.bytes, kUtimeAt, std::max<int64_t>(0, (newest.utime - lateness).count()));
    }
    return {channel, std::move(newest.bytes)};
  }
  Message LateScan() {
    Message message = Late(flags_.scan, newest_scan_.Get());
    constexpr float kRanges[] = {std::numeric_limits<float>::quiet_NaN(),
                                 std::numeric_limits<float>::infinity(), -1, 1};
    for (size_t at = kCountAt + 4; at + 20 < message.bytes.size(); at += 4) {
      Put(message.bytes, at, std::bit_cast<uint32_t>(kRanges[Index(std::size(kRanges))]));
    }
    return message;
  }
  Message LatePose() {
    Message message = Late(flags_.pose, newest_pose_.Get());
    PutDouble(message.bytes, kPositionAt, 100);
    return message;
  }

  Message OtherScan() { return {flags_.scan + "_REAR", Scan().bytes}; }
  Message OtherPose() { return {"ODOMETRY", Pose().bytes}; }
  Message OtherText() { return {"LCM_SELF_TEST", Noise(13)}; }
  Message OtherLarge() { return {"CAMERA", Bytes(Index(100) == 0 ? 200'000 : 1000)}; }

  const Flags& flags_;
  const Newest& newest_scan_;
  const Newest& newest_pose_;
  Random random_;
};

// Sends datagrams to the group of LCM_DEFAULT_URL.
class DatagramSender {
 public:
  static absl::StatusOr<DatagramSender> Open() {
    DatagramSender sender;
    SPLINEMAP_ASSIGN_OR_RETURN(sender.group_, BusGroup());
    const int ttl = 0;
    setsockopt(sender.fd_, IPPROTO_IP, IP_MULTICAST_TTL, &ttl, sizeof(ttl));
    return sender;
  }

  void Send(const Bytes& bytes) const {
    sendto(fd_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&group_),
           sizeof(group_));
  }

 private:
  int fd_ = socket(AF_INET, SOCK_DGRAM, 0);  // until the program ends
  sockaddr_in group_{};
};

absl::Status Run(const Flags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const DatagramSender datagrams, DatagramSender::Open());
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> ears, LcmBus::Open(""));
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> mouth, LcmBus::Open(""));
  Newest scan;
  Newest pose;
  ears->Subscribe(flags.scan, [&](const std::string&, absl::Span<const uint8_t> message) {
    if (const auto readings = DecodeScan(message); readings.ok()) {
      scan.Take(readings->utime, message);
    }
  });
  ears->Subscribe(flags.pose, [&](const std::string&, absl::Span<const uint8_t> message) {
    if (const auto heard = DecodePose(message); heard.ok()) pose.Take(heard->utime, message);
  });
  const std::jthread hearing([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) ears->Handle(milliseconds(50));
  });
  const auto deadline = Clock::now() + std::chrono::seconds(20);
  while (scan.Get().bytes.empty() || pose.Get().bytes.empty()) {
    if (Clock::now() > deadline) return Unavailable("no scans and poses within 20 s");
    std::this_thread::sleep_for(milliseconds(10));
  }

  Source source(flags, scan, pose);
  std::vector<int64_t> sent(Source::Kinds().size());
  int64_t total = 0;
  int64_t inputs = 0;
  const auto begin = Clock::now();
  const std::chrono::duration<double> duration(flags.seconds);
  for (auto now = begin; now - begin < duration; now = Clock::now()) {
    const auto due =
        static_cast<int64_t>(std::chrono::duration<double>(now - begin).count() * flags.rate);
    for (; total < due; ++total) {
      const size_t kind = source.NextKind();
      const Message message = (source.*Source::Kinds()[kind].second)();
      if (message.channel.empty()) {
        datagrams.Send(message.bytes);
      } else {
        mouth->Publish(message.channel, RawMessage{message.bytes});
      }
      ++sent[kind];
      inputs += message.channel == flags.scan || message.channel == flags.pose;
    }
    std::this_thread::sleep_for(milliseconds(1));
  }
  const double took_s = std::chrono::duration<double>(Clock::now() - begin).count();
  std::string kinds;
  for (size_t k = 0; k < sent.size(); ++k) {
    kinds += fmt::format("{}\"{}\": {}", k == 0 ? "" : ", ", Source::Kinds()[k].first, sent[k]);
  }
  fmt::print("{{\"sent\": {}, \"sent_to_daemon\": {}, \"seconds\": {:.2f}, \"kinds\": {{{}}}}}\n",
             total, inputs, took_s, kinds);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("flood: sends messages beside a replay that must not change the map");
  Flags flags;
  app.add_option("--scan", flags.scan, "Channel of the scans: bot_core.planar_lidar_t");
  app.add_option("--pose", flags.pose, "Channel of the poses: bot_core.pose_t");
  app.add_option("--seconds", flags.seconds, "How long");
  app.add_option("--rate", flags.rate, "Messages a second");
  app.add_option("--seed", flags.seed, "Of the choice of messages");
  CLI11_PARSE(app, argc, argv);
  if (absl::Status status = Run(flags); !status.ok()) {
    fmt::print(stderr, "flood: {}\n", ErrorText(status));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
