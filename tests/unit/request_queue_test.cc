#include "services/splinemapd/request_queue.h"

#include <gtest/gtest.h>

namespace splinemap {
namespace {

using Pushed = RequestQueue::Pushed;

request_t Request(int64_t client, int64_t id) {
  request_t head{};
  head.client = client;
  head.id = id;
  return head;
}

TEST(RequestQueueTest, ClientsAreServedInTurn) {
  RequestQueue queue;
  for (int64_t id = 0; id < 10; ++id) queue.Push(Request(1, id), {});
  queue.Push(Request(2, 0), {});
  queue.Push(Request(3, 0), {});
  std::vector<int64_t> clients;
  while (!queue.empty()) clients.push_back(queue.Pop().head.client);
  EXPECT_EQ(clients, (std::vector<int64_t>{1, 2, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1}));
}

TEST(RequestQueueTest, OneClientFillsItsOwnShareOnly) {
  RequestQueue queue;
  for (size_t id = 0; id < RequestQueue::kMaxOfClient; ++id) {
    EXPECT_EQ(queue.Push(Request(1, static_cast<int64_t>(id)), {}), Pushed::kTaken);
  }
  EXPECT_EQ(queue.Push(Request(1, 1000), {}), Pushed::kFull);
  EXPECT_EQ(queue.Push(Request(2, 1000), {}), Pushed::kTaken);
}

TEST(RequestQueueTest, AllClientsTogetherAreBounded) {
  RequestQueue queue;
  size_t taken = 0;
  for (int64_t client = 0; client < 5000; ++client) {
    taken += queue.Push(Request(client, 1), {}) == Pushed::kTaken ? 1 : 0;
  }
  EXPECT_EQ(taken, RequestQueue::kMax);
  queue.Pop();
  EXPECT_EQ(queue.Push(Request(-1, 1), {}), Pushed::kTaken);
}

TEST(RequestQueueTest, ARequestThatIsSentAgainWaitsOnce) {
  RequestQueue queue;
  const std::vector<uint8_t> bytes{1, 2};
  EXPECT_EQ(queue.Push(Request(1, 1), bytes), Pushed::kTaken);
  EXPECT_EQ(queue.Push(Request(1, 1), bytes), Pushed::kWaiting);
  EXPECT_EQ(queue.Push(Request(2, 1), bytes), Pushed::kTaken);
  EXPECT_EQ(queue.Pop().bytes, bytes);
  EXPECT_EQ(queue.Pop().head.client, 2);
  EXPECT_TRUE(queue.empty());
  EXPECT_EQ(queue.Push(Request(1, 1), bytes), Pushed::kTaken);
}

}  // namespace
}  // namespace splinemap
