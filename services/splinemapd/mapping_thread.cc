#include "services/splinemapd/mapping_thread.h"

#include <algorithm>
#include <future>
#include <utility>

namespace splinemap {
namespace {

// How old at most what others see of the map is, while messages pour in.
constexpr std::chrono::milliseconds kPublishInterval(20);
constexpr std::chrono::hours kForever(24);

}  // namespace

MappingThread::MappingThread(const config::Config& config, const MapOptions& map_options,
                             Layer layer, ScanArchive archive, NewestMap& newest, MapSaver& saver,
                             NoticeLog& notices)
    : newest_(newest),
      saver_(saver),
      notices_(notices),
      mailbox_(size_t{config.service().max_queued_mb()} << 20),
      layer_(std::move(layer)),
      mapper_(config, map_options, layer_, std::move(archive)) {
  PublishState();
}

void MappingThread::Start(std::function<void()> on_change, OnScan on_scan) {
  on_change_ = std::move(on_change);
  mapper_.SetOnScan(
      [this, on_scan = std::move(on_scan)](uint64_t revision, const PackedScan& scan) {
        on_scan(layer_.session(), revision,
                Placed(mapper_.archive().map_T_world, scan.pose.world_T_robot), scan);
      });
  mapping_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

void MappingThread::Run(const std::stop_token& stop) {
  Clock::time_point last_published;
  bool is_published = true;
  while (true) {
    const auto item =
        is_published ? mailbox_.Pop(stop, Clock::now() + kForever) : mailbox_.TryPop();
    if (!item && is_published && stop.stop_requested()) break;
    if (item) {
      if (const auto* task = std::get_if<Task>(&*item)) (*task)();
      if (const auto* message = std::get_if<MailboxMessage>(&*item)) MapMessage(*message);
      is_published = false;
    }
    // At once when nothing waits, else several commits together.
    if (!is_published && (!item || Clock::now() - last_published > kPublishInterval)) {
      PublishState();
      last_published = Clock::now();
      is_published = true;
    }
  }
  mapper_.Flush();
  PublishState();
}

void MappingThread::MapMessage(const MailboxMessage& message) {
  const uint64_t revision_before = layer_.revision();
  const auto begin = Clock::now();
  mapper_.HandleMessage(message.channel, message.bytes, message.received);
  const auto end = Clock::now();
  const auto scans = static_cast<int64_t>(layer_.revision() - revision_before);
  if (scans <= 0) return;
  unpublished_.scans += scans;
  unpublished_.scan_time += end - begin;
  unpublished_.longest_scan_time =
      std::max<std::chrono::nanoseconds>(unpublished_.longest_scan_time, (end - begin) / scans);
  unpublished_.last_mapped = end;
}

void MappingThread::PublishState() {
  for (const Notice& notice : mapper_.DrainNotices()) notices_.Report(notice);
  newest_.SetOwn(mapper_.Snapshot());
  {
    MutexLock lock(mutex_);
    state_.counts = mapper_.counts();
    state_.scans_queued = mapper_.scans_queued();
    state_.newest_scan_utime = mapper_.newest_scan_utime();
    if (unpublished_.last_mapped) state_.last_mapped = unpublished_.last_mapped;
    state_.scans += unpublished_.scans;
    state_.scan_time += unpublished_.scan_time;
    state_.longest_scan_time = std::max(state_.longest_scan_time, unpublished_.longest_scan_time);
  }
  unpublished_ = {};
  if (on_change_) on_change_();
}

void MappingThread::StartSession(LayerId id, SessionId session, bool is_empty, Done done) {
  mailbox_.Post([=, this, id = std::move(id), done = std::move(done)] {
    LayerSnapshot own = mapper_.Snapshot();
    own.id = id;
    own.session = session;
    if (is_empty) {
      auto archive = std::make_shared<ScanArchive>();
      archive->map_T_world = own.archive->map_T_world;
      own.archive = std::move(archive);
      own.tiles = {};
      ++own.revision;
    }
    const absl::Status saved = SaveSession(own);
    if (saved.ok() && is_empty) {
      layer_.StartEmptySession(session);
      mapper_.ReplaceArchive(*own.archive);
    } else if (saved.ok()) {
      layer_.StartSession(id, session);
    }
    PublishState();
    done(saved);
  });
}

absl::Status MappingThread::SaveSession(const LayerSnapshot& own) {
  std::promise<absl::Status> promise;
  saver_.SaveSession(own, [&promise](const absl::Status& status) { promise.set_value(status); });
  return promise.get_future().get();
}

void MappingThread::TakeOver(std::unique_ptr<FoldedLayer> layer, TookOver done) {
  mailbox_.Post(
      [this, layer = std::shared_ptr<FoldedLayer>(std::move(layer)), done = std::move(done)] {
        absl::StatusOr<std::string> result = TakeOverNow(*layer);
        PublishState();
        done(std::move(result));
      });
}

absl::StatusOr<std::string> MappingThread::TakeOverNow(FoldedLayer& layer) {
  LayerSnapshot own = mapper_.Snapshot();
  if (layer.session() != own.session) return absl::AbortedError("another session began");
  if (!layer.CanAppend(*own.archive)) return absl::AbortedError("scans went to the base");
  layer.Append(*own.archive);
  SPLINEMAP_RETURN_IF_ERROR(layer.Fold());
  const TileTree tiles = layer.Tiles();
  const size_t changed = DifferentTiles(own.tiles, tiles).size();
  std::string text = fmt::format("{} tiles changed; it has {} tiles of {} scans", changed,
                                 tiles.size(), layer.archive().num_scans());
  if (changed > 0) {
    own.session.number += 1;
    own.revision += 1;
    own.tiles = WithRevisionsOf(own.tiles, tiles, own.revision);
    own.archive = std::make_shared<ScanArchive>(layer.archive());
    SPLINEMAP_RETURN_IF_ERROR(SaveSession(own));
    layer_.ReplaceTiles(own.session, own.tiles);
  }
  mapper_.ReplaceArchive(layer.archive());
  return text;
}

void MappingThread::LimitArchive(size_t max_bytes) {
  mailbox_.Post([this, max_bytes] {
    mapper_.LimitArchive(max_bytes);
    PublishState();
  });
}

void MappingThread::Refuse(std::string why) {
  mailbox_.Post([this, why = std::move(why)] { mapper_.Refuse(why); });
}

MappingThread::State MappingThread::DrainState() {
  MutexLock lock(mutex_);
  State state = state_;
  state.messages_queued = mailbox_.num_messages();
  state_.scans = 0;
  state_.scan_time = {};
  state_.longest_scan_time = {};
  return state;
}

void MappingThread::Stop() {
  mapping_.request_stop();
  if (mapping_.joinable()) mapping_.join();
}

}  // namespace splinemap
