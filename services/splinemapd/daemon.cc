#include "services/splinemapd/daemon.h"

#include <spdlog/spdlog.h>

#include <future>
#include <utility>

#include "lcmtypes/splinemap/status_t.hpp"
#include "lib/base/status.h"
#include "lib/signing/key_files.h"
#include "lib/wire/encode.h"
#include "services/splinemapd/command_handlers.h"
#include "services/splinemapd/folding_thread.h"
#include "services/splinemapd/map_saver.h"
#include "services/splinemapd/mapping_thread.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/receiving_thread.h"
#include "services/splinemapd/replication_thread.h"
#include "services/splinemapd/request_server.h"
#include "services/splinemapd/status_reporter.h"
#include "services/splinemapd/stored_map.h"
#include "services/splinemapd/thread_watch.h"
#include "services/splinemapd/tile_budget.h"

namespace splinemap {
namespace {

using Keys = std::shared_ptr<const KeyRing>;

// Null where there are none.
absl::StatusOr<Keys> KeysOf(const config::Config& config) {
  if (config.keys().empty()) return nullptr;
  SPLINEMAP_ASSIGN_OR_RETURN(Keys keys, KeyRing::Read(config.keys()));
  const std::string name = RobotName(config);
  if (keys->own().Maps(name)) return keys;
  return FailedPrecondition(
      "the key of this computer is not trusted to map {0}, so that nobody would believe it; on all "
      "computers: splinemap keys trust {1} {0} {2} --maps {0}",
      name, config.keys(), KeyText(keys->own().key));
}

FollowOptions FollowOptionsOf(const config::Config& config, Keys keys) {
  const config::Service& service = config.service();
  FollowOptions follow;
  follow.keys = std::move(keys);
  follow.channel_prefix = config.channel_prefix();
  follow.names = {service.follow().begin(), service.follow().end()};
  // A log of everything, replayed to a robot's daemon, must not count twice.
  if (follow.names.empty() && service.sensors()) follow.names = {""};
  follow.max_tiles = (size_t{service.max_followed_mb()} << 20) / sizeof(Tile);
  follow.takes_settings = service.remote_commands();
  return follow;
}

PublisherOptions PublisherOptionsOf(const config::Service& service) {
  using Duration = std::chrono::duration<double, std::milli>;
  PublisherOptions publisher;
  publisher.bytes_per_s = service.max_publish_kb_per_s() * 1000;
  publisher.sends_scans = service.max_archive_mb() > 0;
  publisher.push_interval =
      std::chrono::duration_cast<std::chrono::milliseconds>(Duration(service.push_interval_ms()));
  return publisher;
}

LayerSnapshot OwnOf(StoredMap& stored) {
  LayerSnapshot own = stored.own.Snapshot();
  own.archive = std::make_shared<ScanArchive>(stored.archive);
  return own;
}

void Log(bool is_problem, const std::string& text) {
  spdlog::log(is_problem ? spdlog::level::warn : spdlog::level::info, "{}", text);
}

}  // namespace

// In the order in which they are made; each uses those above it.
struct Daemon::Parts {
  Parts(const config::Config& config, const Keys& keys, LcmBus& bus, NoticeLog& notices,
        MapFile file, StoredMap stored, TileBudget budget)
      : newest(stored.options, OwnOf(stored), budget.memory()),
        saver(std::move(file), newest, notices),
        receiving(bus, notices),
        mapping(config, stored.options, std::move(stored.own), std::move(stored.archive), newest,
                saver, notices),
        folding(config, keys, stored.options, budget.memory(), newest, mapping, notices),
        replication(bus, FollowOptionsOf(config, keys), PublisherOptionsOf(config.service()),
                    stored.others, newest, notices),
        handlers(config.service().remote_commands(), newest, mapping, folding, replication, saver,
                 notices),
        requests(
            config.channel_prefix(), newest,
            [&bus](const std::string& channel, absl::Span<const uint8_t> reply) {
              bus.PublishBytes(channel, reply);
            },
            [this](const std::vector<uint8_t>& command, RequestServer::Done done) {
              handlers.Execute(command, std::move(done));
            },
            keys),
        reporter(config, {newest, notices, receiving, mapping, replication, requests, saver},
                 std::move(budget)) {
    threads.Add("receives", receiving.steps());
    threads.Add("maps", mapping.steps());
    threads.Add("folds", folding.steps());
    threads.Add("replicates", replication.steps());
    threads.Add("serves", requests.steps());
    threads.Add("saves", saver.steps());
  }

