#include "tests/fault/map_history.h"

#include <algorithm>
#include <functional>
#include <string_view>

#include "tests/support/random_map.h"

namespace splinemap {
namespace {

constexpr MapOptions kOptions{0.1, {-2560, 5120}};

class Bytes {
 public:
  template <typename T>
  void Add(const T& value) {
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void Add(const FixedPose2& pose) {
    Add(pose.x);
    Add(pose.y);
    Add(pose.yaw);
  }
  void Add(const LayerId& id) {
    bytes_ += id.name;
    Add(id.origin);
  }
  // Tiles of a base are of no revision.
  void Add(const TileTree& tiles, bool with_revisions) {
    Add(tiles.size());
    tiles.ForEach([&](TileKey key, const TileTree::Entry& entry) {
      Add(key.tx);
      Add(key.ty);
      if (with_revisions) Add(entry.revision);
      Add(entry.tile->Get()->control_points);
    });
  }
  uint64_t Hash() const { return std::hash<std::string_view>()(bytes_); }

 private:
  std::string bytes_;
};

void AddArchive(const ScanArchive& archive, Bytes& bytes) {
  bytes.Add(archive.map_T_world);
  bytes.Add(archive.base.map_T_world);
  bytes.Add(archive.base.scans);
  bytes.Add(archive.base.newest);
  bytes.Add(archive.base.tiles, false);
  bytes.Add(archive.num_scans());
  archive.ForEach([&](const PosedScan& scan, const BeamModelOptions&) {
    bytes.Add(scan.utime);
    bytes.Add(scan.world_T_robot);
    for (const auto& beam : scan.beams) bytes.Add(beam.range_m);
  });
}

}  // namespace

uint64_t FingerprintOf(const LayerSet& set) {
  Bytes bytes;
  bytes.Add(set.options.knot_interval_m);
  bytes.Add(set.options.limits.min);
  bytes.Add(set.options.limits.max);
  if (set.own_layer) bytes.Add(*set.own_layer);
  for (const auto& [id, setting] : set.settings.records()) {
    bytes.Add(id);
    bytes.Add(setting.muted);
    bytes.Add(setting.low_weight);
    bytes.Add(setting.placement);
    bytes.Add(setting.counter);
    bytes.Add(setting.writer);
    bytes.Add(setting.removed_up_to);
  }
  std::vector<const LayerSnapshot*> layers;
  for (const LayerSnapshot& layer : set.layers) layers.push_back(&layer);
  std::sort(layers.begin(), layers.end(),
            [](const auto* a, const auto* b) { return a->id < b->id; });
  for (const LayerSnapshot* layer : layers) {
    bytes.Add(layer->id);
    bytes.Add(layer->session.number);
    bytes.Add(layer->session.nonce);
    bytes.Add(layer->revision);
    bytes.Add(layer->tiles, true);
    ScanArchive all_base;  // what a file says of a layer whose scans nobody keeps
    all_base.base.tiles = layer->tiles;
    AddArchive(layer->archive == nullptr ? all_base : *layer->archive, bytes);
  }
  return bytes.Hash();
}

LayerSet OneMoreCommit(LayerSet set, int n) {
  LayerSnapshot& last = set.layers.front();
  Layer layer(last, {last.session.number + 1, static_cast<uint64_t>(n)});
  layer.BeginCommit();
  layer.EditTile({n % 7, n % 5}).control_points.fill(static_cast<ControlPoint>(1 + n % 1000));
  LayerSnapshot next = layer.Snapshot();
  next.archive = last.archive;
  last = std::move(next);
  return set;
}

MapHistory::MapHistory(uint64_t seed) : random_(seed), map_(kOptions) {
  map_.AddLayer({"robot", 1}, {1, 7});
  map_.AddLayer({"other", 2}, {1, 8});
}

void MapHistory::Commit(Layer& layer, int tiles) {
  layer.BeginCommit();
  for (int k = 0; k < tiles; ++k) {
    layer.EditTile(RandomKey(random_, 5)) = RandomTile(random_, map_.options().limits);
  }
}

LayerSet MapHistory::Set() {
  map_.SetSettings(settings_);
  map_.SetOwnLayer({"robot", 1});
  LayerSet set = map_.Layers();
  if (!has_other_) set.layers.pop_back();
  set.layers.front().archive = std::make_shared<ScanArchive>(archive_);
  return set;
}

LayerSet MapHistory::Next() {
  const LayerId other{"other", 2};
  switch (random_() % 8) {
    case 0:
      return NextCorrected();
    case 1:
      has_other_ = !has_other_;
      break;
    case 2: {
      LayerSettings setting = settings_.Next(other, 5);
      setting.muted = !setting.muted;
      settings_.Merge(other, setting);
      break;
    }
    case 3:
      if (archive_.TakeOldest() != nullptr) {
        TileTreeEditor base(archive_.base.tiles);
        base.Edit(RandomKey(random_, 5), 0).Edit() = RandomTile(random_, map_.options().limits);
        archive_.base = {base.Freeze(), archive_.map_T_world, archive_.base.scans + 1,
                         Utime(scans_)};
      }
      break;
    default:
      break;
  }
  if (has_other_) Commit(map_.layer(1), 3);
  Commit(map_.layer(0), 1 + static_cast<int>(random_() % 8));
  for (uint64_t k = random_() % 12; k > 0; --k) {
    auto scan = std::make_shared<PosedScan>(RandomScan(random_, 5));
    scan->utime = Utime(++scans_);
    archive_.Add(scan, {});
  }
  return Set();
}

LayerSet MapHistory::NextCorrected() {
  const auto shift = static_cast<int>(random_() % 100);
  archive_ = archive_.Moved([&](const ScanPose& pose) {
    FixedPose2 moved = pose.world_T_robot;
    moved.x += shift;
    return moved;
  });
  TileTreeEditor tiles;
  for (int k = 0; k < 20; ++k) {
    tiles.Edit(RandomKey(random_, 5), map_.layer(0).revision() + 1).Edit() =
        RandomTile(random_, map_.options().limits);
  }
  const SessionId session = map_.layer(0).session();
  map_.layer(0).ReplaceTiles({session.number + 1, random_()}, tiles.Freeze());
  return Set();
}

}  // namespace splinemap
