// Buses that break, on a network of their own.
#include "lib/wire/lcm_bus.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <string>
#include <thread>
#include <vector>

namespace splinemap::lcm_bus_test {

using std::chrono::milliseconds;
using std::chrono::seconds;
using std::chrono::steady_clock;

// What a server of tcpq says to each who connects; then it is silent and takes nothing.
class FakeServer {
 public:
  explicit FakeServer(std::string greeting, uint16_t port = 0) : greeting_(std::move(greeting)) {
    constexpr int kOn = 1;
    setsockopt(listening_, SOL_SOCKET, SO_REUSEADDR, &kOn, sizeof(kOn));
    sockaddr_in place{};
    place.sin_family = AF_INET;
    place.sin_port = htons(port);
    place.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(bind(listening_, reinterpret_cast<sockaddr*>(&place), sizeof(place)), 0);
    EXPECT_EQ(listen(listening_, 16), 0);
    socklen_t size = sizeof(place);
    getsockname(listening_, reinterpret_cast<sockaddr*>(&place), &size);
    port_ = ntohs(place.sin_port);
    serving_ = std::jthread([this] {
      for (int fd = 0; (fd = accept(listening_, nullptr, nullptr)) >= 0;) {
        send(fd, greeting_.data(), greeting_.size(), MSG_NOSIGNAL);
        accepted_.push_back(fd);
      }
    });
  }
  ~FakeServer() {
    shutdown(listening_, SHUT_RDWR);
    serving_.join();
    for (const int fd : accepted_) close(fd);
    close(listening_);
  }

  uint16_t port() const { return port_; }
  std::string url() const { return "tcpq://127.0.0.1:" + std::to_string(port_); }

  static std::string Greeting() { return {"\x28\x76\x17\xfa\0\0\1\0", 8}; }
  // A message of the channel A.
  static std::string Message(const std::string& content) {
    return std::string("\0\0\0\1\0\0\0\1A\0\0\0", 12) + static_cast<char>(content.size()) + content;
  }

