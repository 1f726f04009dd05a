#include "lib/fleet/fleet_map.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "lib/base/mutex.h"
#include "lib/base/status.h"
#include "lib/fleet/answer_query.h"
#include "lib/fleet/layer_block.h"
#include "lib/fleet/layer_digest.h"
#include "lib/fleet/nats_fleet_store.h"
#include "lib/fleet/query_tiles.h"
#include "splinemap/local_map.h"

namespace splinemap {
namespace {

using std::chrono::milliseconds;

// A worker that was killed while it was asked does not say so.
constexpr milliseconds kLongestAnswer(2000);
constexpr milliseconds kAskAgain(100);
// Requests that are under way at once, of one query.
constexpr size_t kMaxAtOnce = 8;

// Calls job(k) for k < size, some at once. The first error; what was not begun then is left.
template <typename Job>
absl::Status ForAll(size_t size, Job job) {
  Mutex mutex;
  absl::Status first_error;
  std::atomic<size_t> next{0};
  const auto run = [&] {
    for (size_t k = next++; k < size; k = next++) {
      const absl::Status status = job(k);
      if (status.ok()) continue;
      next = size;
      MutexLock lock(mutex);
      first_error.Update(status);
    }
  };
  std::vector<std::jthread> others;
  for (size_t k = 1; k < std::min(size, kMaxAtOnce); ++k) others.emplace_back(run);
  run();
  others.clear();
  return first_error;
}

// What differs between the kinds of query.

auto& ItemsOf(PointsQuery& query) { return query.points_m; }
auto& ItemsOf(RaysQuery& query) { return query.rays; }
auto& ItemsOf(SweepsQuery& query) { return query.sweeps; }
auto& ItemsOf(RasterCells& query) { return query.rectangles; }
auto& ItemsOf(LikelihoodsQuery& query) { return query.world_T_robot; }
auto& ItemsOf(DistancesQuery& query) { return query.points_m; }
template <typename Query>
const auto& ItemsOf(const Query& query) {
  return ItemsOf(const_cast<Query&>(query));
}

PointsQuery WithoutItems(const PointsQuery& query) { return {{}, query.with_hessians}; }
RaysQuery WithoutItems(const RaysQuery& query) {
  return {{}, query.occupied_log_odds, query.unknown};
}
SweepsQuery WithoutItems(const SweepsQuery& query) {
  return {{}, query.occupied_log_odds, query.unknown};
}
RasterCells WithoutItems(const RasterCells& query) { return {query.raster, {}}; }
LikelihoodsQuery WithoutItems(const LikelihoodsQuery& query) { return {query.hits_robot_m, {}}; }
DistancesQuery WithoutItems(const DistancesQuery& query) {
  return {{}, query.max_distance_m, query.occupied_log_odds};
}

template <typename Query>
Query Take(const Query& query, absl::Span<const size_t> items) {
  Query taken = WithoutItems(query);
  ItemsOf(taken).reserve(items.size());
  for (const size_t item : items) ItemsOf(taken).push_back(ItemsOf(query)[item]);
  return taken;
}

auto& ResultsOf(PointsQuery::Answer& answer) { return answer.samples; }
auto& ResultsOf(RaysQuery::Answer& answer) { return answer.ends; }
auto& ResultsOf(SweepsQuery::Answer& answer) { return answer.results; }
auto& ResultsOf(LikelihoodsQuery::Answer& answer) { return answer.log_likelihoods; }
auto& ResultsOf(DistancesQuery::Answer& answer) { return answer.distances; }

// Room for the answer to all of a query, and the answers to some items of it into their places.
template <typename Query, typename Answer>
void MakeRoom(const Query& query, Answer& whole) {
  ResultsOf(whole).resize(SizeOf(query));
  if constexpr (std::is_same_v<Query, PointsQuery>) {
    if (query.with_hessians) whole.hessians_per_m2.resize(SizeOf(query));
  }
}
template <typename Query, typename Answer>
void Place(const Query& query, absl::Span<const size_t> items, Answer& part, Answer& whole) {
  for (size_t k = 0; k < items.size(); ++k) ResultsOf(whole)[items[k]] = ResultsOf(part)[k];
  if constexpr (std::is_same_v<Query, PointsQuery>) {
    for (size_t k = 0; query.with_hessians && k < items.size(); ++k) {
      whole.hessians_per_m2[items[k]] = part.hessians_per_m2[k];
    }
  }
}

void MakeRoom(const RasterCells& query, RasterQuery::Answer& whole) {
  whole.cells.resize(size_t{1} * query.raster.width * query.raster.height);
}
void Place(const RasterCells& query, absl::Span<const size_t> items, RasterQuery::Answer& part,
           RasterQuery::Answer& whole) {
  auto from = part.cells.begin();
  for (const size_t item : items) {
    const RasterCells::Rectangle& rectangle = query.rectangles[item];
    const int32_t width = rectangle.column1 - rectangle.column0;
    for (int32_t row = rectangle.row0; row < rectangle.row1; ++row, from += width) {
      const size_t to = size_t{1} * row * query.raster.width + rectangle.column0;
      std::copy_n(from, width, whole.cells.begin() + static_cast<ptrdiff_t>(to));
    }
  }
}

// The blocks of the tiles; nothing where they are more than `max`.
std::optional<std::set<BlockKey>> BlocksOf(const TileBoxes& boxes, size_t max) {
  std::set<BlockKey> blocks;
  for (const TileBox& box : boxes) {
    const BlockKey low = BlockKey::Of({box.tx0, box.ty0});
    const BlockKey high = BlockKey::Of({box.tx1 - 1, box.ty1 - 1});
    const double area = (double{1} * high.x - low.x + 1) * (double{1} * high.y - low.y + 1);
    if (area > static_cast<double>(max)) return std::nullopt;
    for (int32_t y = low.y; y <= high.y; ++y) {
      for (int32_t x = low.x; x <= high.x; ++x) blocks.insert({x, y});
    }
    if (blocks.size() > max) return std::nullopt;
  }
  return blocks;
}

}  // namespace

std::string AskSubject(const std::string& map, int part) {
  return fmt::format("splinemap.{}.ask.{:02}", map, part);
}

FleetMap::FleetMap(const MapOptions& options, Transport ask, milliseconds deadline)
    : options_(options), ask_(std::move(ask)), deadline_(deadline) {}

absl::StatusOr<std::unique_ptr<FleetMap>> FleetMap::Connect(const FleetAddress& address,
                                                            milliseconds deadline) {
  const Clock::time_point end = Clock::now() + deadline;
  SPLINEMAP_ASSIGN_OR_RETURN(std::shared_ptr<NatsFleetStore> store,
                             NatsFleetStore::Connect(address));
  absl::StatusOr<FleetEntry> entry = store->Get(kMapKey);
  while (absl::IsUnavailable(entry.status()) && Clock::now() + kAskAgain < end) {
    std::this_thread::sleep_for(kAskAgain);
    entry = store->Get(kMapKey);
  }
  if (absl::IsOutOfRange(entry.status())) {
    return NotFound("the map '{}' was not begun: splinemap-fleet-worker does so when it starts",
                    address.map);
  }
  SPLINEMAP_RETURN_IF_ERROR(entry.status());
  SPLINEMAP_ASSIGN_OR_RETURN(const MapOptions options, DecodeMapOptions(entry->value));
  const auto ask = [store](int part, const std::string& request, milliseconds patience) {
    return store->Request(AskSubject(store->address().map, part), request, patience);
  };
  return std::make_unique<FleetMap>(options, ask, deadline);
}

absl::StatusOr<FleetQueries::AnyAnswer> FleetMap::AskPart(int part, const FleetQueries::Any& query,
                                                          Clock::time_point end) const {
  const std::string request = EncodeRequest(query, options_.knot_interval_m);
  while (true) {
    const auto left = std::chrono::duration_cast<milliseconds>(end - Clock::now());
    const auto patience = std::clamp(left, milliseconds(1), kLongestAnswer);
    const absl::StatusOr<std::string> reply = ask_(part, request, patience);
    absl::StatusOr<FleetQueries::AnyAnswer> answer =
        reply.ok() ? DecodeReply(*reply, query) : reply.status();
    // Workers come and go, and parts with them: another one may have this part in a moment.
    const bool may_change =
        absl::IsUnavailable(answer.status()) || absl::IsDeadlineExceeded(answer.status());
    if (!may_change) return answer;
    if (Clock::now() + kAskAgain >= end) return Unavailable("{}", ErrorText(answer.status()));
    std::this_thread::sleep_for(kAskAgain);
  }
}

// What one query has come to so far.
template <typename Query>
class FleetMap::Asking {
 public:
  using Answer = typename Query::Answer;

