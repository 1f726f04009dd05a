#include "lib/wire/lcm_bus.h"

#include <atomic>
#include <cctype>
#include <cstdlib>
#include <exception>
#include <thread>

#include "lib/base/status.h"
#include "lib/wire/udp_sockets.h"

namespace splinemap {
namespace {

// Messages that LCM keeps per subscription until Handle() gets to them; beyond, it drops the newest
// in silence.
constexpr int kQueueCapacity = 10'000;

// LCM takes a channel for a regular expression ^channel$, without a group around it.
std::string Literal(const std::string& channel) {
  std::string escaped;
  for (const char c : channel) {
    if (std::ispunct(static_cast<unsigned char>(c)) && c != '_') escaped += '\\';
    escaped += c;
  }
  return escaped;
}

std::atomic<int64_t> failed_handlers = 0;

void Forward(const lcm::ReceiveBuffer* buffer, const std::string& channel,
             LcmBus::Handler* handler) {
  // An exception would pass through the C code of liblcm, whose next handle() then aborts.
  try {
    (*handler)(channel, {static_cast<const uint8_t*>(buffer->data), buffer->data_size});
  } catch (const std::exception&) {  // out of memory
    ++failed_handlers;
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<LcmBus>> LcmBus::Open(const std::string& url) {
  std::unique_ptr<LcmBus> bus(new LcmBus(url));
  if (!bus->lcm_.good()) {
    const char* variable = std::getenv("LCM_DEFAULT_URL");
    const std::string used = !url.empty() || variable == nullptr ? url : variable;
    const bool is_udpm = used.empty() || used.starts_with("udpm:");
    return Unavailable("cannot open the LCM bus {}{}{}", used.empty() ? "(LCM's default)" : used,
                       url.empty() && variable != nullptr ? ", from LCM_DEFAULT_URL" : "",
                       is_udpm ? "; is there a multicast route? Try: sudo ip link set lo multicast "
                                 "on && sudo ip route add 224.0.0.0/4 dev lo"
                               : "");
  }
  return bus;
}

void LcmBus::Subscribe(const std::string& channel, Handler handler) {
  SubscribeTo(Literal(channel), std::move(handler));
}

void LcmBus::SubscribeToAll(Handler handler) { SubscribeTo(".*", std::move(handler)); }

void LcmBus::SubscribeTo(const std::string& pattern, Handler handler) {
  handlers_.push_back(std::make_unique<Handler>(std::move(handler)));
  lcm::Subscription* subscription =
      lcm_.subscribeFunction(pattern, &Forward, handlers_.back().get());
  subscription->setQueueCapacity(kQueueCapacity);
}

int64_t LcmBus::FailedHandlers() { return failed_handlers; }

// Also what makes every program with a bus link the guard in udp_sockets.cc.
int64_t LcmBus::LostDatagrams() { return CountLostDatagrams(); }

void LcmBus::PublishBytes(const std::string& channel, absl::Span<const uint8_t> message) {
  MutexLock lock(publish_mutex_);
  lcm_.publish(channel, message.data(), static_cast<unsigned>(message.size()));
}

LcmBus::Handled LcmBus::Handle(std::chrono::milliseconds timeout) {
  const int result = lcm_.handleTimeout(static_cast<int>(timeout.count()));
  if (result > 0) return Handled::kMessage;
  if (result == 0) return Handled::kNothing;
  std::this_thread::sleep_for(timeout);  // do not spin on it
  return Handled::kBroken;
}

}  // namespace splinemap