  NewestMap newest;
  MapSaver saver;
  ReceivingThread receiving;
  MappingThread mapping;
  FoldingThread folding;
  ReplicationThread replication;
  CommandHandlers handlers;
  RequestServer requests;
  StatusReporter reporter;
  ThreadWatch threads;
};

absl::StatusOr<std::unique_ptr<Daemon>> Daemon::Start(const config::Config& asked,
                                                      std::unique_ptr<LcmBus> bus) {
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(asked));
  SPLINEMAP_ASSIGN_OR_RETURN(Keys keys, KeysOf(asked));
  TileBudget budget(size_t{asked.service().max_memory_mb()} << 20);
  SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(MapPath(asked), budget.memory()));
  auto notices = std::make_unique<NoticeLog>(&Log);
  SPLINEMAP_ASSIGN_OR_RETURN(StoredMap stored, LoadStoredMap(asked, file, *notices));
  config::Config config = asked;
  config.mutable_method()->set_knot_interval_m(stored.options.knot_interval_m);
  SPLINEMAP_RETURN_IF_ERROR(CheckConfig(config));
  const size_t tiles = stored.own.tiles().size();
  spdlog::info("map {}: layer {}, session {}, {}", MapPath(config), stored.own.id().name,
               stored.own.session().number,
               tiles == 0 ? "empty"
                          : fmt::format("goes on with {} tiles; poses have to be in the frame in "
                                        "which they were mapped",
                                        tiles));
  if (!stored.others.layers.empty()) {
    spdlog::info("map {}: {} layers of others", MapPath(config), stored.others.layers.size());
  }
  if (keys != nullptr) {
    spdlog::info("keys {}: signs what it publishes, and believes {} trusted keys alone",
                 config.keys(), keys->trusted().size());
  }
  std::unique_ptr<Daemon> daemon(new Daemon(config, std::move(bus), std::move(notices)));
  daemon->keys_ = keys;
  daemon->parts_ = std::make_unique<Parts>(config, keys, *daemon->bus_, *daemon->notices_,
                                           std::move(file), std::move(stored), std::move(budget));
  SPLINEMAP_RETURN_IF_ERROR(daemon->StartThreads());
  return daemon;
}

Daemon::Daemon(const config::Config& config, std::unique_ptr<LcmBus> bus,
               std::unique_ptr<NoticeLog> notices)
    : config_(config), bus_(std::move(bus)), notices_(std::move(notices)) {}

