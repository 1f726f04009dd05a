#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace splinemap {

// The newest value of a key.
struct FleetEntry {
  std::string key;
  std::string value;      // empty where the key was removed
  uint64_t hash = 0;      // of what the value says, as its writer told; 0 where it was removed
  uint64_t revision = 0;  // of the bucket; grows with everything that is written
};

// While it exists, changes are handed to the handler that it was made for.
class FleetSubscription {
 public:
  virtual ~FleetSubscription() = default;
};

// A bucket of keys and values that many processes on many machines share: the seam to the engine
// that keeps it. Keys are tokens of letters, digits, `_`, `-` and `=`, with dots between them; a
// filter has `*` for any token, and `>` for all that follow. Thread-safe.
//
// The engine may forget what it has acknowledged, and changes may get lost on their way: whoever
// keeps a copy lists what is there and compares hashes, at the beginning, and whenever
// connections() has grown. Errors of all calls: Unavailable, which says what does not work;
// PermissionDenied where the credentials do not allow it; NotFound without a bucket.
class FleetStore {
 public:
  using Handler = std::function<void(FleetEntry entry)>;

  virtual ~FleetStore() = default;

  // Writes values, and removes keys whose value is empty, in this order. OK when all have been
  // acknowledged; after an error nobody knows which were written.
  virtual absl::Status Put(absl::Span<const FleetEntry> entries) = 0;

  // Writes one, if the newest entry of the key has revision `expected`, or 0 where there is none.
  // Aborted where it has another one. Returns the new revision.
  virtual absl::StatusOr<uint64_t> PutIf(const FleetEntry& entry, uint64_t expected) = 0;

  // The entry of a key; of a filter, that of all its keys which was written last. OutOfRange where
  // none was written, or all are forgotten.
  virtual absl::StatusOr<FleetEntry> Get(const std::string& key_or_filter) = 0;

  // Visits the newest entry of every key of `filter`, removed ones too; without values unless
  // `with_values`.
  virtual absl::Status List(const std::string& filter, bool with_values,
                            absl::FunctionRef<void(FleetEntry entry)> visit) = 0;

  // Calls `handler` with what is stored from now on, in a thread of the store.
  virtual absl::StatusOr<std::unique_ptr<FleetSubscription>> Subscribe(const std::string& filter,
                                                                       Handler handler) = 0;

  // Counts on whenever changes may have been missed: with each connection that is made, and where
  // they came faster than they were handled. 0 before the first connection.
  virtual uint64_t connections() const = 0;
};

}  // namespace splinemap
