#include "lib/pipeline/notice.h"

#include <algorithm>

namespace splinemap {

const char* SymptomName(Symptom symptom) {
  switch (symptom) {
    case Symptom::kUselessBeamTimes:
      return "useless_beam_times";
    case Symptom::kFlagsDisagree:
      return "flags_disagree";
    case Symptom::kWithoutPoses:
      return "without_poses";
    case Symptom::kMapDisagrees:
      return "map_disagrees";
    case Symptom::kTimeJump:
      return "time_jump";
    case Symptom::kHostClockJump:
      return "host_clock_jump";
    case Symptom::kSilence:
      return "silence";
    case Symptom::kLostDatagrams:
      return "lost_datagrams";
    case Symptom::kSharedIdentity:
      return "shared_identity";
    case Symptom::kSharedName:
      return "shared_name";
    case Symptom::kRefusedLayer:
      return "refused_layer";
    case Symptom::kRefusedDecision:
      return "refused_decision";
    case Symptom::kDisownedTiles:
      return "disowned_tiles";
    case Symptom::kBusAway:
      return "bus_away";
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
