#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "lcmtypes/splinemap/layers_t.hpp"
#include "lcmtypes/splinemap/reply_t.hpp"
#include "lib/base/mutex.h"
#include "lib/wire/encode.h"
#include "services/splinemapd/daemon.h"

namespace splinemap {

// A daemon on a bus inside this process, and a client of it. Of one thread.
class MemoryDaemon {
 public:
  using Handler = std::function<void(absl::Span<const uint8_t> message)>;

  // What the daemon says on these channels, after the prefix, goes to `hear`, in another thread.
  static absl::StatusOr<std::unique_ptr<MemoryDaemon>> Start(
      const config::Config& config, const std::vector<std::string>& channels = {},
      Handler hear = {});

  void Publish(const std::string& channel, absl::Span<const uint8_t> message) {
    bus_->PublishBytes(channel, message);
  }

  // Of this moment; nothing after ten seconds.
  std::optional<layers_t> Layers();

  // DeadlineExceeded after ten seconds.
  absl::Status Save();
  // About a layer: "mute", "unmute".
  absl::Status Set(const std::string& command, const LayerId& id);

  absl::Status Stop() { return daemon_->Stop(); }
  int64_t nonce() const { return nonce_; }

 private:
  MemoryDaemon() = default;
  template <typename Request>
  absl::StatusOr<reply_t> Ask(const std::string& channel, Request request);
  template <typename Request>
  absl::Status Command(Request request);
  LcmBus* bus_ = nullptr;
  Mutex mutex_;
  ConditionVariable heard_;
  std::optional<reply_t> reply_ ABSL_GUARDED_BY(mutex_);
  std::optional<layers_t> layers_ ABSL_GUARDED_BY(mutex_);
  int64_t last_id_ = 0;
  int64_t nonce_ = 0;
  int64_t session_number_ = 0;
  std::unique_ptr<Daemon> daemon_;
};

}  // namespace splinemap
