#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "lib/base/clock.h"
#include "lib/fleet/nats_fleet_store.h"
#include "tests/support/child_process.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {

// A port of 127.0.0.1 that nobody uses at the moment.
inline int FreePort() {
  const int listener = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  EXPECT_EQ(bind(listener, reinterpret_cast<sockaddr*>(&address), size), 0);
  EXPECT_EQ(getsockname(listener, reinterpret_cast<sockaddr*>(&address), &size), 0);
  close(listener);
  return ntohs(address.sin_port);
}

// A nats-server with JetStream on 127.0.0.1, which ends with this. Its folder stays until then.
class NatsServer {
 public:
  NatsServer() : port_(FreePort()) { Start(); }
  ~NatsServer() { Kill(); }

  std::string url() const { return "nats://127.0.0.1:" + std::to_string(port_); }
  FleetAddress address(const std::string& map = "map") const {
    FleetAddress address;
    address.servers = url();
    address.map = map;
    return address;
  }

  void Start() {
    process_ = std::make_unique<ChildProcess>(
        std::vector<std::string>{"nats-server", "-a", "127.0.0.1", "-p", std::to_string(port_),
                                 "-js", "-sd", folder_.path(), "-l", folder_.path() + "/log"});
    for (const auto end = Clock::now() + std::chrono::seconds(20);;) {
      if (NatsFleetStore::Connect(address()).ok()) return;
      ASSERT_LT(Clock::now(), end) << "nats-server does not start";
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }
  void Kill() {
    if (process_) kill(process_->pid(), SIGKILL);
    process_.reset();
  }
  // All that is stored. Requires that it does not run.
  void Forget() { std::filesystem::remove_all(folder_.path() + "/jetstream"); }

 private:
  const int port_;
  TemporaryDirectory folder_;
  std::unique_ptr<ChildProcess> process_;
};

}  // namespace splinemap
