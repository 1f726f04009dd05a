#include "services/splinemapd/mailbox.h"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

namespace splinemap::mailbox_test {

using std::chrono::milliseconds;
using std::chrono::seconds;

const MailboxMessage& MessageOf(const std::optional<Mailbox::Item>& item) {
  return std::get<MailboxMessage>(item.value());
}

TEST(MailboxTest, KeepsOrderAcrossThreads) {
  Mailbox mailbox(1 << 20);
  std::jthread producer([&] {
    for (uint8_t k = 0; k < 200; ++k) mailbox.Push("A", std::vector<uint8_t>{k});
  });
  for (uint8_t k = 0; k < 200; ++k) {
    const auto item = mailbox.Pop({}, Clock::now() + seconds(5));
    ASSERT_TRUE(item);
    EXPECT_EQ(MessageOf(item).bytes[0], k);
  }
  EXPECT_FALSE(mailbox.TryPop());
  EXPECT_EQ(mailbox.dropped(), 0);
}

TEST(MailboxTest, DropsTheOldestMessagesAndCountsThem) {
  Mailbox mailbox(10'000);
  for (uint8_t k = 0; k < 100; ++k) mailbox.Push("A", std::vector<uint8_t>(1000, k));
  EXPECT_LE(mailbox.num_messages(), 10u);
  EXPECT_EQ(mailbox.dropped() + static_cast<int64_t>(mailbox.num_messages()), 100);
  EXPECT_EQ(MessageOf(mailbox.TryPop()).bytes[0], mailbox.dropped());
}

TEST(MailboxTest, AMessageLargerThanAllIsDroppedAlone) {
  Mailbox mailbox(1000);
  mailbox.Push("A", std::vector<uint8_t>(5));
  mailbox.Push("A", std::vector<uint8_t>(5000));
  EXPECT_EQ(mailbox.num_messages(), 1u);
  EXPECT_EQ(mailbox.dropped(), 1);
}

TEST(MailboxTest, TasksKeepTheirPlaceAndAreNeverDropped) {
  Mailbox mailbox(1000);
  int executed = 0;
  mailbox.Push("A", std::vector<uint8_t>(700, 1));
  for (int n = 0; n < 50; ++n) mailbox.Post([&] { ++executed; });
  mailbox.Push("A", std::vector<uint8_t>(700, 2));  // for which the first one goes
  for (int n = 0; n < 50; ++n) std::get<Task>(mailbox.TryPop().value())();
  EXPECT_EQ(executed, 50);
  EXPECT_EQ(MessageOf(mailbox.TryPop()).bytes[0], 2);
  EXPECT_EQ(mailbox.dropped(), 1);
}

TEST(MailboxTest, AMessageThatDoesNotWakeWaitsForOneThatDoes) {
  Mailbox mailbox(1000);
  std::atomic<int> popped = 0;
  std::jthread consumer([&] {
    while (popped < 2) {
      if (mailbox.Pop({}, Clock::now() + seconds(10))) ++popped;
    }
  });
  std::this_thread::sleep_for(milliseconds(50));  // so that it waits
  mailbox.Push("A", std::vector<uint8_t>(5), Utime(0), /*wakes=*/false);
  std::this_thread::sleep_for(milliseconds(50));
  EXPECT_EQ(popped, 0);
  mailbox.Push("A", std::vector<uint8_t>(5));
  consumer.join();
  EXPECT_EQ(popped, 2);
}

TEST(MailboxTest, AStopEndsTheWaitAndLeavesWhatIsThere) {
  Mailbox mailbox(1000);
  std::stop_source stop;
  std::jthread stopper([&] {
    std::this_thread::sleep_for(milliseconds(20));
    stop.request_stop();
  });
  const auto begin = Clock::now();
  EXPECT_FALSE(mailbox.Pop(stop.get_token(), begin + seconds(10)));
  EXPECT_LT(Clock::now() - begin, seconds(5));
  mailbox.Push("A", std::vector<uint8_t>{1});
  EXPECT_TRUE(mailbox.Pop(stop.get_token(), begin + seconds(10)));
}

}  // namespace splinemap::mailbox_test
