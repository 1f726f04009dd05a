#include "services/splinemapd/notice_limiter.h"

#include <fmt/core.h>

namespace splinemap {

std::optional<std::string> NoticeLimiter::Say(const Notice& notice, Clock::time_point now) {
  const auto [place, is_new] = subjects_.try_emplace(notice.subject);
  Subject& subject = place->second;
  if (!is_new && now < subject.said + std::chrono::minutes(1)) {
    subject.unsaid += notice.times;
    return std::nullopt;
  }
  const int64_t more = subject.unsaid + notice.times - 1;
  subject = {now, 0};
  return more > 0 ? fmt::format("{} ({} times more)", notice.text, more) : notice.text;
}

}  // namespace splinemap