 private:
  const std::string greeting_;
  const int listening_ = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  uint16_t port_ = 0;
  std::vector<int> accepted_;
  std::jthread serving_;
};

template <typename Condition>
bool Handles(LcmBus& bus, Condition until) {
  const auto end = steady_clock::now() + seconds(10);
  while (!until()) {
    if (steady_clock::now() > end) return false;
    bus.Handle(milliseconds(20));
  }
  return true;
}

std::string SilentUrl() {
  const FakeServer gone("");
  return gone.url();
}

TEST(BusAddressTest, WhatCanNeverBeOpenedIsRefusedInWords) {
  for (const char* url :
       {"udpm:/", "nonsense", "mpudp://x", "udpm://here:7667", "udpm://239.255.76.67",
        "udpm://239.255.76.67:99999", "udpm://10.0.0.1:7667", "tcpq://robot:7700",
        "tcpq://127.0.0.1:0", "tcpq://127.0.0.1:x", "tcpq://127.0.0.1:-1", "://", "udpm://:7667"}) {
    const auto bus = LcmBus::Open(url);
    EXPECT_TRUE(absl::IsInvalidArgument(bus.status())) << url;
  }
  for (const char* url :
       {"udpm://", "udpm://239.255.76.67:7667?ttl=0", "tcpq://", "tcpq://127.0.0.1",
        "tcpq://127.0.0.1:1", "memq://", "file:///x?mode=r"}) {
    EXPECT_TRUE(BusAddress::Parse(url).ok()) << url;
  }
}

TEST(LcmBusTest, AServerThatIsNotThereIsSaidOnceAndWaitedFor) {
  const auto bus = *LcmBus::Open(SilentUrl());
  bus->Subscribe("A", [](const std::string&, absl::Span<const uint8_t>) {});
  EXPECT_NE(bus->DrainNews().value_or("").find("Connection refused"), std::string::npos);
  for (int k = 0; k < 30; ++k) {
    bus->PublishBytes("A", {});
    EXPECT_EQ(bus->Handle(milliseconds(50)), LcmBus::Handled::kBroken);
  }
  EXPECT_EQ(bus->DrainNews(), std::nullopt);
}

TEST(LcmBusTest, AServerThatComesLateOrAgainGetsAllSubscriptions) {
  int heard = 0;
  auto server = std::make_unique<FakeServer>(FakeServer::Greeting());
  const uint16_t port = server->port();
  const std::string url = server->url();
  server.reset();
  const auto bus = *LcmBus::Open(url);
  bus->Subscribe("A", [&](const std::string&, absl::Span<const uint8_t> m) {
    heard += static_cast<int>(m.size());
  });
  bus->DrainNews();
  for (int start = 1; start <= 3; ++start) {
    server = std::make_unique<FakeServer>(FakeServer::Greeting() + FakeServer::Message("1"), port);
    EXPECT_TRUE(Handles(*bus, [&] { return heard == start; })) << start;
    EXPECT_EQ(bus->DrainNews(), "the LCM bus " + url + " works again");
    server.reset();
    EXPECT_TRUE(Handles(*bus, [&] { return !bus->Problem().empty(); })) << start;
    EXPECT_NE(bus->DrainNews(), std::nullopt);
  }
}

TEST(LcmBusTest, AServerThatIsSilentOrStopsInAMessageKeepsNobodyWaiting) {
  const std::string message = FakeServer::Message("whole");
  for (const std::string& greeting :
       {std::string(), FakeServer::Greeting().substr(0, 5), std::string("HTTP/1.1 400 Bad\r\n\r\n"),
        FakeServer::Greeting() + message.substr(0, 3),
        FakeServer::Greeting() + message.substr(0, message.size() - 1),
        FakeServer::Greeting() + std::string("\0\0\0\1\xff\xff\xff\xff", 8)}) {
    const FakeServer server(greeting);
    const auto begin = steady_clock::now();
    const auto bus = *LcmBus::Open(server.url());
    bus->Subscribe("A", [](const std::string&, absl::Span<const uint8_t>) { ADD_FAILURE(); });
    EXPECT_TRUE(Handles(*bus, [&] { return !bus->Problem().empty(); })) << greeting.size();
    EXPECT_LT(steady_clock::now() - begin, seconds(8)) << greeting.size();
  }
}

TEST(LcmBusTest, AServerThatTakesNothingDoesNotKeepWhoPublishesForEver) {
  const FakeServer server(FakeServer::Greeting());
  const auto bus = *LcmBus::Open(server.url());
  const std::vector<uint8_t> message(1 << 20);
  const auto end = steady_clock::now() + seconds(20);
  while (bus->Problem().empty() && steady_clock::now() < end) bus->PublishBytes("A", message);
  EXPECT_FALSE(bus->Problem().empty());
}

TEST(LcmBusTest, WhoPublishesWhileTheServerComesAndGoesDoesNotHarmOtherFiles) {
  auto server = std::make_unique<FakeServer>(FakeServer::Greeting());
  const uint16_t port = server->port();
  const auto bus = *LcmBus::Open(server->url());
  std::jthread publishing([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      bus->PublishBytes("A", std::vector<uint8_t>(100));
      std::this_thread::sleep_for(std::chrono::microseconds(100));
    }
  });
  // Closing a descriptor twice would close one of these.
  std::jthread opening([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      const int fd = open("/dev/null", O_RDONLY);
      std::this_thread::yield();
      EXPECT_EQ(close(fd), 0);
    }
  });
  for (int k = 0; k < 4; ++k) {
    server.reset();
    EXPECT_TRUE(Handles(*bus, [&] { return !bus->Problem().empty(); }));
    server = std::make_unique<FakeServer>(FakeServer::Greeting(), port);
    EXPECT_TRUE(Handles(*bus, [&] { return bus->Problem().empty(); }));
  }
}

TEST(LcmBusTest, WithoutDescriptorsThatLcmCanTakeItSaysSoAndWaits) {
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit raised{std::min<rlim_t>(4096, before.rlim_max), before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &raised), 0);
  std::vector<int> taken;
  while (taken.empty() || (taken.back() >= 0 && taken.back() < FD_SETSIZE)) {
    taken.push_back(open("/dev/null", O_RDONLY));
  }
  const auto bus = *LcmBus::Open("");
  bus->SubscribeToAll([](const std::string&, absl::Span<const uint8_t>) {});
  bus->PublishBytes("A", {});
  EXPECT_EQ(bus->Handle(milliseconds(20)), LcmBus::Handled::kBroken);
  EXPECT_NE(bus->Problem().find("too many"), std::string::npos) << bus->Problem();
  for (const int fd : taken) close(fd);
  setrlimit(RLIMIT_NOFILE, &before);
  EXPECT_TRUE(Handles(*bus, [&] { return bus->Problem().empty(); })) << bus->Problem();
}

}  // namespace splinemap::lcm_bus_test
