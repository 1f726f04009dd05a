#include "lib/pipeline/notice.h"

#include <algorithm>

namespace splinemap {

const char* ProblemName(Problem problem) {
  switch (problem) {
    case Problem::kOddReadings:
      return "odd_readings";
    case Problem::kUselessBeamTimes:
      return "useless_beam_times";
    case Problem::kOptionsDisagree:
      return "options_disagree";
    case Problem::kWithoutPoses:
      return "without_poses";
    case Problem::kMapDisagrees:
      return "map_disagrees";
    case Problem::kTimeJump:
      return "time_jump";
    case Problem::kCoarsePoses:
      return "coarse_poses";
    case Problem::kPoseJump:
      return "pose_jump";
    case Problem::kHostClockJump:
      return "host_clock_jump";
    case Problem::kSilence:
      return "silence";
    case Problem::kLostDatagrams:
      return "lost_datagrams";
    case Problem::kSharedIdentity:
      return "shared_identity";
    case Problem::kSharedName:
      return "shared_name";
    case Problem::kRefusedLayer:
      return "refused_layer";
    case Problem::kRefusedSetting:
      return "refused_setting";
    case Problem::kDisownedTiles:
      return "disowned_tiles";
    case Problem::kContradiction:
      return "layers_contradict";
    case Problem::kBusAway:
      return "bus_away";
    case Problem::kRefusedRequests:
      return "refused_requests";
    case Problem::kMalformedMessages:
      return "malformed_messages";
    case Problem::kDisbelieved:
      return "disbelieved_messages";
    case Problem::kDroppedUpdates:
      return "dropped_updates";
    case Problem::kLostLogLines:
      return "lost_log_lines";
    case Problem::kNotSaved:
      return "not_saved";
    case Problem::kShortMemory:
      return "short_memory";
  }
  return "unknown";
}

void NoticeList::Add(bool is_problem, const std::string& subject, std::string text) {
  const auto known = std::find_if(notices_.begin(), notices_.end(),
                                  [&](const Notice& n) { return n.subject == subject; });
  if (known == notices_.end()) {
    notices_.push_back({is_problem, subject, std::move(text)});
    return;
  }
  known->text = std::move(text);
  ++known->times;
}

}  // namespace splinemap
