#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "splinemap/daemon_identity.h"
#include "splinemap/layer_command.h"
#include "splinemap/layer_settings.h"
#include "splinemap/pose2.h"
#include "splinemap/queryable_map.h"

namespace splinemap {

class KeyRing;  // splinemap/key_ring.h

struct ClientOptions {
  std::string channel_prefix = "SPLINEMAP";
  std::string robot;  // empty: the first that answers
  // Signs commands, and no other replies are believed than those of daemons whose keys are trusted.
  // Null: nothing is signed, and all are.
  std::shared_ptr<const KeyRing> keys;
  // Of Connect() and Ask().
  std::chrono::milliseconds deadline{2000};
};

// A change of the settings of a layer, for all daemons and clients.
struct LayerChange {
  LayerCommand command = LayerCommand::kMute;
  LayerId layer;
  uint64_t session_number = 0;  // of kRemove: which is to be removed
  Pose2 placement = {};         // of kPlace: map_T_layer, which is to be from now on
};

// The map of a daemon, asked over LCM. What gets lost is asked again until the deadline, and where
// the daemon is started again, that of the same robot is looked for. Each answer is of one
// revision. Thread-safe; may not be destroyed while a call is under way, nor in a callback.
//
// Errors beside those of every map: InvalidArgument for more than kMaxItems items;
// DeadlineExceeded, which says what is missing; Unavailable where that is the bus;
// ResourceExhausted with 10,000 under way.
class MapClient : public QueryableMap {
 public:
  static constexpr size_t kMaxItems = 1'000'000;  // points, rays, .. of a query; rasters: kMaxCells

  // Finds the daemon. `url` as LCM takes it, empty for LCM's default.
  static absl::StatusOr<std::unique_ptr<MapClient>> Connect(const std::string& url,
                                                            ClientOptions options);
  // What is under way is cancelled.
  ~MapClient() override;

  // Waits, and so must not be called in a callback.
  absl::StatusOr<AnyAnswer> AskAny(const AnyQuery& query) const override;

  using RequestId = int64_t;
  // Asks without waiting, for a year at most. `done` is called once: by the client's thread, which
  // it keeps from all other answers, or in Cancel(), in the destructor and, where the query is
  // refused, in here.
  template <typename Query>
  RequestId Start(Query query, std::chrono::milliseconds deadline,
                  std::function<void(absl::StatusOr<typename Query::Answer>)> done) const;
  // Where it is still under way, its `done` gets Cancelled.
  void Cancel(RequestId id) const;

  // Make the daemon save its map now, or start an empty session of its layer. Executed at most
  // once, and only while the layer is in the session that daemon() says, else FailedPrecondition;
  // PermissionDenied where the daemon takes no commands; after DeadlineExceeded and Unavailable it
  // may have been executed or not.
  absl::Status Save(std::chrono::milliseconds deadline = std::chrono::seconds(30));
  absl::Status Clear(std::chrono::milliseconds deadline = std::chrono::seconds(30));

  // Changes the settings of a layer that the daemon has, for all daemons and clients. Executed at
  // most once; NotFound for a layer that it does not have, FailedPrecondition for the removal of
  // one that is in another session; else as above.
  absl::Status Set(const LayerChange& change,
                   std::chrono::milliseconds deadline = std::chrono::seconds(30));

  // As of its last reply.
  DaemonIdentity daemon() const;

  // Of several daemons that answered Connect() without a robot: those whose maps were in another
  // revision. They come some ms after the first.
  std::vector<std::string> RobotsOfOtherMaps() const;

 private:
  class Impl;
  explicit MapClient(std::unique_ptr<Impl> impl);

  const std::unique_ptr<Impl> impl_;
};

}  // namespace splinemap