  Asking(const FleetMap& map, const Query& query)
      : map_(map), query_(query), end_(Clock::now() + map.deadline_) {
    MakeRoom(query, answer_);
  }

  absl::StatusOr<Answer> Run() {
    SPLINEMAP_RETURN_IF_ERROR(Sort());
    SPLINEMAP_RETURN_IF_ERROR(AskWorkers());
    for (const Batch& batch : here_) SPLINEMAP_RETURN_IF_ERROR(AnswerHereOf(batch));
    if (!is_anybody_asked_) SPLINEMAP_RETURN_IF_ERROR(AskFor(0, BlocksQuery{}).status());
    return std::move(answer_);
  }

 private:
  // Items that are answered here, and the blocks that decide them.
  struct Batch {
    std::vector<size_t> items;
    std::set<BlockKey> blocks;
  };
  struct Request {
    int part;
    absl::Span<const size_t> items;
  };

  // Which items go where.
  absl::Status Sort() {
    for (size_t item = 0; item < SizeOf(query_); ++item) {
      SPLINEMAP_ASSIGN_OR_RETURN(const TileBoxes boxes,
                                 TilesOfItem(query_, item, map_.options_.knot_interval_m));
      const PartSet parts = PartsOf(boxes);
      if (parts.count() == 1) {
        of_part_[PartOf(TileKey{boxes[0].tx0, boxes[0].ty0})].push_back(item);
        continue;
      }
      std::optional<std::set<BlockKey>> blocks = BlocksOf(boxes, kMaxBlocks);
      if (!blocks) {
        return InvalidArgument(
            "item {} of the query needs more than {} tiles of the fleet's map: ask for less at "
            "once, or follow the map",
            item, kMaxBlocks * BlockKey::kSide * BlockKey::kSide);
      }
      if (here_.empty() || here_.back().blocks.size() + blocks->size() > kMaxBlocks) {
        here_.emplace_back();
      }
      here_.back().items.push_back(item);
      here_.back().blocks.merge(*blocks);
    }
    return absl::OkStatus();
  }

