#include "services/splinemapd/announcement.h"

#include <gtest/gtest.h>

namespace splinemap::announcement_test {

using std::chrono::seconds;

constexpr Clock::time_point kNow{std::chrono::hours(1)};

TEST(AnnouncementTest, WhatChangedOrIsAskedForIsDueAndElseNothing) {
  Announcement announcement(Clock::duration::max());
  EXPECT_TRUE(announcement.IsDue({1}, false, kNow));
  EXPECT_FALSE(announcement.IsDue({1}, false, kNow + seconds(1000)));
  EXPECT_TRUE(announcement.IsDue({1}, true, kNow + seconds(1001)));
  EXPECT_FALSE(announcement.IsDue({1}, false, kNow + seconds(1002)));
  EXPECT_TRUE(announcement.IsDue({2}, false, kNow + seconds(1003)));
  EXPECT_TRUE(announcement.IsDue({1}, false, kNow + seconds(1004)));
}

TEST(AnnouncementTest, IsDueAfterTheLongestPause) {
  Announcement announcement(seconds(5));
  EXPECT_TRUE(announcement.IsDue({1}, false, kNow));
  EXPECT_FALSE(announcement.IsDue({1}, false, kNow + seconds(4)));
  EXPECT_TRUE(announcement.IsDue({1}, false, kNow + seconds(5)));
  EXPECT_FALSE(announcement.IsDue({1}, false, kNow + seconds(9)));
}

}  // namespace splinemap::announcement_test
