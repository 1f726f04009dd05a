#include "services/splinemapd/map_saver.h"

#include <filesystem>
#include <utility>
#include <vector>

#include "lib/base/random.h"
#include "lib/base/status.h"

namespace splinemap {

MapSaver::MapSaver(MapFile file, NewestMap& newest, NoticeLog& notices)
    : path_(file.path()), newest_(newest), notices_(notices), tasks_(0), file_(std::move(file)) {}

void MapSaver::Start(std::chrono::duration<double> interval) {
  saving_ = std::jthread([this, interval](const std::stop_token& stop) { Run(stop, interval); });
}

void MapSaver::Run(const std::stop_token& stop, std::chrono::duration<double> interval) {
  const auto step = std::chrono::duration_cast<Clock::duration>(interval);
  Clock::time_point next_save = Clock::now() + step;
  while (true) {
    if (const auto item = tasks_.Pop(stop, next_save)) {
      std::get<Task> (*item)();
      continue;
    }
    if (stop.stop_requested()) return;
    Report(SaveNewest());
    next_save = Clock::now() + step;
  }
}

void MapSaver::Report(const absl::Status& saved) {
  if (!saved.ok()) {
    notices_.ReportProblem(Problem::kNotSaved, "save", "the map is not saved: " + ErrorText(saved));
  } else if (is_failing_) {
    notices_.Report(
        {.is_problem = false, .subject = "saved again", .text = "the map is saved again"});
  }
  is_failing_ = !saved.ok();
}

void MapSaver::Save(Done done) {
  tasks_.Post([this, done = std::move(done)] { done(SaveNewest()); });
}

void MapSaver::SaveSession(LayerSnapshot own, Done done) {
  tasks_.Post([this, own = std::move(own), done = std::move(done)] {
    LayerSet set = *newest_.Layers();
    set.layers.front() = own;
    set.own_layer = own.id;
    const absl::Status saved = SaveSet(set);
    if (saved.ok()) newest_.SetOwn(own);
    done(saved);
  });
}

std::optional<uint64_t> MapSaver::saved_revision() const {
  MutexLock lock(mutex_);
  return saved_revision_;
}

absl::Status MapSaver::SaveNewest() {
  const std::shared_ptr<const LayerSet> set = newest_.Layers();
  if (saved_.lock() == set && file_.IsThere()) return absl::OkStatus();
  const absl::Status saved = SaveSet(*set);
  MutexLock lock(mutex_);
  if (saved.ok()) {
    saved_ = set;
    saved_revision_ = set->layers.front().revision;
  } else if (!file_.IsThere()) {
    saved_revision_.reset();
  }
  return saved;
}

absl::Status MapSaver::SaveSet(const LayerSet& set) {
  absl::Status saved = SaveHereOrElsewhere(set);
  size_t unsaved = 0;
  if (saved.ok()) {
    used_bytes_ = file_.used_bytes();
    on_disk_ = set;
  } else {
    for (const LayerSnapshot& layer : set.layers) {
      const LayerSnapshot* before = on_disk_.Find(layer.id);
      TileTree::ForEachDifference(
          before == nullptr ? TileTree() : before->tiles, layer.tiles,
          [&](TileKey, const TileTree::Entry*, const TileTree::Entry*) { ++unsaved; });
    }
  }
  unsaved_tiles_ = unsaved;
  return saved;
}

absl::Status MapSaver::SaveHereOrElsewhere(const LayerSet& set) {
  const absl::StatusOr<std::vector<std::string>> problems = file_.Save(set);
  if (!problems.ok() && !file_.IsThere()) return SaveElsewhere(set, problems.status());
  SPLINEMAP_RETURN_IF_ERROR(problems.status());
  if (problems->empty()) return absl::OkStatus();
  notices_.Report(
      {.subject = "left out",
       .text = fmt::format(
           "saved to {}, but: {}{}", path_, problems->front(),
           problems->size() == 1 ? "" : fmt::format("; and {} more", problems->size() - 1))});
  return absl::OkStatus();
}

// Where it was, where nothing stands there now; else beside it; else in the temporary folder.
absl::Status MapSaver::SaveElsewhere(const LayerSet& set, const absl::Status& why) {
  const std::filesystem::path path = path_;
  const std::string rescue =
      fmt::format("{}.rescue-{:08x}.splinemap", path.stem().string(), RandomId() & 0xffffffff);
  std::vector<std::filesystem::path> places{path, path.parent_path() / rescue};
  std::error_code error;
  const std::filesystem::path temporary = std::filesystem::temp_directory_path(error);
  if (!error) places.push_back(temporary / rescue);
  for (const std::filesystem::path& place : places) {
    if (!file_.SaveElsewhere(place.string(), set).ok()) continue;
    notices_.Report(
        {.subject = "rescue",
         .text = fmt::format("{}; the map is in {} from now on", ErrorText(why), place.string())});
    return absl::OkStatus();
  }
  return why;
}

absl::Status MapSaver::Stop() {
  saving_.request_stop();
  if (saving_.joinable()) saving_.join();
  absl::Status saved = SaveNewest();
  const std::shared_ptr<const LayerSet> set = newest_.Layers();
  if (!saved.ok()) saved = SaveElsewhere(*set, saved);
  if (!saved.ok()) {
    const uint64_t revision = set->layers.front().revision;
    return Unavailable("{}; the last {} of {} commits to the map are lost", ErrorText(saved),
                       revision - saved_revision().value_or(0), revision);
  }
  {
    MutexLock lock(mutex_);
    saved_revision_ = set->layers.front().revision;
  }
  SPLINEMAP_RETURN_IF_ERROR(file_.Close());
  if (file_.path() == path_) return absl::OkStatus();
  return Unavailable("{} could not be written; the map is in {}, with all commits", path_,
                     file_.path());
}

}  // namespace splinemap