  absl::Status AskWorkers() {
    std::vector<Request> requests;
    for (int part = 0; part < kParts; ++part) {
      const absl::Span<const size_t> items = of_part_[part];
      if (items.empty()) continue;
      for (const Chunk& chunk : Split(Take(query_, items))) {
        requests.push_back({part, items.subspan(chunk.begin, chunk.size())});
      }
    }
    return ForAll(requests.size(), [&](size_t k) -> absl::Status {
      const auto [part, items] = requests[k];
      SPLINEMAP_ASSIGN_OR_RETURN(Answer answer, AskFor(part, Take(query_, items)));
      MutexLock lock(mutex_);
      Place(query_, items, answer, answer_);
      return absl::OkStatus();
    });
  }

  absl::Status AnswerHereOf(const Batch& batch) {
    auto view = std::make_shared<MapView>();
    view->options = map_.options_;
    SPLINEMAP_ASSIGN_OR_RETURN(view->tiles, Fetch(batch.blocks));
    const Query query = Take(query_, batch.items);
    SPLINEMAP_ASSIGN_OR_RETURN(FleetQueries::AnyAnswer answer, AnswerHere(&query, LocalMap(view)));
    Place(query_, batch.items, std::get<Answer>(answer), answer_);
    return absl::OkStatus();
  }

