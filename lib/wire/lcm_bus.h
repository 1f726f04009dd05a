#pragma once

#include <lcm/lcm.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/wire/bus_address.h"
#include "lib/wire/encode.h"

namespace splinemap {

// A connection to an LCM bus. A network that is not there, or goes away, is a problem, not an
// error: it is looked for once a second and, when it is there, everything is subscribed to again.
// What is published meanwhile is lost. Messages come as bytes: what they claim to be is not checked
// here. One thread at a time calls Subscribe(), Handle() and DrainNews(); the rest is thread-safe.
class LcmBus {
 public:
  // Runs in the thread that calls Handle(). A message with which it throws is lost, and counted.
  using Handler = std::function<void(const std::string& channel, absl::Span<const uint8_t>)>;

  // `url` as BusAddress::Parse() takes it; its errors, and Unavailable for a file:// that cannot be
  // opened.
  static absl::StatusOr<std::unique_ptr<LcmBus>> Open(const std::string& url);
  ~LcmBus();

  // Subscribes to exactly this channel, whatever characters it has.
  void Subscribe(const std::string& channel, Handler handler);
  void SubscribeToAll(Handler handler);

  // Messages whose handlers threw, in this process: the memory was full.
  static int64_t FailedHandlers();

  // As CountLostDatagrams() in udp_sockets.h.
  static int64_t LostDatagrams();

  // Why the bus does not work at the moment, and what to do; empty while it does.
  std::string Problem() const;
  // Since the last call: the problem that came up, or that the bus works again.
  std::optional<std::string> DrainNews();

  // Ends a Handle() that waits, or the next one. Any thread.
  void Wake();

  enum class Handled { kMessage, kNothing, kBroken };
  // Waits for a message and hands it to its handler. kNothing after `timeout` without one; kBroken
  // when the bus breaks off, and after `timeout` while it does not work. Looking for a server takes
  // a second more.
  Handled Handle(std::chrono::milliseconds timeout);

  template <typename Message>
  void Publish(const std::string& channel, const Message& message) {
    PublishBytes(channel, Encode(message));
  }
  // A message that is encoded already. Waits, for a second or two, for a server that does not take
  // it.
  void PublishBytes(const std::string& channel, absl::Span<const uint8_t> message);

 private:
  struct Destroy {
    void operator()(lcm_t* lcm) const { lcm_destroy(lcm); }
  };
  using Lcm = std::unique_ptr<lcm_t, Destroy>;
  struct Subscription {
    std::string pattern;
    Handler handler;
  };

  explicit LcmBus(BusAddress address);
  void SubscribeTo(std::string pattern, Handler handler);
  absl::StatusOr<Lcm> Connect() const;
  absl::Status SubscribeIn(lcm_t* lcm, Subscription& subscription) const;
  absl::Status ConnectReceiver();
  void CheckReceiver();
  void CheckSender() ABSL_EXCLUSIVE_LOCKS_REQUIRED(publish_mutex_);
  bool IsClosed(lcm_t* lcm) const;
  absl::Status CannotReceive() const;
  absl::Status Broke() const;
  void SetProblem(std::string& problem, const absl::Status& status);

  const BusAddress address_;
  const int wake_;  // an eventfd

  // Of the thread that handles. In a network the two directions have a connection each, since
  // liblcm closes one that breaks under the feet of other threads.
  Lcm receiver_;
  Clock::time_point next_look_;
  std::deque<Subscription> subscriptions_;
  bool is_problem_told_ = false;

  Mutex publish_mutex_;
  Lcm sender_ ABSL_GUARDED_BY(publish_mutex_);
  Clock::time_point next_try_ ABSL_GUARDED_BY(publish_mutex_);

  mutable Mutex problem_mutex_;
  std::string receive_problem_ ABSL_GUARDED_BY(problem_mutex_);
  std::string send_problem_ ABSL_GUARDED_BY(problem_mutex_);
};

}  // namespace splinemap
