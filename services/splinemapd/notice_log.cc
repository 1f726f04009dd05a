#include "services/splinemapd/notice_log.h"

#include <fmt/format.h>

#include <utility>

namespace splinemap {

void NoticeLog::Report(const Notice& notice, Clock::time_point now) {
  std::optional<std::string> text;
  {
    MutexLock lock(mutex_);
    if (notice.is_problem) last_problem_ = notice.text;
    text = TextToLog(notice, now);
  }
  if (text) sink_(notice.is_problem, *text);
}

void NoticeLog::ReportProblem(Problem problem, const std::string& subject, std::string text,
                              int64_t times) {
  {
    MutexLock lock(mutex_);
    problems_[static_cast<int>(problem)] += times;
  }
  Report({.subject = fmt::format("{} {}", ProblemName(problem), subject), .text = std::move(text)});
}

void NoticeLog::Forget(const std::string& subject) {
  MutexLock lock(mutex_);
  subjects_.erase(subject);
}

std::optional<std::string> NoticeLog::TextToLog(const Notice& notice, Clock::time_point now) {
  const auto [place, is_new] = subjects_.try_emplace(notice.subject);
  Subject& subject = place->second;
  if (!is_new && now < subject.logged + std::chrono::minutes(1)) {
    subject.times_since += notice.times;
    return std::nullopt;
  }
  const int64_t more = subject.times_since + notice.times - 1;
  subject = {now, 0};
  return more > 0 ? fmt::format("{} ({} times more)", notice.text, more) : notice.text;
}

ProblemCounts NoticeLog::problems() const {
  MutexLock lock(mutex_);
  return problems_;
}

std::string NoticeLog::last_problem() const {
  MutexLock lock(mutex_);
  return last_problem_;
}

}  // namespace splinemap
