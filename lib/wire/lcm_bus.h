#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lcm/lcm-cpp.hpp"
#include "lib/base/mutex.h"

namespace splinemap {

// One connection to an LCM bus. Messages come as bytes: what they claim to be is not checked here.
// One thread calls Subscribe() and Handle(); Publish() is thread-safe.
class LcmBus {
 public:
  // Runs in the thread of Handle(). A message with which it throws is lost, and counted.
  using Handler = std::function<void(const std::string& channel, absl::Span<const uint8_t>)>;

  // `url` as LCM takes it; empty for LCM's default. Unavailable with a hint when LCM cannot open
  // it.
  static absl::StatusOr<std::unique_ptr<LcmBus>> Open(const std::string& url);

  // Subscribes to exactly this channel, whatever characters it has.
  void Subscribe(const std::string& channel, Handler handler);
  void SubscribeToAll(Handler handler);

  // Messages whose handlers threw, in this process: the memory was full.
  static int64_t FailedHandlers();

  // As CountLostDatagrams() in udp_sockets.h.
  static int64_t LostDatagrams();

  enum class Handled { kMessage, kNothing, kBroken };
  // Waits for a message and hands it to its handler. kNothing after `timeout` without one; kBroken,
  // also after `timeout`, where the connection does not work.
  Handled Handle(std::chrono::milliseconds timeout);

  template <typename Message>
  void Publish(const std::string& channel, const Message& message) {
    // On tcpq, publishing from two threads at once corrupts the stream.
    MutexLock lock(publish_mutex_);
    lcm_.publish(channel, &message);
  }
  // A message that is encoded already.
  void PublishBytes(const std::string& channel, absl::Span<const uint8_t> message);

 private:
  explicit LcmBus(const std::string& url) : lcm_(url) {}
  void SubscribeTo(const std::string& pattern, Handler handler);

  lcm::LCM lcm_;
  Mutex publish_mutex_;
  std::vector<std::unique_ptr<Handler>> handlers_;
};

}  // namespace splinemap
