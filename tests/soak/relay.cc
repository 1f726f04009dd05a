// A bad link between two LCM buses: takes the datagrams of splinemap's channels from the group in
// this network namespace into the same group in another one, and back, and loses, delays, reorders
// and doubles them. Prints what it heard on this side as a JSON line, twice a second and at its
// end.
#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sched.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "lcmtypes/splinemap/layer_pull_t.hpp"
#include "lcmtypes/splinemap/layer_scans_t.hpp"
#include "lcmtypes/splinemap/layer_updates_t.hpp"
#include "lcmtypes/splinemap/scan_pull_t.hpp"
#include "lcmtypes/splinemap/scan_record_t.hpp"
#include "lcmtypes/splinemap/tile_update_t.hpp"
#include "lib/base/clock.h"
#include "lib/base/status.h"
#include "lib/wire/decode.h"
#include "tests/soak/bus_group.h"

namespace splinemap {
namespace {

using Seconds = std::chrono::duration<double>;
using Bytes = absl::Span<const uint8_t>;

struct Flags {
  int to = 0;
  double loss = 0;
  double duplicates = 0;
  double max_delay_ms = 0;
  double bytes_per_s = 1e12;
  double max_queue_s = 0.5;
  uint64_t seed = 1;
};

std::sig_atomic_t is_ended = 0;
std::sig_atomic_t is_cut = 0;       // nothing passes
std::sig_atomic_t drops_scans = 0;  // so many datagrams with scans do not reach the other side

void HandleSignal(int signal) {
  if (signal == SIGUSR1) {
    is_cut = is_cut == 0;
  } else if (signal == SIGUSR2) {
    drops_scans = drops_scans + 1;
  } else {
    is_ended = 1;
  }
}

struct LcmMessage {
  std::string channel;  // empty where the datagram is not a whole message
  Bytes bytes;
};

LcmMessage Parse(Bytes datagram) {
  constexpr size_t kHeader = 8;
  constexpr uint8_t kMagic[] = {'L', 'C', '0', '2'};
  if (datagram.size() < kHeader || std::memcmp(datagram.data(), kMagic, sizeof(kMagic)) != 0) {
    return {};
  }
  const auto begin = datagram.begin() + kHeader;
  const auto end = std::find(begin, datagram.end(), 0);
  if (end == datagram.end()) return {};
  return {std::string(begin, end), datagram.subspan(end + 1 - datagram.begin())};
}

// The group of LCM_DEFAULT_URL in one network namespace.
class Side {
 public:
  // In the namespace of the calling thread.
  static absl::StatusOr<Side> Open() {
    Side side;
    SPLINEMAP_ASSIGN_OR_RETURN(side.group_, BusGroup());
    const int one = 1;
    const int ttl = 0;
    const int buffer = 4 << 20;
    const ip_mreq membership{side.group_.sin_addr, {INADDR_ANY}};
    setsockopt(side.in_, SOL_SOCKET, SO_REUSEADDR, &one, sizeof(one));
    setsockopt(side.in_, SOL_SOCKET, SO_REUSEPORT, &one, sizeof(one));
    setsockopt(side.in_, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof(buffer));
    setsockopt(side.out_, IPPROTO_IP, IP_MULTICAST_TTL, &ttl, sizeof(ttl));
    sockaddr_in own{AF_INET, 0, {INADDR_ANY}, {}};
    socklen_t size = sizeof(own);
    if (bind(side.in_, reinterpret_cast<const sockaddr*>(&side.group_), sizeof(own)) != 0 ||
        setsockopt(side.in_, IPPROTO_IP, IP_ADD_MEMBERSHIP, &membership, sizeof(membership)) != 0 ||
        bind(side.out_, reinterpret_cast<const sockaddr*>(&own), sizeof(own)) != 0 ||
        getsockname(side.out_, reinterpret_cast<sockaddr*>(&own), &size) != 0) {
      return Unavailable("cannot join the group of LCM_DEFAULT_URL: {}", std::strerror(errno));
    }
    side.own_port_ = own.sin_port;
    return side;
  }

  int fd() const { return in_; }

