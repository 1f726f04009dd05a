#include "services/splinemapd/notice_log.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace splinemap::notice_log_test {

using std::chrono::seconds;

class NoticeLogTest : public testing::Test {
 protected:
  // What is logged of a notice; empty for nothing.
  std::string Report(const Notice& notice, Clock::time_point now) {
    logged_.clear();
    log_.Report(notice, now);
    return logged_.empty() ? "" : logged_.back();
  }

  std::vector<std::string> logged_;
  NoticeLog log_{[this](bool, const std::string& text) { logged_.push_back(text); }};
  const Clock::time_point start_{};
};

TEST_F(NoticeLogTest, LogsEachSubjectOnceAMinuteWithTheNumberThatWasNotLogged) {
  const Notice late{.subject = "late", .text = "a scan is late"};
  EXPECT_EQ(Report(late, start_), "a scan is late");
  for (int n = 1; n < 60; ++n) EXPECT_EQ(Report(late, start_ + seconds(n)), "");
  const Notice many{.subject = "many", .text = "many scans", .times = 3};
  EXPECT_EQ(Report(many, start_ + seconds(30)), "many scans (2 times more)");
  EXPECT_EQ(Report(late, start_ + seconds(60)), "a scan is late (59 times more)");
  EXPECT_EQ(Report(late, start_ + seconds(120)), "a scan is late");
}

TEST_F(NoticeLogTest, ASubjectThatIsOverIsLoggedAtOnceWhenItHappensAgain) {
  const Notice away{.subject = "bus", .text = "the bus is away"};
  EXPECT_EQ(Report(away, start_), "the bus is away");
  log_.Forget("bus");
  EXPECT_EQ(Report(away, start_ + seconds(1)), "the bus is away");
  EXPECT_EQ(Report(away, start_ + seconds(2)), "");
}

TEST_F(NoticeLogTest, ProblemsAreCountedAndTheLastOneIsKept) {
  log_.ReportProblem(Problem::kLostDatagrams, "", "5 datagrams were lost", 5);
  log_.ReportProblem(Problem::kLostDatagrams, "", "2 datagrams were lost", 2);
  log_.Report({.is_problem = false, .subject = "bus", .text = "the bus works again"});
  EXPECT_EQ(log_.problems()[static_cast<int>(Problem::kLostDatagrams)], 7);
  EXPECT_EQ(log_.last_problem(), "2 datagrams were lost");
  EXPECT_EQ(logged_, (std::vector<std::string>{"5 datagrams were lost", "the bus works again"}));
}

}  // namespace splinemap::notice_log_test