  absl::StatusOr<TileTree> Fetch(const std::set<BlockKey>& blocks) {
    std::array<BlocksQuery, kParts> of_part;
    for (const BlockKey& block : blocks) of_part[PartOf(block)].blocks.push_back(block);
    std::vector<std::pair<int, BlocksQuery>> requests;
    for (int part = 0; part < kParts; ++part) {
      const std::vector<BlockKey>& all = of_part[part].blocks;
      if (all.empty()) continue;
      for (const Chunk& chunk : Split(of_part[part])) {
        requests.push_back({part,
                            {{all.begin() + static_cast<ptrdiff_t>(chunk.begin),
                              all.begin() + static_cast<ptrdiff_t>(chunk.end)}}});
      }
    }
    TileTreeEditor tiles;
    SPLINEMAP_RETURN_IF_ERROR(ForAll(requests.size(), [&](size_t k) -> absl::Status {
      const auto& [part, query] = requests[k];
      SPLINEMAP_ASSIGN_OR_RETURN(const BlocksQuery::Answer answer, AskFor(part, query));
      for (size_t number = 0; number < query.blocks.size(); ++number) {
        const BlockKey key = query.blocks[number];
        SPLINEMAP_ASSIGN_OR_RETURN(
            const LayerBlock block,
            DecodeBlock(answer.blocks[number], key, nullptr, map_.options_.limits));
        MutexLock lock(mutex_);
        for (int child = 0; child < static_cast<int>(block.tiles.size()); ++child) {
          const std::shared_ptr<const StoredTile>& tile = block.tiles[child].tile;
          if (tile) tiles.Put(key.Tile(child), tile, 0);
        }
      }
      return absl::OkStatus();
    }));
    return tiles.Freeze();
  }

  template <typename Part>
  absl::StatusOr<typename Part::Answer> AskFor(int part, const Part& query) {
    SPLINEMAP_ASSIGN_OR_RETURN(FleetQueries::AnyAnswer answer, map_.AskPart(part, &query, end_));
    MutexLock lock(mutex_);
    is_anybody_asked_ = true;
    auto& found = std::get<typename Part::Answer>(answer);
    answer_.revision = std::max(answer_.revision, found.revision);
    return std::move(found);
  }

  const FleetMap& map_;
  const Query& query_;
  const Clock::time_point end_;
  std::array<std::vector<size_t>, kParts> of_part_;
  std::vector<Batch> here_;
  Mutex mutex_;
  bool is_anybody_asked_ = false;  // with answer_ while several threads ask
  Answer answer_;
};

template <typename Query>
absl::StatusOr<typename Query::Answer> FleetMap::Answer(const Query& query) const {
  return Asking<Query>(*this, query).Run();
}

absl::StatusOr<RasterQuery::Answer> FleetMap::Answer(const RasterQuery& query) const {
  SPLINEMAP_ASSIGN_OR_RETURN(const RasterCells cells,
                             RectanglesOf(query, options_.knot_interval_m));
  return Asking<RasterCells>(*this, cells).Run();
}

absl::StatusOr<AnyAnswer> FleetMap::AskAny(const AnyQuery& query) const {
  return std::visit(
      [this](const auto* q) -> absl::StatusOr<AnyAnswer> {
        SPLINEMAP_RETURN_IF_ERROR(Check(*q));
        SPLINEMAP_ASSIGN_OR_RETURN(auto answer, Answer(*q));
        return answer;
      },
      query);
}

}  // namespace splinemap
