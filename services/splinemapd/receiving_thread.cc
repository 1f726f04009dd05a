#include "services/splinemapd/receiving_thread.h"

#include <optional>
#include <utility>

#include "lib/base/clock.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// The bus itself is looked after once a second.
constexpr milliseconds kLongest(1000);
// Messages that are still under way at the end are received for at most this long.
constexpr milliseconds kMaxDrain(500);

}  // namespace

void ReceivingThread::Subscribe(const std::string& channel, Handler handler) {
  std::atomic<int64_t>& received = received_[channel];
  bus_.Subscribe(channel, [&received, handler = std::move(handler)](
                              const std::string& name, absl::Span<const uint8_t> message) {
    ++received;
    handler(name, message);
  });
}

void ReceivingThread::Start(RequestServer& requests) {
  Join();  // else threads that are stopped, and still wait for their turn, might never get it
  for (std::jthread& thread : threads_) {
    thread = std::jthread([this, &requests](const std::stop_token& stop) { Run(stop, requests); });
  }
}

void ReceivingThread::Run(const std::stop_token& stop, RequestServer& requests) {
  const std::stop_callback wake(stop, [this] { bus_.Wake(); });
  while (!stop.stop_requested()) {
    ReceiveUntilRequest(stop, requests);
    requests.Serve();
  }
}

void ReceivingThread::ReceiveUntilRequest(const std::stop_token& stop,
                                          const RequestServer& requests) {
  MutexLock lock(turn_);
  while (!stop.stop_requested() && !requests.NeedsServer()) {
    bus_.Handle(kLongest);
    steps_.Add();
    ReportNews();
  }
}

void ReceivingThread::ReportNews() {
  const std::optional<std::string> news = bus_.DrainNews();
  if (!news) return;
  notices_.Forget("bus");
  notices_.Forget(std::string(ProblemName(Problem::kBusAway)) + " ");
  if (bus_.Problem().empty()) {
    notices_.Report({.is_problem = false, .subject = "bus", .text = *news});
  } else {
    notices_.ReportProblem(Problem::kBusAway, "", *news);
  }
}

void ReceivingThread::Stop() {
  if (!threads_[0].joinable()) return;
  for (std::jthread& thread : threads_) thread.request_stop();
  MutexLock lock(turn_);
  const auto deadline = Clock::now() + kMaxDrain;
  while (bus_.Handle(milliseconds(0)) == LcmBus::Handled::kMessage && Clock::now() < deadline) {
  }
}

void ReceivingThread::Join() {
  for (std::jthread& thread : threads_) {
    if (thread.joinable()) thread.join();
  }
}

}  // namespace splinemap
