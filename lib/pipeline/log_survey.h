#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/config/config.h"
#include "lib/wire/decode.h"

namespace splinemap {

// One channel of a log.
struct LoggedChannel {
  std::string name;
  std::optional<uint64_t> fingerprint;  // of the first message, if it is one of LCM
  std::optional<MessageType> type;      // if splinemap reads it
  int64_t messages = 0;
  double rate_hz = 0;  // over the time from its first to its last message
  std::string preset;  // for scans: what the first message looks like
};

struct LogSurvey {
  double duration_s = 0;                // from the first event to the last
  std::vector<LoggedChannel> channels;  // by name
  std::string damage;                   // in words, where the log could not be read to its end
};

// Reads a whole log to see what is in it. Errors as ReadLcmLog() where nothing at all can be read.
absl::StatusOr<LogSurvey> SurveyLog(const std::string& path,
                                    absl::FunctionRef<void(double)> progress);

// Fills in the scan channel and the pose channel where `config` has none and the log has just one
// that fits, and checks those that it has. Where several or none do, InvalidArgument lists them
// with their rates and says which flag to give.
absl::Status ChooseChannels(const LogSurvey& survey, config::Config& config);

}  // namespace splinemap
