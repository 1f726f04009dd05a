#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <thread>

#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/wire/lcm_bus.h"
#include "services/splinemapd/notice_log.h"
#include "services/splinemapd/request_server.h"
#include "services/splinemapd/work_steps.h"

namespace splinemap {

// Hands the messages of the bus to those who subscribed, and reports when the bus goes away. Two
// threads take turns: the one that receives a request serves it, and the other receives on. So
// requests do not wait for a thread to wake, nor messages for what is served. Thread-safe after
// Start().
class ReceivingThread {
 public:
  // Does not wait, for one message keeps all others waiting.
  using Handler =
      std::function<void(const std::string& channel, absl::Span<const uint8_t> message)>;

  // Both outlive it.
  ReceivingThread(LcmBus& bus, NoticeLog& notices) : bus_(bus), notices_(notices) {}

  // Before Start().
  void Subscribe(const std::string& channel, Handler handler);
  // Again only after Stop(). `requests` outlives Join().
  void Start(RequestServer& requests);

  // Messages of each channel so far. The channels do not change after Start().
  const std::map<std::string, std::atomic<int64_t>>& received() const { return received_; }

  const WorkSteps& steps() const { return steps_; }

  // Ends receiving, and handles what has arrived by now. What is served goes on until Join().
  void Stop();
  void Join();

 private:
  void Run(const std::stop_token& stop, RequestServer& requests);
  void ReceiveUntilRequest(const std::stop_token& stop, const RequestServer& requests);
  void ReportNews();

  LcmBus& bus_;
  NoticeLog& notices_;
  std::map<std::string, std::atomic<int64_t>> received_;
  WorkSteps steps_;
  Mutex turn_;  // whose thread has it receives
  std::array<std::jthread, 2> threads_;
};

}  // namespace splinemap
