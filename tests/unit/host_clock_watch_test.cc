#include "services/splinemapd/host_clock_watch.h"

#include <gtest/gtest.h>

namespace splinemap {
namespace {

using std::chrono::milliseconds;

TEST(HostClockWatchTest, JumpsAreToldAndSlewingIsNot) {
  HostClockWatch watch;
  std::chrono::system_clock::time_point system{};
  std::chrono::steady_clock::time_point steady{};
  EXPECT_FALSE(watch.Look(system, steady));
  for (int n = 0; n < 1000; ++n) {
    system += milliseconds(1010);
    steady += milliseconds(1000);
    EXPECT_FALSE(watch.Look(system, steady)) << "slewed";
  }
  system += milliseconds(4200);
  steady += milliseconds(1000);
  EXPECT_NEAR(watch.Look(system, steady)->count(), 3.2, 1e-6);
  EXPECT_FALSE(watch.Look(system, steady)) << "once";
  system -= milliseconds(60'000);
  EXPECT_NEAR(watch.Look(system, steady)->count(), -60, 1e-6);
}

}  // namespace
}  // namespace splinemap
