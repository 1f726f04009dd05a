// Reads and writes single entries of a fleet's bucket, and asks and answers, as NatsFleetStore
// does.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <iostream>
#include <string>
#include <thread>

#include "lib/fleet/nats_fleet_store.h"

namespace splinemap {
namespace {

int Fail(const absl::Status& status) {
  fmt::print(stderr, "{}\n", status.ToString());
  return 1;
}

int Run(int argc, char** argv) {
  CLI::App app{"fleet_entry: reads and writes single entries of a fleet's bucket."};
  FleetAddress address;
  address.program = "fleet_entry";
  std::string key;
  std::string value;
  int replicas = 1;
  app.add_option("--fleet", address.servers)->required();
  app.add_option("--fleet-map", address.map);
  app.add_option("--credentials", address.credentials);
  app.require_subcommand(1);
  auto* const make = app.add_subcommand("make", "makes the bucket");
  make->add_option("--replicas", replicas);
  auto* const put = app.add_subcommand("put", "writes an entry, whatever it was");
  auto* const put_new = app.add_subcommand("put-new", "writes an entry that was not there");
  auto* const keep = app.add_subcommand("keep", "writes an entry again and again, until refused");
  auto* const get = app.add_subcommand("get", "prints the value of an entry");
  auto* const list = app.add_subcommand("list", "prints the keys of a filter");
  auto* const ask = app.add_subcommand("ask", "prints what those who answer a subject say");
  auto* const answer = app.add_subcommand("answer", "answers a subject until standard input ends");
  auto* const tell = app.add_subcommand("tell", "says something to those who listen");
  auto* const listen = app.add_subcommand("listen", "prints that, until standard input ends");
  for (CLI::App* const command : {put, put_new, keep, get, list, ask, answer, tell, listen}) {
    command->add_option("key", key)->required();
  }
  for (CLI::App* const command : {put, put_new, keep, ask, answer, tell}) {
    command->add_option("value", value)->required();
  }
  CLI11_PARSE(app, argc, argv);

  auto connected = NatsFleetStore::Connect(address);
  if (!connected.ok()) return Fail(connected.status());
  NatsFleetStore& store = **connected;
  absl::Status status;
  if (*make) status = store.MakeBucket(replicas);
  if (*put) status = store.Put({{key, value, 1}});
  if (*put_new) status = store.PutIf({key, value, 1}, 0).status();
  if (*keep) {
    while (!absl::IsPermissionDenied(status)) {
      status = store.Put({{key, value, 1}});
      fmt::print(stderr, "{}\n", status.ToString());
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    fmt::print("{}\n", store.Problem());
  }
  if (*get) {
    const auto entry = store.Get(key);
    status = entry.status();
    if (entry.ok()) fmt::print("{}\n", entry->value);
  }
  if (*list) {
    status = store.List(key, false, [](const FleetEntry& entry) { fmt::print("{}\n", entry.key); });
  }
  if (*ask) {
    const auto reply = store.Request(key, value, std::chrono::seconds(5));
    status = reply.status();
    if (reply.ok()) fmt::print("{}\n", *reply);
  }
  if (*answer) {
    const auto serving =
        store.Serve(key, "workers", [&](const std::string&, const std::string& reply_to) {
          static_cast<void>(store.Tell(reply_to, value));
        });
    if (!serving.ok()) return Fail(serving.status());
    fmt::print(stderr, "answering\n");
    while (std::cin.get() != EOF) {
    }
  }
  if (*tell) status = store.Tell(key, value);
  if (*listen) {
    const auto listening = store.Listen(key, [](const std::string& message) {
      fmt::print("{}\n", message);
      std::fflush(stdout);
    });
    if (!listening.ok()) return Fail(listening.status());
    fmt::print(stderr, "listening\n");
    while (std::cin.get() != EOF) {
    }
  }
  return status.ok() ? 0 : Fail(status);
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Run(argc, argv); }
