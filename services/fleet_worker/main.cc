#include <pthread.h>
#include <signal.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <string>

#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/config/usage_error.h"
#include "lib/fleet/fleet_flags.h"
#include "services/fleet_worker/fleet_worker.h"

namespace splinemap {
namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;
constexpr timespec kTick{0, 250'000'000};

constexpr const char* kExamples = R"(
Examples:
  splinemap-fleet-worker --fleet nats://hub-1:4222
  splinemap-fleet-worker --fleet tls://hub-1:4222,tls://hub-2:4222 --credentials worker-1
  splinemap-fleet-worker --fleet nats://localhost:4222 --fleet-map office --replicas 1

Answers queries about the map of a fleet of robots on NATS JetStream, until SIGINT (Ctrl-C) or
SIGTERM. Start two or more: they share the parts of the map, two workers have each part, and any of
them may be killed at any time. The first makes the map, if it is not there. Exit status: 0 ended by
signal, 1 failed, 2 usage.)";

void AddFlags(CLI::App& app, WorkerOptions& options) {
  app.footer(kExamples);
  app.set_version_flag("--version", SPLINEMAP_VERSION);
  AddFleetFlags(app, options.fleet)->required();
  app.add_option("--replicas", options.replicas,
                 "Servers that keep a map that is made (default: 3, or 1 of 1)")
      ->type_name("N")
      ->check(CLI::Range(1, 5));
  app.add_option("--knot-interval-m", options.knot_interval_m,
                 "Knot interval of a map that is made (default: 0.05)")
      ->type_name("M")
      ->check(CLI::Range(0.001, 10.0));
}

void Say(const std::string& text) { fmt::print(stderr, "{}\n", PlainLines(text)); }

void SayWhatMayBeLost(const FleetAddress& address) {
  const absl::StatusOr<std::string> version = ServerVersion(address);
  if (!version.ok()) return;  // Connect() says what is wrong
  const std::string loss = WhatServerMayLose(*version);
  Say(loss.empty() ? fmt::format("nats-server {} keeps what it acknowledged", *version) : loss);
}

// Blocks the signals that end the program in all threads, so that Run() gets them.
sigset_t BlockSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  signal(SIGPIPE, SIG_IGN);
  return signals;
}

absl::Status Run(const WorkerOptions& options, const sigset_t& signals) {
  SPLINEMAP_RETURN_IF_ERROR(CheckFleetAddress(options.fleet));
  SayWhatMayBeLost(options.fleet);
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<FleetWorker> worker,
                             FleetWorker::Start(options));
  bool was_ready = false;
  std::string problem;
  while (sigtimedwait(&signals, nullptr, &kTick) < 0) {
    worker->Tick();
    if (worker->IsOver()) return absl::PermissionDeniedError(worker->Problem());
    if (worker->Problem() != problem) {
      problem = worker->Problem();
      Say(problem.empty() ? "all is well again" : problem);
    }
    if (worker->IsReady() && !was_ready) Say(worker->Description() + " (Ctrl-C ends)");
    was_ready = worker->IsReady();
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("splinemap-fleet-worker: answers queries about the map of a fleet.",
               "splinemap-fleet-worker");
  WorkerOptions options;
  AddFlags(app, options);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    fmt::print(stderr, "{}\n", UsageErrorText(app, error));
    return kUsage;
  }
  const absl::Status status = Run(options, BlockSignals());
  if (status.ok()) return 0;
  Say(ErrorText(status));
  return absl::IsInvalidArgument(status) ? kUsage : kFailed;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
