#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
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

// Three of them with JetStream, which are one cluster, on 127.0.0.1 and the ports from `first_port`
// to five more. They end with this.
class NatsCluster {
 public:
  static constexpr int kServers = 3;
  static std::string NameOf(int server) { return "server" + std::to_string(server + 1); }

  explicit NatsCluster(int first_port) : first_port_(first_port) {
    for (int server = 0; server < kServers; ++server) Start(server);
    for (const auto end = Clock::now() + std::chrono::seconds(20); Clock::now() < end;) {
      FleetAddress address;
      address.servers = urls();
      if (NatsFleetStore::Connect(address).ok()) return;
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    ADD_FAILURE() << "nats-server does not start";
  }
  ~NatsCluster() {
    for (int server = 0; server < kServers; ++server) Kill(server);
  }

  std::string urls() const {
    std::string urls;
    for (int server = 0; server < kServers; ++server) {
      urls += (server > 0 ? "," : "") + UrlOf(first_port_ + server);
    }
    return urls;
  }
  void Start(int server) {
    std::string routes;
    for (int k = 0; k < kServers; ++k) routes += (k > 0 ? "," : "") + UrlOf(RoutePort(k));
    processes_[server] = std::make_unique<ChildProcess>(std::vector<std::string>{
        "nats-server", "-n", NameOf(server), "-a", "127.0.0.1", "-p",
        std::to_string(first_port_ + server), "-js", "-sd", FolderOf(server), "--cluster_name",
        "fleet", "--cluster", UrlOf(RoutePort(server)), "--routes", routes, "-l",
        folder_.File(NameOf(server) + ".log")});
  }
  void Kill(int server) {
    if (processes_[server]) kill(processes_[server]->pid(), SIGKILL);
    processes_[server].reset();
  }
  // All that it has stored. Requires that it does not run.
  void Forget(int server) { std::filesystem::remove_all(FolderOf(server)); }

 private:
  static std::string UrlOf(int port) { return "nats://127.0.0.1:" + std::to_string(port); }
  int RoutePort(int server) const { return first_port_ + kServers + server; }
  std::string FolderOf(int server) const { return folder_.File(NameOf(server)); }

  const int first_port_;
  TemporaryDirectory folder_;
  std::array<std::unique_ptr<ChildProcess>, kServers> processes_;
};

}  // namespace splinemap
