#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "lib/fleet/fleet_address.h"
#include "lib/fleet/fleet_store.h"

namespace splinemap {

class NatsConnection;

// A bucket of NATS JetStream. What is written is stored on all servers of the bucket's group, or on
// most of them, before it is acknowledged; changes come as messages that the engine publishes after
// it has stored them, so that watching costs it no consumer. Connects again for as long as it
// exists. Thread-safe.
class NatsFleetStore : public FleetStore {
 public:
  // Unavailable, at once, where no server answers; PermissionDenied where they do not take the
  // credentials; errors of CheckFleetAddress().
  static absl::StatusOr<std::unique_ptr<NatsFleetStore>> Connect(const FleetAddress& address);
  ~NatsFleetStore() override;

  // Makes the bucket, with so many replicas, where it is not there.
  absl::Status MakeBucket(int replicas);

  absl::Status Put(absl::Span<const FleetEntry> entries) override;
  absl::StatusOr<uint64_t> PutIf(const FleetEntry& entry, uint64_t expected) override;
  absl::StatusOr<FleetEntry> Get(const std::string& key_or_filter) override;
  absl::Status List(const std::string& filter, bool with_values,
                    absl::FunctionRef<void(FleetEntry entry)> visit) override;
  absl::StatusOr<std::unique_ptr<FleetSubscription>> Subscribe(const std::string& filter,
                                                               Handler handler) override;
  uint64_t connections() const override;

  // Asks those who answer `subject`, one of each queue group. Unavailable where nobody is there,
  // DeadlineExceeded.
  absl::StatusOr<std::string> Request(const std::string& subject, const std::string& request,
                                      std::chrono::milliseconds deadline);
  // Hands over requests, each to one of all members of `queue`, in a thread of the store that other
  // subscriptions wait for; the answer is told to the subject `reply_to`.
  using Question = std::function<void(std::string request, std::string reply_to)>;
  absl::StatusOr<std::unique_ptr<FleetSubscription>> Serve(const std::string& subject,
                                                           const std::string& queue,
                                                           Question question);
  // A message to all who listen now; no more than that.
  absl::Status Tell(const std::string& subject, const std::string& message);
  absl::StatusOr<std::unique_ptr<FleetSubscription>> Listen(
      const std::string& subject, std::function<void(const std::string& message)> handler);

  // Whether servers have refused it twice, for instance since its credentials were removed: then
  // the library does not connect again.
  bool IsClosed() const;
  // Why it does not work at the moment; empty while it does.
  std::string Problem() const;
  const FleetAddress& address() const;

 private:
  explicit NatsFleetStore(NatsConnection& connection) : connection_(connection) {}

  std::string SubjectOf(const std::string& key) const;

  NatsConnection& connection_;
};

}  // namespace splinemap
