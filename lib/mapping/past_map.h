#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "lib/mapping/fold.h"
#include "splinemap/layer_set.h"
#include "splinemap/utime.h"

namespace splinemap {

// First and last scan that the layers keep. NotFound where they keep none.
struct ArchiveTimes {
  Utime first{0};
  Utime last{0};
};
absl::StatusOr<ArchiveTimes> TimesOf(const LayerSet& set);

// Is told before each scan how many of how many were folded; true ends it.
using PastMapProgress = std::function<bool(int64_t folded, int64_t scans)>;

// A map as it was at other times, made of the scans that its layers keep. Thread-compatible.
class PastMap {
 public:
  explicit PastMap(LayerSet now);

  // Goes on with what was folded for the time before, also where that was cancelled, if all of it
  // is a part of this.
  // Errors name the layer: FailedPrecondition where its scans of then are not kept, InvalidArgument
  // for a scan that cannot be folded. Cancelled.
  absl::StatusOr<LayerSet> At(
      Utime utime, const PastMapProgress& is_cancelled = [](int64_t, int64_t) { return false; });

 private:
  struct LayerFold {
    std::vector<Utime> utimes;  // of its scans, in the order of mapping
    std::optional<Fold> fold;   // of the first of those that were made by `until`
    Utime until{0};

    int64_t ScansUntil(Utime utime) const;
    bool IsPartOf(Utime utime) const;
  };

  absl::Status FoldLayer(LayerSnapshot& layer, LayerFold& made, Utime utime,
                         const FoldProgress& is_cancelled) const;

  const LayerSet now_;
  std::vector<LayerFold> folds_;  // as the layers of now_
};

}  // namespace splinemap