  struct Heard {
    std::vector<uint8_t> datagram;  // empty: nothing is there
    bool is_own = false;            // this Side has sent it
  };
  Heard Receive() const {
    Heard heard{std::vector<uint8_t>(65536)};
    sockaddr_in from{};
    socklen_t size = sizeof(from);
    const ssize_t bytes = recvfrom(in_, heard.datagram.data(), heard.datagram.size(), MSG_DONTWAIT,
                                   reinterpret_cast<sockaddr*>(&from), &size);
    heard.datagram.resize(std::max<ssize_t>(bytes, 0));
    heard.is_own = from.sin_port == own_port_;
    return heard;
  }

  void Send(const std::vector<uint8_t>& datagram) const {
    sendto(out_, datagram.data(), datagram.size(), 0, reinterpret_cast<const sockaddr*>(&group_),
           sizeof(group_));
  }

 private:
  int in_ = socket(AF_INET, SOCK_DGRAM, 0);  // until the program ends
  int out_ = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in group_{};
  in_port_t own_port_ = 0;
};

// What was said on a bus, by what it is for. A tile that was asked for and comes whole is an
// answer, and so is a scan that comes again.
class Tally {
 public:
  void Take(const LcmMessage& message, size_t datagram_bytes) {
    Count(message.channel, 1, datagram_bytes);
    switch (TypeOf(message.bytes).value_or(MessageType::kStatus)) {
      case MessageType::kLayerPull:
        if (const auto pull = Decode<layer_pull_t>(message.bytes); pull.ok()) HandlePull(*pull);
        break;
      case MessageType::kLayerUpdates:
        if (const auto updates = Decode<layer_updates_t>(message.bytes); updates.ok()) {
          HandleUpdates(*updates);
        }
        break;
      case MessageType::kScanPull:
        if (const auto pull = Decode<scan_pull_t>(message.bytes); pull.ok()) HandleScanPull(*pull);
        break;
      case MessageType::kLayerScans:
        if (const auto scans = Decode<layer_scans_t>(message.bytes); scans.ok()) {
          HandleScans(*scans);
        }
        break;
      default:
        break;
    }
  }

  void Count(const std::string& what, int64_t number, size_t bytes) {
    counts_[what].first += number;
    counts_[what].second += static_cast<int64_t>(bytes);
  }

  void Print() const {
    const Seconds now = std::chrono::system_clock::now().time_since_epoch();
    fmt::print("{{\"time_s\": {:.3f}", now.count());
    for (const auto& [what, count] : counts_) {
      fmt::print(", \"{}\": {{\"number\": {}, \"bytes\": {}}}", what, count.first, count.second);
    }
    fmt::print("}}\n");
    std::fflush(stdout);
  }

 private:
  void HandlePull(const layer_pull_t& pull) {
    for (int n = 0; n < pull.num_nodes; ++n) {
      const bool is_tile = pull.levels[n] == 0;
      Count(is_tile ? "asked_tiles" : "asked_nodes", 1, 0);
      if (is_tile) asked_.insert({pull.xs[n], pull.ys[n]});
    }
  }
  void HandleUpdates(const layer_updates_t& updates) {
    for (const tile_update_t& tile : updates.tiles) {
      const bool is_answer = tile.base_checksum == 0 && asked_.erase({tile.tx, tile.ty}) > 0;
      Count(is_answer ? "answered_tiles" : "pushed_tiles", 1, tile._getEncodedSizeNoHash());
    }
  }

  void HandleScanPull(const scan_pull_t& pull) {
    for (int n = 0; n < pull.num_ranges; ++n) {
      Count("asked_scans", pull.last[n] - pull.first[n] + 1, 0);
    }
  }
  // A scan that was sent before is an answer.
  void HandleScans(const layer_scans_t& scans) {
    for (const scan_record_t& scan : scans.scans) {
      const bool is_answer = !sent_.insert({scan.revision, scan.part}).second;
      Count(is_answer ? "answered_scans" : "pushed_scans", scan.part == 0 ? 1 : 0,
            scan._getEncodedSizeNoHash());
    }
  }

  std::map<std::string, std::pair<int64_t, int64_t>> counts_;
  std::set<std::pair<int32_t, int32_t>> asked_;  // tiles that were not answered yet
  std::set<std::pair<int64_t, int16_t>> sent_;   // parts of scans, by revision
};

// One direction.
class Link {
 public:
  Link(const Flags& flags, const Side& to, uint64_t seed) : flags_(flags), to_(to), random_(seed) {}

