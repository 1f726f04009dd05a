#include "services/splinemapd/thread_watch.h"

#include <gtest/gtest.h>

#include <future>
#include <thread>

#include "services/splinemapd/mailbox.h"

namespace splinemap::thread_watch_test {

// A thread with an inbox, and a watch on it.
class ThreadWatchTest : public testing::Test {
 protected:
  ThreadWatchTest() { watch_.Add("works", mailbox_.steps()); }

  // Returns when the thread is within a task that ends with release_.
  void BeginTask() {
    std::promise<void> begun;
    mailbox_.Post([&begun, released = release_.get_future().share()] {
      begun.set_value();
      released.wait();
    });
    begun.get_future().wait();
  }
  void AwaitIdle() {
    while (mailbox_.steps().count() % 2 == 0) std::this_thread::yield();
  }

  Mailbox mailbox_{0};
  ThreadWatch watch_;
  std::promise<void> release_;
  std::jthread thread_{[this](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      const auto item = mailbox_.Pop(stop, Clock::now() + std::chrono::hours(1));
      if (item) std::get<Task> (*item)();
    }
  }};
};

TEST_F(ThreadWatchTest, AThreadThatWaitsForWorkDoesNotHang) {
  AwaitIdle();
  for (int k = 0; k < 3; ++k) EXPECT_EQ(watch_.FindHanging(), std::nullopt);
}

TEST_F(ThreadWatchTest, AThreadThatStaysAtOneTaskHangsUntilItIsDone) {
  BeginTask();
  EXPECT_EQ(watch_.FindHanging(), std::nullopt);  // it may have just begun
  EXPECT_EQ(watch_.FindHanging(), "works");
  EXPECT_EQ(watch_.FindHanging(), "works");
  release_.set_value();
  AwaitIdle();
  EXPECT_EQ(watch_.FindHanging(), std::nullopt);
}

TEST_F(ThreadWatchTest, AThreadThatGetsOnWithinOneTaskDoesNotHang) {
  BeginTask();
  for (int k = 0; k < 3; ++k) {
    mailbox_.steps().Add();
    EXPECT_EQ(watch_.FindHanging(), std::nullopt);
  }
  release_.set_value();
}

TEST(ThreadWatchOfBusyThreadTest, AThreadThatNeverWaitsDoesNotHang) {
  Mailbox mailbox(1000);
  ThreadWatch watch;
  watch.Add("works", mailbox.steps());
  for (int k = 0; k < 3; ++k) {
    mailbox.Push("A", {});
    mailbox.TryPop();
    EXPECT_EQ(watch.FindHanging(), std::nullopt);
  }
}

}  // namespace splinemap::thread_watch_test
