#pragma once

#include <nats/nats.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "lib/base/clock.h"
#include "lib/base/mutex.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/nats_acknowledgements.h"
#include "lib/fleet/nats_handle.h"

namespace splinemap {

// A connection to NATS servers, which is made again until it is closed, and its errors in words.
// Thread-safe.
class NatsConnection {
 public:
  // How long answers are awaited.
  static constexpr std::chrono::milliseconds kTimeout{5000};

  // Unavailable, at once, where no server answers; PermissionDenied where they do not take the
  // credentials; errors of CheckFleetAddress(). It exists to the end of the program, since threads
  // of the library may call a last time after all was closed.
  static absl::StatusOr<NatsConnection*> Connect(const FleetAddress& address);
  // Nothing may be asked of it afterwards.
  void Close();

  const FleetAddress& address() const { return address_; }
  natsConnection* get() const { return connection_.get(); }
  jsCtx* context() const { return context_.get(); }

  // Writes messages, one batch after the other, and waits for what becomes of them.
  NatsAcknowledgements::Outcome Write(std::vector<NatsHandle<natsMsg>> messages,
                                      jsPubOptions options);

  // Of FleetStore.
  uint64_t connections() const { return connections_; }
  // Of NatsFleetStore.
  bool IsClosed() const;
  std::string Problem() const;

  // What became of `what`, which began at `begin`: `status`, and what servers said meanwhile.
  absl::Status StatusOf(natsStatus status, const std::string& what, Clock::time_point begin) const;
  absl::Status StatusOf(const NatsAcknowledgements::Outcome& outcome, const std::string& what,
                        Clock::time_point begin) const;

 private:
  explicit NatsConnection(FleetAddress address) : address_(std::move(address)) {}

  absl::Status Open();
  absl::Status UseCredentials(natsOptions* options) const;
  void HandleError(natsStatus error, const char* text);
  std::string LastErrorSince(Clock::time_point begin) const;
  std::string Refused() const;

  const FleetAddress address_;
  std::atomic<uint64_t> connections_{0};
  Mutex write_mutex_;
  NatsAcknowledgements acknowledgements_;
  mutable Mutex mutex_;
  std::string last_error_ ABSL_GUARDED_BY(mutex_);
  Clock::time_point last_error_time_ ABSL_GUARDED_BY(mutex_);
  NatsHandle<natsConnection> connection_;
  NatsHandle<jsCtx> context_;
};

}  // namespace splinemap
