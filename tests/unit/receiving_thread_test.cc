#include "services/splinemapd/receiving_thread.h"

#include <gtest/gtest.h>

#include <future>

#include "lib/rpc/messages.h"
#include "lib/wire/encode.h"
#include "tests/support/queries.h"
#include "tests/support/raw_message.h"

namespace splinemap::receiving_thread_test {

constexpr std::chrono::seconds kPatience(10);

// A request is served by the thread that received it; others come in meanwhile.
TEST(ReceivingThreadTest, WhatIsServedKeepsNoMessageWaiting) {
  const auto bus = *LcmBus::Open("memq://");
  NoticeLog notices([](bool, const std::string&) {});
  const auto map = RandomMap(1);
  NewestMap newest(map->options, {{"robot", 1}, {1, 5}, 20, map->tiles});
  std::promise<void> gate;
  std::promise<void> replied;
  RequestServer requests("MAP", newest,
                         [&](const std::string&, absl::Span<const uint8_t>) {
                           gate.get_future().wait();
                           replied.set_value();
                         },
                         {});
  std::promise<void> heard;
  ReceivingThread receiving(*bus, notices);
  receiving.Subscribe("MAP_POINTS_REQUESTS",
                      [&](const std::string&, auto message) { requests.Handle(message); });
  receiving.Subscribe("SCAN", [&](const std::string&, auto) { heard.set_value(); });
  receiving.Start(requests);
  points_request_t request{};
  request.header.daemon_nonce = 5;
  bus->Publish("MAP_POINTS_REQUESTS", request);
  bus->Publish("SCAN", RawMessage{{1}});
  EXPECT_EQ(heard.get_future().wait_for(kPatience), std::future_status::ready);
  gate.set_value();
  EXPECT_EQ(replied.get_future().wait_for(kPatience), std::future_status::ready);
  requests.Stop();
  receiving.Stop();
  EXPECT_EQ(receiving.received().at("SCAN"), 1);
}

TEST(ReceivingThreadTest, StoppedItHandsOverWhatHasCome) {
  const auto bus = *LcmBus::Open("memq://");
  NoticeLog notices([](bool, const std::string&) {});
  const auto map = RandomMap(1);
  NewestMap newest(map->options, {{"robot", 1}, {1, 5}, 20, map->tiles});
  RequestServer requests("MAP", newest, [](const std::string&, auto) {}, {});
  ReceivingThread receiving(*bus, notices);
  int heard = 0;
  receiving.Subscribe("SCAN", [&](const std::string&, auto) { ++heard; });
  for (int round = 1; round <= 2; ++round) {  // a daemon starts it again to end
    receiving.Start(requests);
    for (int n = 0; n < 100; ++n) bus->Publish("SCAN", RawMessage{{1}});
    receiving.Stop();
    EXPECT_EQ(heard, 100 * round);
  }
}

}  // namespace splinemap::receiving_thread_test