  void Take(const std::vector<uint8_t>& datagram, Clock::time_point now) {
    sent_ =
        std::max(sent_, now) + Duration(static_cast<double>(datagram.size()) / flags_.bytes_per_s);
    if (Seconds(sent_ - now).count() > flags_.max_queue_s) {
      sent_ -= Duration(static_cast<double>(datagram.size()) / flags_.bytes_per_s);
      return;
    }
    const int copies = Happens(flags_.duplicates) ? 2 : 1;
    for (int n = 0; n < copies; ++n) {
      if (Happens(flags_.loss)) continue;
      under_way_.emplace(sent_ + Duration(Uniform() * flags_.max_delay_ms / 1000), datagram);
    }
  }

  void Deliver(Clock::time_point now) {
    while (!under_way_.empty() && under_way_.begin()->first <= now) {
      to_.Send(under_way_.begin()->second);
      under_way_.erase(under_way_.begin());
    }
  }

 private:
  static Clock::duration Duration(double s) {
    return std::chrono::duration_cast<Clock::duration>(Seconds(s));
  }
  double Uniform() { return std::uniform_real_distribution<double>(0, 1)(random_); }
  bool Happens(double probability) { return Uniform() < probability; }

  const Flags& flags_;
  const Side& to_;
  std::mt19937_64 random_;
  Clock::time_point sent_;  // the last datagram, at the rate of the link
  std::multimap<Clock::time_point, std::vector<uint8_t>> under_way_;
};

absl::Status Run(const Flags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const Side here, Side::Open());
  const int other = open(fmt::format("/proc/{}/ns/net", flags.to).c_str(), O_RDONLY | O_CLOEXEC);
  if (other < 0 || setns(other, CLONE_NEWNET) != 0) {
    return Unavailable("cannot enter the network of process {}: {}", flags.to,
                       std::strerror(errno));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const Side there, Side::Open());

  Tally tally;
  Link out(flags, there, 2 * flags.seed);
  Link back(flags, here, 2 * flags.seed + 1);
  std::array<pollfd, 2> sockets{{{here.fd(), POLLIN, 0}, {there.fd(), POLLIN, 0}}};
  auto next_print = Clock::now();
  while (is_ended == 0) {
    poll(sockets.data(), sockets.size(), 1);
    const auto now = Clock::now();
    for (Side::Heard heard = here.Receive(); !heard.datagram.empty(); heard = here.Receive()) {
      const LcmMessage message = Parse(heard.datagram);
      if (!message.channel.starts_with("SPLINEMAP_")) continue;
      tally.Take(message, heard.datagram.size());
      if (heard.is_own || is_cut != 0) continue;
      if (drops_scans > 0 && message.channel == "SPLINEMAP_SCANS") {
        drops_scans = drops_scans - 1;
        const auto scans = Decode<layer_scans_t>(message.bytes);
        tally.Count("dropped_scans", scans.ok() ? scans->num_scans : 0, message.bytes.size());
        continue;
      }
      out.Take(heard.datagram, now);
    }
    for (Side::Heard heard = there.Receive(); !heard.datagram.empty(); heard = there.Receive()) {
      if (!heard.is_own && is_cut == 0) back.Take(heard.datagram, now);
    }
    out.Deliver(now);
    back.Deliver(now);
    if (now >= next_print) {
      next_print = now + std::chrono::milliseconds(500);
      tally.Print();
    }
  }
  tally.Print();
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app(
      "relay: a bad link to the bus of another network namespace. SIGUSR1 cuts it, and mends it "
      "again; SIGUSR2 drops one datagram of updates on the way there");
  Flags flags;
  app.add_option("--to", flags.to, "A process in the other namespace")->required();
  app.add_option("--loss", flags.loss, "Share of datagrams that are lost, each way");
  app.add_option("--duplicates", flags.duplicates, "Share of datagrams that come twice");
  app.add_option("--max-delay-ms", flags.max_delay_ms, "ms, delays are random up to this");
  app.add_option("--bytes-per-s", flags.bytes_per_s, "Rate of the link, each way");
  app.add_option("--max-queue-s", flags.max_queue_s, "s, what would wait longer is dropped");
  app.add_option("--seed", flags.seed, "Of what is random");
  CLI11_PARSE(app, argc, argv);
  for (const int signal : {SIGINT, SIGTERM, SIGUSR1, SIGUSR2}) std::signal(signal, HandleSignal);
  if (absl::Status status = Run(flags); !status.ok()) {
    fmt::print(stderr, "relay: {}\n", ErrorText(status));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
