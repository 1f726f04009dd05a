#include "lib/wire/lcm_bus.h"

#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <exception>
#include <thread>
#include <utility>

#include "lib/base/status.h"
#include "lib/wire/udp_sockets.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// Messages that LCM keeps per subscription until Handle() gets to them; beyond, it drops the newest
// in silence.
constexpr int kQueueCapacity = 10'000;

constexpr std::chrono::seconds kCheckInterval(1);

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

void Forward(const lcm_recv_buf_t* buffer, const char* channel, void* handler) {
  // An exception would pass through the C code of liblcm, whose next handle() then aborts.
  try {
    (*static_cast<LcmBus::Handler*>(handler))(
        channel, {static_cast<const uint8_t*>(buffer->data), buffer->data_size});
  } catch (const std::exception&) {  // out of memory
    ++failed_handlers;
  }
}

// liblcm passes its descriptors to select(), which aborts on those from FD_SETSIZE on.
absl::Status CheckDescriptors() {
  std::array<int, 8> descriptors{};  // it takes 6
  for (int& fd : descriptors) fd = open("/dev/null", O_RDONLY | O_CLOEXEC);
  const int error = errno;
  const auto [least, greatest] = std::minmax_element(descriptors.begin(), descriptors.end());
  const bool are_open = *least >= 0;
  const bool are_small = *greatest < FD_SETSIZE;
  for (const int fd : descriptors) {
    if (fd >= 0) close(fd);
  }
  if (!are_open) return Unavailable("no LCM bus can be opened: {}", std::strerror(error));
  if (are_small) return absl::OkStatus();
  return Unavailable(
      "no LCM bus can be opened: this program has too many files open; LCM needs "
      "some of the first {} descriptors",
      FD_SETSIZE);
}

// liblcm waits for ever for the rest of a message, and for a server that takes nothing.
void LimitWaiting(int server) {
  constexpr timeval kPatience{1, 0};
  constexpr int kOn = 1;
  constexpr int kIdle_s = 5;  // until a server that is silent is asked whether it is there
  constexpr unsigned kUnanswered_ms = 10'000;
  setsockopt(server, SOL_SOCKET, SO_RCVTIMEO, &kPatience, sizeof(kPatience));
  setsockopt(server, SOL_SOCKET, SO_SNDTIMEO, &kPatience, sizeof(kPatience));
  setsockopt(server, SOL_SOCKET, SO_KEEPALIVE, &kOn, sizeof(kOn));
  setsockopt(server, IPPROTO_TCP, TCP_KEEPIDLE, &kIdle_s, sizeof(kIdle_s));
  setsockopt(server, IPPROTO_TCP, TCP_KEEPINTVL, &kIdle_s, sizeof(kIdle_s));
  setsockopt(server, IPPROTO_TCP, TCP_USER_TIMEOUT, &kUnanswered_ms, sizeof(kUnanswered_ms));
}

}  // namespace

absl::StatusOr<std::unique_ptr<LcmBus>> LcmBus::Open(const std::string& url) {
  SPLINEMAP_ASSIGN_OR_RETURN(BusAddress address, BusAddress::Parse(url));
  std::unique_ptr<LcmBus> bus(new LcmBus(std::move(address)));
  if (bus->address_.is_network()) {
    bus->CheckReceiver();
  } else {
    SPLINEMAP_RETURN_IF_ERROR(bus->ConnectReceiver());
  }
  return bus;
}

LcmBus::LcmBus(BusAddress address)
    : address_(std::move(address)), wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

LcmBus::~LcmBus() {
  if (wake_ >= 0) close(wake_);
}

void LcmBus::Wake() { eventfd_write(wake_, 1); }

absl::StatusOr<LcmBus::Lcm> LcmBus::Connect() const {
  SPLINEMAP_RETURN_IF_ERROR(CheckDescriptors());
  Lcm lcm(lcm_create(address_.url().c_str()));
  if (!lcm || IsClosed(lcm.get())) {
    return Unavailable("the LCM bus {} cannot be opened", address_.url());
  }
  if (address_.is_tcpq()) LimitWaiting(lcm_get_fileno(lcm.get()));
  return lcm;
}

void LcmBus::Subscribe(const std::string& channel, Handler handler) {
  SubscribeTo(Literal(channel), std::move(handler));
}

void LcmBus::SubscribeToAll(Handler handler) { SubscribeTo(".*", std::move(handler)); }

void LcmBus::SubscribeTo(std::string pattern, Handler handler) {
  subscriptions_.push_back({std::move(pattern), std::move(handler)});
  if (!receiver_) return;
  if (const absl::Status status = SubscribeIn(receiver_.get(), subscriptions_.back());
      !status.ok()) {
    receiver_.reset();
    SetProblem(receive_problem_, status);
  }
}

absl::Status LcmBus::SubscribeIn(lcm_t* lcm, Subscription& subscription) const {
  lcm_subscription_t* const subscribed =
      lcm_subscribe(lcm, subscription.pattern.c_str(), &Forward, &subscription.handler);
  if (subscribed == nullptr) return CannotReceive();
  lcm_subscription_set_queue_capacity(subscribed, kQueueCapacity);
  return absl::OkStatus();
}

