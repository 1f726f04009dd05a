#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>

#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/pipeline/notice.h"

namespace splinemap {

// What a daemon reports to people: logs each subject once, and then once a minute while it goes on;
// counts problems for status messages. Thread-safe.
class NoticeLog {
 public:
  // Called without locks held; does not wait.
  using Sink = std::function<void(bool is_problem, const std::string& text)>;

  explicit NoticeLog(Sink sink) : sink_(std::move(sink)) {}

  void Report(const Notice& notice, Clock::time_point now = Clock::now());
  // Counts the problem `times` and reports it. Problems of one kind and subject are one subject.
  void ReportProblem(Problem problem, const std::string& subject, std::string text,
                     int64_t times = 1);
  // The subject is over: its next notice is logged at once.
  void Forget(const std::string& subject);

  ProblemCounts problems() const;
  std::string last_problem() const;

 private:
  struct Subject {
    Clock::time_point logged;
    int64_t times_since = 0;
  };
  std::optional<std::string> TextToLog(const Notice& notice, Clock::time_point now)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Sink sink_;
  mutable Mutex mutex_;
  std::map<std::string, Subject> subjects_ ABSL_GUARDED_BY(mutex_);
  ProblemCounts problems_ ABSL_GUARDED_BY(mutex_){};
  std::string last_problem_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace splinemap
