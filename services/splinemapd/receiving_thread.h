#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <thread>

#include "absl/types/span.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/notice_log.h"
#include "services/splinemapd/work_steps.h"

namespace splinemap {

// Hands the messages of the bus to those who subscribed, in a thread of its own, and reports when
// the bus goes away. Thread-safe after Start().
class ReceivingThread {
 public:
  // Does not wait, for one message keeps all others waiting.
  using Handler =
      std::function<void(const std::string& channel, absl::Span<const uint8_t> message)>;

  // Both outlive it.
  ReceivingThread(LcmBus& bus, NoticeLog& notices) : bus_(bus), notices_(notices) {}

  // Before Start().
  void Subscribe(const std::string& channel, Handler handler);
  void Start();

  // Messages of each channel so far. The channels do not change after Start().
  const std::map<std::string, std::atomic<int64_t>>& received() const { return received_; }

  const WorkSteps& steps() const { return steps_; }

  // Handles what has arrived by now, and ends the thread.
  void Stop();

 private:
  void Run(const std::stop_token& stop);
  void ReportNews();

  LcmBus& bus_;
  NoticeLog& notices_;
  std::map<std::string, std::atomic<int64_t>> received_;
  WorkSteps steps_;
  std::jthread receiving_;
};

}  // namespace splinemap
