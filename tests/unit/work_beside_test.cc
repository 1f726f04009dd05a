#include "lib/base/work_beside.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <numeric>
#include <thread>
#include <vector>

namespace splinemap::work_beside_test {

constexpr size_t kItems = 4;

TEST(WorkBesideTest, ItemsAreWorkedOnInOrder) {
  std::vector<int> seen;
  WorkBeside<int> beside(kItems, [&](int& item) { seen.push_back(item); });
  for (int n = 0; n < 1000; ++n) {
    beside.Next() = n;
    beside.Add();
    if (n % 97 == 0) {
      beside.Wait();
      ASSERT_EQ(std::ssize(seen), n + 1);
    }
  }
  beside.Wait();
  std::vector<int> expected(1000);
  std::iota(expected.begin(), expected.end(), 0);
  EXPECT_EQ(seen, expected);
}

TEST(WorkBesideTest, WhoMakesMoreThanMayWaitWaits) {
  std::atomic<size_t> made = 0;
  size_t done = 0, most = 0;
  WorkBeside<int> beside(kItems, [&](int&) {
    std::this_thread::yield();
    most = std::max(most, made - done++);
  });
  for (int n = 0; n < 1000; ++n) {
    beside.Next();
    ++made;
    beside.Add();
  }
  beside.Wait();
  EXPECT_EQ(done, 1000u);
  EXPECT_LE(most, kItems);
}

TEST(WorkBesideTest, ItEndsWithoutBeingWaitedFor) {
  int done = 0;
  {
    WorkBeside<int> beside(kItems, [&](int&) { ++done; });
    for (int n = 0; n < 7; ++n) {
      beside.Next();
      beside.Add();
    }
  }
  EXPECT_LE(done, 7);
}

}  // namespace splinemap::work_beside_test