absl::Status Daemon::StartThreads() {
  Parts& p = *parts_;
  for (const std::string& channel : p.mapping.channels()) {
    p.receiving.Subscribe(channel,
                          [&p](const std::string& name, absl::Span<const uint8_t> message) {
                            p.mapping.Handle(name, message);
                          });
    spdlog::info("listening on {}", channel);
  }
  if (config_.service().sensors() && config_.service().remote_commands()) {
    p.receiving.Subscribe(config_.channel_prefix() + "_TRAJECTORY",
                          [&p](const std::string&, absl::Span<const uint8_t> message) {
                            p.folding.HandleTrajectory(message);
                          });
  }
  if (!config_.placement_channel().empty()) {
    p.receiving.Subscribe(config_.placement_channel(),
                          [&p](const std::string&, absl::Span<const uint8_t> message) {
                            p.folding.HandlePlacement(message);
                          });
  }
  for (const std::string& channel : ReplicationChannels(config_.channel_prefix())) {
    p.receiving.Subscribe(channel, [&p](const std::string&, absl::Span<const uint8_t> message) {
      p.replication.Handle(message);
    });
  }
  for (const std::string& channel : RequestServer::Channels(config_.channel_prefix())) {
    p.receiving.Subscribe(channel, [&p](const std::string&, absl::Span<const uint8_t> message) {
      p.requests.Handle(message);
    });
  }
  // Against the data, so that nobody speaks to a thread that has not started.
  is_running_ = true;
  p.saver.Start(std::chrono::duration<double>(config_.service().save_interval_s()));
  std::promise<absl::Status> saved;  // the new session
  p.saver.Save([&saved](const absl::Status& status) { saved.set_value(status); });
  SPLINEMAP_RETURN_IF_ERROR(saved.get_future().get());
  p.replication.Start([&p](LayerId id, SessionId session, bool is_empty, MappingThread::Done done) {
    p.mapping.StartSession(std::move(id), session, is_empty, std::move(done));
  });
  p.mapping.Start(
      [&p] { p.replication.OnOwnChange(); },
      [&p](const SessionId& session, uint64_t revision, const FixedPose2& layer_T_robot,
           const PackedScan& scan) {
        p.replication.OnOwnScan(session, {revision, scan.pose.utime, layer_T_robot, *scan.beams});
      });
  p.folding.Start();
  p.receiving.Start(p.requests);
  return absl::OkStatus();
}

Daemon::~Daemon() {
  if (const absl::Status status = Stop(); !status.ok()) spdlog::error("{}", ErrorText(status));
}

void Daemon::PublishStatus() {
  parts_->reporter.CheckHealth();
  const Clock::time_point now = Clock::now();
  auto published = std::make_shared<Published>();
  if (const auto before = this->published()) *published = *before;
  if (auto status = parts_->reporter.StatusToPublish(now)) {
    bus_->Publish(config_.channel_prefix() + "_STATUS", *status);
    published->status = *std::move(status);
  }
  if (auto layers = parts_->reporter.LayersToPublish(now)) {
    const std::string channel = config_.channel_prefix() + "_LAYERS";
    bus_->PublishBytes(channel, Signed(keys_.get(), channel, Encode(*layers)));
    published->layers = *std::move(layers);
  }
  MutexLock lock(mutex_);
  published_ = std::move(published);
}

std::shared_ptr<const Daemon::Published> Daemon::published() const {
  MutexLock lock(mutex_);
  return published_;
}

std::optional<std::string> Daemon::FindHangingThread() {
  const auto hanging = parts_->threads.FindHanging();
  bus_->Wake();  // to receive nothing is no step; this is one until the next call
  return hanging;
}

void Daemon::SaveNow() {
  parts_->saver.Save([this](const absl::Status& saved) {
    notices_->Report(
        {.is_problem = !saved.ok(),
         .subject = "save",
         .text = saved.ok() ? "the map is saved" : "the map is not saved: " + ErrorText(saved)});
  });
}

absl::Status Daemon::Stop() {
  if (!std::exchange(is_running_, false)) return absl::OkStatus();
  // In the order of the data, so that each thread gets all that the one before has left; and what
  // the disk lacks comes first, since whoever ends daemons may not wait for long.
  parts_->requests.Stop();
  parts_->receiving.Stop();
  parts_->folding.Stop();
  parts_->mapping.Stop();
  const absl::Status saved = parts_->saver.Stop();
  // What is published last is on disk. Followers may ask for it.
  parts_->receiving.Start(parts_->requests);
  parts_->replication.Stop();
  parts_->receiving.Stop();
  parts_->receiving.Join();
  SPLINEMAP_RETURN_IF_ERROR(saved);
  const status_t status = parts_->reporter.MakeStatus();
  bus_->Publish(config_.channel_prefix() + "_STATUS", status);
  spdlog::info("mapped {} of {} scans with {} poses; {} tiles, saved to {}", status.scans_mapped,
               status.scans_received, status.poses_received, status.tiles, MapPath(config_));
  for (int k = 0; k < status.num_drop_reasons; ++k) {
    spdlog::info("dropped {} {}", status.drop_counts[k], status.drop_reasons[k]);
  }
  return absl::OkStatus();
}

}  // namespace splinemap
