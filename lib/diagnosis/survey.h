#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/config/config.h"
#include "lib/diagnosis/reading_statistics.h"
#include "lib/sensing/pose_buffer.h"
#include "lib/wire/message_type.h"
#include "splinemap/scan.h"
#include "splinemap/utime.h"

namespace splinemap {

// What was seen of one channel. Times of messages (utime) are known of the types that splinemap
// reads.
struct SurveyedChannel {
  std::string name;
  // Of the first message of a type that splinemap reads, or else of the first.
  std::optional<uint64_t> fingerprint;
  std::optional<MessageType> type;
  int64_t messages = 0;
  double rate_hz = 0;  // over the time from its first to its last message, as received

  int64_t malformed = 0;  // of another type, or not to be decoded
  std::string complaint;  // about the first of these
  int64_t repeated = 0;   // utime equal to that of the message before
  int64_t stepped_back = 0;
  double longest_gap_s = 0;  // of utime
  double lag_s = 0;          // time of receipt less utime, the median: clock offset and way to us
  std::string odd_stamps;    // a clause on utimes of another unit, or that do not count; or empty

  std::string preset;               // for scans: what the first message looks like
  bool useless_beam_times = false;  // for scans with beam times
};

// Looks at the messages of a log or a bus, all channels of it. Keeps the first minutes of scans and
// poses for Propose(); memory is bounded. Thread-compatible.
class Survey {
 public:
  // `received`: clock of the log or of this computer.
  void Add(Utime received, const std::string& channel, absl::Span<const uint8_t> message);
  // The same, but looks at its type alone, which takes far less time.
  void AddType(Utime received, const std::string& channel, absl::Span<const uint8_t> message) {
    Count(received, channel, message);
  }

  // By name.
  std::vector<SurveyedChannel> channels() const;
  std::optional<SurveyedChannel> Find(const std::string& name) const;
  double duration_s() const;

  // The first scans and poses of a channel, thinned; empty for another, and for those beyond
  // kMaxScanChannels and kMaxPoseChannels.
  const std::vector<RangeReadings>& ScansOf(const std::string& channel) const;
  const PoseBuffer& PosesOf(const std::string& channel) const;

  // Those scans at the times at which they were received.
  std::vector<RangeReadings> ScansAsReceived(const std::string& channel) const;
  // Of all scans of a channel.
  const ReadingStatistics& ReadingsOf(const std::string& channel) const;

  // The first transform on a channel, or nothing where none came.
  std::optional<SensorMount> MountOf(const std::string& channel) const;

  static constexpr size_t kMaxChannels = 1000;  // of a hostile bus; later ones are not looked at
  static constexpr size_t kMaxScans = 3000;
  static constexpr size_t kMaxBeams = 180;
  static constexpr size_t kMaxPoses = 50'000;
  // Scans and poses are kept of so many channels.
  static constexpr int kMaxScanChannels = 6;
  static constexpr int kMaxPoseChannels = 10;

 private:
  struct Sighting {
    SurveyedChannel channel;
    Utime first_received{0};
    Utime last_received{0};
    std::optional<Utime> first_utime;
    std::optional<Utime> last_utime;
    ReadingStatistics readings;
    std::vector<Utime> scans_received;  // for each of scans
    bool is_sampled = false;            // scans or poses are kept
    std::vector<RangeReadings> scans;
    PoseBuffer poses{kAnyTime};
    std::optional<SensorMount> mount;
    std::vector<double> lags_s;  // of the first kMaxLags
  };

  // Null where there are too many channels.
  Sighting* Count(Utime received, const std::string& channel, absl::Span<const uint8_t> message);
  void SetType(Sighting& sighting, absl::Span<const uint8_t> message);
  absl::StatusOr<Utime> Check(Sighting& sighting, absl::Span<const uint8_t> message,
                              Utime received);
  static std::string OddStamps(const Sighting& sighting);

  static constexpr size_t kMaxLags = 10'000;
  static constexpr Utime kAnyTime = std::chrono::years(300);

  std::map<std::string, Sighting> sightings_;
  int scan_channels_ = 0;
  int pose_channels_ = 0;
  std::optional<Utime> first_received_;
  Utime last_received_{0};
};

enum class SurveyDepth { kTypes, kAll };  // kTypes is enough for ChooseChannels()

// Reads a whole log. `damage` gets what ReadLcmLog() says, in words, where it could be read in
// part; errors as ReadLcmLog() where nothing at all could.
absl::StatusOr<Survey> SurveyLog(const std::string& path, SurveyDepth depth,
                                 absl::FunctionRef<void(double)> progress, std::string& damage);

// Fills in the scan channel and the pose channel where `config` has none and just one was seen that
// fits, and checks those that it has. Where several or none do, InvalidArgument lists them with
// their rates and says which flag to give.
absl::Status ChooseChannels(const Survey& survey, config::Config& config);

}  // namespace splinemap
