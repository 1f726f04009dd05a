#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "lib/sensing/drop_counts.h"
#include "lib/sensing/pose_buffer.h"
#include "splinemap/posed_scan.h"

namespace splinemap {

// All times are message time.
struct ScanQueueOptions {
  // A scan without a pose at or after its last beam waits until its channel is this much newer.
  Utime max_pose_wait = std::chrono::seconds(2);
  // Poses further apart are not interpolated.
  Utime max_pose_gap = std::chrono::seconds(1);
  // With several scan channels: how long a scan waits, by the newest pose, for the other channels
  // to reach its time.
  Utime max_order_wait = std::chrono::milliseconds(200);
  // Poses are kept this long.
  Utime pose_history = std::chrono::seconds(10);
  // A channel that steps back by more than this, in two messages in a row, has jumped: a log was
  // rewound.
  Utime time_jump = std::chrono::seconds(1);
};

// Totals since construction.
struct ScanQueueCounts {
  DropCounts drops;
  int64_t time_jumps = 0;             // back, further than time_jump
  std::optional<int> jumped_channel;  // the last to jump: a scan channel, or else the poses
  int64_t pose_jumps = 0;             // places, not times
  std::optional<std::pair<TimedPose, TimedPose>> last_pose_jump;  // from, to
  // By channel: scans without pose since the last one that was posed.
  std::vector<int64_t> without_pose_in_a_row;
};

// Brings scans into order of (utime, channel) and gives them interpolated poses. What
// comes out depends on the messages and their order alone, never on the time they take to process.
//
// A scan comes out when poses bracket all its beams and every scan channel has reached its time (or
// max_order_wait passed). When a channel jumps back in time, what can be placed comes out, the rest
// is dropped, and time begins anew. A single message with a stamp of long ago is no jump, and is
// dropped. Memory is bounded. Thread-compatible.
class ScanQueue {
 public:
  ScanQueue(ScanQueueOptions options, int num_channels);

  void AddPose(const TimedPose& pose);
  // Requires 0 <= scan.channel < num_channels.
  void AddScan(Scan scan);
  // The end of input: what can be placed comes out, the rest is dropped, time begins anew.
  void Flush();

  // The next scan in order, or nothing until more messages come.
  std::optional<PosedScan> Next();

  size_t size() const;
  const ScanQueueCounts& counts() const { return counts_; }

  static constexpr size_t kMaxScans = 10'000;
  static constexpr size_t kMaxBeamsWaiting = 2'000'000;

 private:
  using Key = std::pair<Utime, int>;  // utime, channel

  // How the time of a message compares with those of its channel before.
  enum class Step { kOn, kBack, kRewound };
  Step StepOf(std::optional<Utime> newest, std::optional<Utime> held, Utime utime) const;
  void BeginAnew(std::optional<int> jumped_channel);
  void DropHeld();
  void DropHeldPose();
  void DropHeldScan(int channel);
  void HandlePose(const TimedPose& pose);
  void HandleScan(Scan scan);

  enum class Fate { kWait, kPose, kNoPose };
  Fate Judge(const Scan& scan) const;
  bool OtherChannelsReached(const Scan& scan) const;
  void Drain(bool end_of_input);
  void Pose(Scan scan);
  void CountWithoutPose(const Scan& scan);
  void DropOldest();

  ScanQueueOptions options_;
  PoseBuffer poses_;
  std::map<Key, Scan> waiting_;
  size_t beams_waiting_ = 0;
  std::vector<std::optional<Utime>> newest_scan_;  // by channel
  // Stepped back by more than time_jump; the next message of the channel tells whether that is the
  // new time or a stamp gone wrong.
  std::optional<TimedPose> held_pose_;
  std::optional<TimedPose> last_pose_;
  std::vector<std::optional<Scan>> held_scans_;  // by channel
  std::optional<Key> last_posed_;
  std::deque<PosedScan> ready_;
  ScanQueueCounts counts_;
};

}  // namespace splinemap
