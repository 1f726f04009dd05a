#pragma once

#include <cstdint>
#include <memory>
#include <random>
#include <string>

#include "splinemap/layer_set.h"
#include "splinemap/scan_archive.h"
#include "tests/support/map_writer.h"

namespace splinemap {

// A number of all that a map file has to keep, equal for equal maps.
uint64_t FingerprintOf(const LayerSet& set);

// The map after one more commit to its first layer, another for each `n`.
LayerSet OneMoreCommit(LayerSet set, int n);

// What a daemon saves in its life: commits and scans, corrections, scans that are not kept any
// more, another robot's layer that comes, changes and is gone, settings. The same for the same
// seed. Thread-compatible.
class MapHistory {
 public:
  explicit MapHistory(uint64_t seed);

  // The next state.
  LayerSet Next();
  // The next state is a fold of all scans with other poses.
  LayerSet NextCorrected();

 private:
  LayerSet Set();
  void Commit(Layer& layer, int tiles);

  std::mt19937_64 random_;
  MapWriter map_;
  ScanArchive archive_;
  SettingsTable settings_;
  bool has_other_ = false;
  int64_t scans_ = 0;
};

}  // namespace splinemap
