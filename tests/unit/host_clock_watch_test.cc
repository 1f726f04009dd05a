#include "services/splinemapd/host_clock_watch.h"

#include <gtest/gtest.h>

namespace splinemap::host_clock_watch_test {

using std::chrono::milliseconds;

TEST(HostClockWatchTest, JumpsAreToldAndSlewingIsNot) {
  HostClockWatch watch;
  std::chrono::system_clock::time_point system{};
  std::chrono::nanoseconds since_boot{};
  EXPECT_FALSE(watch.Check(system, since_boot));
  for (int n = 0; n < 1000; ++n) {
    system += milliseconds(1010);
    since_boot += milliseconds(1000);
    EXPECT_FALSE(watch.Check(system, since_boot)) << "slewed";
  }
  system += milliseconds(4200);
  since_boot += milliseconds(1000);
  EXPECT_NEAR(watch.Check(system, since_boot)->count(), 3.2, 1e-6);
  EXPECT_FALSE(watch.Check(system, since_boot)) << "once";
  system -= milliseconds(60'000);
  EXPECT_NEAR(watch.Check(system, since_boot)->count(), -60, 1e-6);
}

}  // namespace splinemap::host_clock_watch_test
