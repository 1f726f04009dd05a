#include "services/splinemapd/request_queue.h"

#include <gtest/gtest.h>

#include <random>
#include <set>
#include <utility>
#include <vector>

#include "lcmtypes/splinemap/request_t.hpp"

namespace splinemap::request_queue_test {

using PushResult = RequestQueue::PushResult;

request_t Request(int64_t client, int64_t id) {
  request_t header{};
  header.client = client;
  header.id = id;
  return header;
}

// The client has asked before.
void MakeKnown(RequestQueue& queue, int64_t client) {
  for (const int64_t id : {-1, -2}) queue.Push(Request(client, id), {});
  for (int n = 0; n < 2; ++n) queue.Pop();
}

TEST(RequestQueueTest, ClientsAreServedInTurn) {
  RequestQueue queue;
  for (const int64_t client : {1, 2, 3}) MakeKnown(queue, client);
  for (int64_t id = 0; id < 10; ++id) queue.Push(Request(1, id), {});
  queue.Push(Request(2, 0), {});
  queue.Push(Request(3, 0), {});
  std::vector<int64_t> clients;
  while (!queue.empty()) clients.push_back(queue.Pop().header.client);
  EXPECT_EQ(clients, (std::vector<int64_t>{1, 2, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1}));
}

TEST(RequestQueueTest, OneClientFillsItsOwnShareOnly) {
  RequestQueue queue;
  for (size_t id = 0; id < RequestQueue::kMaxOfLine; ++id) {
    EXPECT_EQ(queue.Push(Request(1, static_cast<int64_t>(id)), {}), PushResult::kTaken);
  }
  EXPECT_EQ(queue.Push(Request(1, 1000), {}), PushResult::kFull);
  EXPECT_EQ(queue.Push(Request(2, 1000), {}), PushResult::kTaken);
}

TEST(RequestQueueTest, AllClientsTogetherAreBounded) {
  RequestQueue queue;
  size_t taken = 0;
  for (int64_t client = 0; client < 1500; ++client) {
    for (const int64_t id : {1, 2}) {
      taken += queue.Push(Request(client, id), {}) == PushResult::kTaken ? 1 : 0;
    }
  }
  EXPECT_EQ(taken, RequestQueue::kMax);
  queue.Pop();
  EXPECT_EQ(queue.Push(Request(-1, 1), {}), PushResult::kTaken);
}

TEST(RequestQueueTest, AFloodOfNewIdsCountsAsOneClient) {
  RequestQueue queue;
  std::mt19937_64 random(1);
  const auto new_id = [&] { return static_cast<int64_t>(random()); };
  MakeKnown(queue, 1);
  MakeKnown(queue, 2);
  for (int64_t round = 0; round < 1000; ++round) {
    for (int n = 0; n < 100; ++n) queue.Push(Request(new_id(), 1), {});
    ASSERT_EQ(queue.Push(Request(1, round), {}), PushResult::kTaken);
    ASSERT_EQ(queue.Push(Request(2, round), {}), PushResult::kTaken);
    // Both, and one of all others.
    std::set<int64_t> served;
    for (int n = 0; n < 3; ++n) served.insert(queue.Pop().header.client);
    ASSERT_TRUE(served.contains(1) && served.contains(2)) << round;
  }
}

TEST(RequestQueueTest, AClientThatComesDuringAFloodGetsInWhenItAsksAgain) {
  RequestQueue queue;
  std::mt19937_64 random(1);
  const auto flood = [&] {
    for (int n = 0; n < 1000; ++n) queue.Push(Request(static_cast<int64_t>(random()), 1), {});
  };
  flood();
  EXPECT_EQ(queue.Push(Request(7, 1), {}), PushResult::kFull);
  flood();
  EXPECT_EQ(queue.Push(Request(7, 1), {}), PushResult::kTaken);
  flood();
  std::set<int64_t> served;
  for (int n = 0; n < 2; ++n) served.insert(queue.Pop().header.client);
  EXPECT_TRUE(served.contains(7));
}

TEST(RequestQueueTest, WhatAClientAskedFirstWaitsInItsOwnLineOnceItIsKnown) {
  RequestQueue queue;
  queue.Push(Request(8, 1), {});
  queue.Push(Request(7, 1), {});
  queue.Push(Request(7, 2), {});
  queue.Push(Request(9, 1), {});
  std::vector<std::pair<int64_t, bool>> served;
  while (!queue.empty()) {
    const QueuedRequest request = queue.Pop();
    served.emplace_back(request.header.client, request.line.has_value());
  }
  EXPECT_EQ(served,
            (std::vector<std::pair<int64_t, bool>>{{8, false}, {7, true}, {9, false}, {7, true}}));
  queue.Push(Request(5, 1), {});  // alone in the line of all others
  queue.Push(Request(5, 2), {});
  EXPECT_EQ(queue.Pop().header.id, 1);
  EXPECT_EQ(queue.Pop().header.id, 2);
  EXPECT_TRUE(queue.empty());
}

TEST(RecentIdsTest, KeepsTheLast) {
  RecentIds ids(3);
  for (int64_t id = 1; id <= 4; ++id) ids.Add(id);
  ids.Add(2);
  ids.Add(5);
  EXPECT_FALSE(ids.Remove(1));
  EXPECT_FALSE(ids.Remove(3));
  EXPECT_TRUE(ids.Remove(2));
  EXPECT_FALSE(ids.Remove(2));
  EXPECT_TRUE(ids.Remove(4));
  EXPECT_TRUE(ids.Remove(5));
}

TEST(RequestQueueTest, ARequestThatIsSentAgainWaitsOnce) {
  RequestQueue queue;
  const std::vector<uint8_t> bytes{1, 2};
  EXPECT_EQ(queue.Push(Request(1, 1), bytes), PushResult::kTaken);
  EXPECT_EQ(queue.Push(Request(1, 1), bytes), PushResult::kWaiting);
  EXPECT_EQ(queue.Push(Request(2, 1), bytes), PushResult::kTaken);
  EXPECT_EQ(queue.Pop().bytes, bytes);
  EXPECT_EQ(queue.Pop().header.client, 2);
  EXPECT_TRUE(queue.empty());
  EXPECT_EQ(queue.Push(Request(1, 1), bytes), PushResult::kTaken);
}

}  // namespace splinemap::request_queue_test
