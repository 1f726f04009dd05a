#include "clients/splinemap/time_flag.h"

#include "absl/strings/numbers.h"
#include "absl/time/time.h"
#include "lib/base/status.h"
#include "lib/mapping/past_map.h"
#include "lib/wire/message_type.h"

namespace splinemap {

absl::StatusOr<Utime> ParseTime(const std::string& text, const LayerSet& set) {
  const auto error = [&] { return InvalidArgument("{} is no time; {}", text, kTimeHelp); };
  const bool from_end = text.starts_with("end");
  const bool from_start = text.starts_with("start");
  if (from_end || from_start) {
    SPLINEMAP_ASSIGN_OR_RETURN(const ArchiveTimes times, TimesOf(set));
    const Utime base = from_end ? times.last : times.first;
    const std::string rest = text.substr(from_end ? 3 : 5);
    if (rest.empty()) return base;
    absl::Duration duration;
    if (!absl::ParseDuration(rest, &duration) || duration == absl::InfiniteDuration() ||
        duration == -absl::InfiniteDuration()) {
      return error();
    }
    return Utime(absl::ToUnixMicros(absl::FromUnixMicros(base.count()) + duration));
  }
  int64_t utime = 0;
  if (absl::SimpleAtoi(text, &utime)) {
    return CheckUtime(utime).ok() ? absl::StatusOr<Utime>(Utime(utime)) : error();
  }
  absl::Time time;
  std::string ignored;
  for (const char* format : {"%Y-%m-%dT%H:%M:%E*S", "%Y-%m-%d"}) {
    if (absl::ParseTime(format, text, absl::UTCTimeZone(), &time, &ignored))
      return Utime(absl::ToUnixMicros(time));
  }
  return error();
}

std::string TextOf(Utime utime) {
  return absl::FormatTime("%Y-%m-%dT%H:%M:%E*S", absl::FromUnixMicros(utime.count()),
                          absl::UTCTimeZone());
}

}  // namespace splinemap