absl::Status LcmBus::ConnectReceiver() {
  SPLINEMAP_ASSIGN_OR_RETURN(Lcm lcm, Connect());
  if (lcm_get_fileno(lcm.get()) < 0) return CannotReceive();
  for (Subscription& subscription : subscriptions_) {
    SPLINEMAP_RETURN_IF_ERROR(SubscribeIn(lcm.get(), subscription));
  }
  receiver_ = std::move(lcm);
  return absl::OkStatus();
}

void LcmBus::CheckReceiver() {
  if (!address_.is_network() || Clock::now() < next_look_) return;
  // A connection to a server tells when it breaks. Multicast does not, and an interface that comes
  // back has forgotten who listens.
  absl::Status status;
  if (!receiver_ || address_.is_udpm()) status = address_.Reach();
  if (!status.ok()) {
    receiver_.reset();
  } else if (!receiver_) {
    status = ConnectReceiver();
  }
  SetProblem(receive_problem_, status);
  if (status.ok() && !Problem().empty()) {  // though nobody publishes at the moment
    MutexLock lock(publish_mutex_);
    CheckSender();
  }
  next_look_ = Clock::now() + kCheckInterval;
}

void LcmBus::CheckSender() {
  if (sender_ || Clock::now() < next_try_) return;
  absl::Status status = address_.Reach();
  if (status.ok()) {
    absl::StatusOr<Lcm> lcm = Connect();
    status = lcm.status();
    if (lcm.ok()) sender_ = *std::move(lcm);
  }
  SetProblem(send_problem_, status);
  next_try_ = Clock::now() + kCheckInterval;
}

// liblcm gives connections to a server that are none, and aborts when they are used. With multicast
// to ask for the descriptor is to receive.
bool LcmBus::IsClosed(lcm_t* lcm) const { return address_.is_tcpq() && lcm_get_fileno(lcm) < 0; }

// Where liblcm did not hear itself.
absl::Status LcmBus::CannotReceive() const {
  return Unavailable("nothing can be received on the LCM bus {}; does a firewall keep it away?",
                     address_.url());
}

absl::Status LcmBus::Broke() const {
  return Unavailable("the LCM bus {} broke off; it is looked for once a second", address_.url());
}

void LcmBus::SetProblem(std::string& problem, const absl::Status& status) {
  MutexLock lock(problem_mutex_);
  problem = ErrorText(status);
}

std::string LcmBus::Problem() const {
  MutexLock lock(problem_mutex_);
  return receive_problem_.empty() ? send_problem_ : receive_problem_;
}

std::optional<std::string> LcmBus::DrainNews() {
  std::string problem = Problem();
  if (std::exchange(is_problem_told_, !problem.empty()) == !problem.empty()) return std::nullopt;
  return problem.empty() ? fmt::format("the LCM bus {} works again", address_.url()) : problem;
}

int64_t LcmBus::FailedHandlers() { return failed_handlers; }

// Also what makes every program with a bus link the guard in udp_sockets.cc.
int64_t LcmBus::LostDatagrams() { return CountLostDatagrams(); }

void LcmBus::PublishBytes(const std::string& channel, absl::Span<const uint8_t> message) {
  // On tcpq, publishing from two threads at once corrupts the stream.
  MutexLock lock(publish_mutex_);
  if (!address_.is_network()) {
    lcm_publish(receiver_.get(), channel.c_str(), message.data(),
                static_cast<unsigned>(message.size()));
    return;
  }
  CheckSender();
  if (!sender_) return;
  lcm_publish(sender_.get(), channel.c_str(), message.data(),
              static_cast<unsigned>(message.size()));
  // liblcm closes a connection that breaks. Datagrams have none; what stands in their way is found
  // by CheckReceiver().
  if (IsClosed(sender_.get())) {
    sender_.reset();
    SetProblem(send_problem_, Broke());
  }
}

LcmBus::Handled LcmBus::Handle(milliseconds timeout) {
  const Clock::time_point end = Clock::now() + timeout;
  while (true) {
    CheckReceiver();
    const auto left =
        std::max(std::chrono::ceil<milliseconds>(end - Clock::now()), milliseconds(0));
    const auto wait = std::min<milliseconds>(left, kCheckInterval);
    // A negative descriptor is ignored.
    pollfd descriptors[] = {{wake_, POLLIN, 0},
                            {receiver_ ? lcm_get_fileno(receiver_.get()) : -1, POLLIN, 0}};
    poll(descriptors, std::size(descriptors), static_cast<int>(wait.count()));
    if (descriptors[1].revents != 0) {
      if (lcm_handle(receiver_.get()) >= 0) return Handled::kMessage;
      SetProblem(receive_problem_, Broke());
      if (address_.is_network()) {
        receiver_.reset();
      } else {  // a log at its end
        std::this_thread::sleep_for(wait);
      }
      return Handled::kBroken;
    }
    eventfd_t wakes = 0;
    const bool is_woken = eventfd_read(wake_, &wakes) == 0;
    if (is_woken || Clock::now() >= end) return receiver_ ? Handled::kNothing : Handled::kBroken;
  }
}

}  // namespace splinemap
