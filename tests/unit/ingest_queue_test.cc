#include "services/splinemapd/ingest_queue.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace splinemap::ingest_queue_test {

using std::chrono::milliseconds;

TEST(IngestQueueTest, KeepsOrderAcrossThreads) {
  IngestQueue queue(1 << 20);
  std::jthread producer([&] {
    for (uint8_t k = 0; k < 200; ++k) queue.Push("A", std::vector<uint8_t>{k});
  });
  for (uint8_t k = 0; k < 200; ++k) {
    const auto message = queue.Pop(milliseconds(5000));
    ASSERT_TRUE(message);
    EXPECT_EQ(message->bytes[0], k);
  }
  EXPECT_FALSE(queue.Pop(milliseconds(0)));
  EXPECT_EQ(queue.dropped(), 0);
}

TEST(IngestQueueTest, DropsTheOldestAndCountsThem) {
  IngestQueue queue(10'000);
  for (uint8_t k = 0; k < 100; ++k) queue.Push("A", std::vector<uint8_t>(1000, k));
  EXPECT_LE(queue.size(), 10u);
  EXPECT_EQ(queue.dropped() + static_cast<int64_t>(queue.size()), 100);
  EXPECT_EQ(queue.Pop(milliseconds(0))->bytes[0], queue.dropped());
}

TEST(IngestQueueTest, AMessageLargerThanAllIsDroppedAlone) {
  IngestQueue queue(1000);
  queue.Push("A", std::vector<uint8_t>(5));
  queue.Push("A", std::vector<uint8_t>(5000));
  EXPECT_EQ(queue.size(), 1u);
  EXPECT_EQ(queue.dropped(), 1);
}

}  // namespace splinemap::ingest_queue_test
