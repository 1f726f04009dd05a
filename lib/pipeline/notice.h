#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace splinemap {

// What is wrong beyond single messages; see DropReason for those.
enum class Problem {
  kOddReadings,        // other units, beyond range_max_m, or piled up at one range
  kUselessBeamTimes,   // configured to be used, and all the same
  kOptionsDisagree,    // other options of the sensor would make a sharper map
  kWithoutPoses,       // scans in a row that never get a pose
  kMapDisagrees,       // scans in a row whose hits lie in free space
  kTimeJump,           // message time stepped back
  kCoarsePoses,        // floats far from the origin
  kPoseJump,           // poses that no robot can have moved between
  kHostClockJump,      // the clock of this computer was set
  kSilence,            // a channel from which nothing comes
  kLostDatagrams,      // dropped by the system before the daemon could take them
  kSharedIdentity,     // somebody else publishes the daemon's layer
  kSharedName,         // two layers have one name
  kRefusedLayer,       // a layer that cannot be summed
  kRefusedSetting,     // a setting of a layer that nobody can have made
  kDisownedTiles,      // tiles in the name of a robot that does not have them
  kContradiction,      // obstacles of a layer where the others saw free space
  kBusAway,            // the LCM bus cannot be opened, or broke off
  kRefusedRequests,    // clients ask more than can be answered
  kMalformedMessages,  // on splinemap's own channels
  kDisbelieved,        // the same, not signed by a key that is trusted and may say so
  kDroppedUpdates,     // messages about layers that came faster than they were handled
  kLostLogLines,       // nobody reads the log
  kNotSaved,           // the map file cannot be written
  kShortMemory,        // the budget of memory is less than the map needs at least
};
inline constexpr int kNumProblems = static_cast<int>(Problem::kShortMemory) + 1;

// As in status messages: "useless_beam_times".
const char* ProblemName(Problem problem);

// How often each was found.
using ProblemCounts = std::array<int64_t, kNumProblems>;

// What a person should know.
struct Notice {
  bool is_problem = true;  // wants something done about it
  std::string subject;     // notices of one subject say the same thing
  std::string text;
  int64_t times = 1;
};

// Notices since they were last taken, one for each subject. Bounded by the number of subjects.
class NoticeList {
 public:
  // Keeps the newest text of a subject.
  void Add(bool is_problem, const std::string& subject, std::string text);
  std::vector<Notice> Take() { return std::exchange(notices_, {}); }

 private:
  std::vector<Notice> notices_;
};

}  // namespace splinemap
