#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "clients/planner/path_planner.h"
#include "clients/planner/picture.h"
#include "lcmtypes/michigan/path2D_t.hpp"
#include "lib/base/host_clock.h"
#include "lib/base/mutex.h"
#include "lib/base/plain_text.h"
#include "lib/base/status.h"
#include "lib/wire/lcm_bus.h"
#include "lib/wire/sensor_messages.h"
#include "splinemap/key_ring.h"
#include "splinemap/local_map.h"
#include "splinemap/replica.h"

namespace splinemap {
namespace {

using Eigen::Vector2d;

struct Flags {
  std::string lcm_url;
  std::string keys;
  FollowOptions follow;
  std::vector<double> start_m;
  std::string pose_channel;
  std::vector<double> goal_m;
  std::string goal_channel;
  std::string path_channel = "CONTROLLER_PATH";
  std::string picture;
  PlannerOptions planner;
};

// Where the map changed, and since when. Thread-safe.
class Changes {
 public:
  struct Change {
    Region region;
    Clock::time_point since;
  };

  void Add(const Region& region) {
    MutexLock lock(mutex_);
    if (!change_) {
      change_ = {region, Clock::now()};
      return;
    }
    Region& all = change_->region;
    all = {std::min(all.x0_m, region.x0_m), std::min(all.y0_m, region.y0_m),
           std::max(all.x1_m, region.x1_m), std::max(all.y1_m, region.y1_m)};
  }
  std::optional<Change> Take() {
    MutexLock lock(mutex_);
    return std::exchange(change_, std::nullopt);
  }

 private:
  Mutex mutex_;
  std::optional<Change> change_ ABSL_GUARDED_BY(mutex_);
};

bool Touches(const Path& path, double radius_m, const Region& changed) {
  Eigen::AlignedBox2d box;
  for (const Vector2d& point_m : path) box.extend(point_m);
  return box.min().x() - radius_m <= changed.x1_m && box.max().x() + radius_m >= changed.x0_m &&
         box.min().y() - radius_m <= changed.y1_m && box.max().y() + radius_m >= changed.y0_m;
}

Region Mapped(const MapView& map) {
  TileBox tiles;
  map.tiles.ForEach([&](TileKey key, const TileTree::Entry&) { tiles.Add(key); });
  return RegionOf(tiles, map.options.knot_interval_m);
}

bool IsInSync(const MapReplica& replica) {
  const std::vector<FollowedLayer> layers = replica.FollowedLayers();
  return !layers.empty() && std::all_of(layers.begin(), layers.end(),
                                        [](const FollowedLayer& layer) { return layer.caught_up; });
}

double Length(const Path& path) {
  double length_m = 0;
  for (size_t k = 1; k < path.size(); ++k) length_m += (path[k] - path[k - 1]).norm();
  return length_m;
}

// Each pose looks at the next.
michigan::path2D_t PathMessage(const Path& path, double goal_yaw_rad) {
  michigan::path2D_t message;
  message.utime = HostUtime();
  for (size_t k = 0; k < path.size(); ++k) {
    const bool is_last = k + 1 == path.size();
    const Vector2d way = is_last ? Vector2d::Zero() : Vector2d(path[k + 1] - path[k]);
    michigan::pose_xyt_t pose;
    pose.utime = message.utime;
    pose.x = static_cast<float>(path[k].x());
    pose.y = static_cast<float>(path[k].y());
    pose.theta = static_cast<float>(is_last ? goal_yaw_rad : std::atan2(way.y(), way.x()));
    message.path.push_back(pose);
  }
  message.path_length = static_cast<int32_t>(message.path.size());
  return message;
}

// Keeps a path to the goal on the bus that is free in the newest map.
class PlannerNode {
 public:
  PlannerNode(const Flags& flags, LcmBus& bus) : flags_(flags), bus_(bus) {
    if (!flags.start_m.empty()) start_ = Pose2{{flags.start_m[0], flags.start_m[1]}, 0};
    if (!flags.goal_m.empty()) SetGoal({{flags.goal_m[0], flags.goal_m[1]}, 0});
    if (!flags.pose_channel.empty()) {
      Subscribe(flags.pose_channel, [this](const Pose2& pose) { start_ = pose; });
    }
    if (!flags.goal_channel.empty()) {
      Subscribe(flags.goal_channel, [this](const Pose2& pose) { SetGoal(pose); });
    }
  }

  absl::Status Run() {
    Changes changes;
    SPLINEMAP_ASSIGN_OR_RETURN(
        const auto replica,
        MapReplica::Follow(flags_.lcm_url, flags_.follow,
                           [&](const MapView&, const Region& region) { changes.Add(region); }));
    fmt::print(stderr, "waiting for a whole map on {}_DIGESTS\n", flags_.follow.channel_prefix);
    while (!IsInSync(*replica)) {
      bus_.Handle(kTick);
      ReportNews();
    }
    map_.Use(replica->View());  // whether or not it has been told of
    while (true) {
      // All that came while it planned, so that it begins where the robot is.
      for (auto wait = kTick; bus_.Handle(wait) == LcmBus::Handled::kMessage;) wait = {};
      ReportNews();
      const std::optional<Changes::Change> change = changes.Take();
      if (change) map_.Use(replica->View());
      if (!start_ || !goal_) continue;
      SPLINEMAP_ASSIGN_OR_RETURN(const bool is_needed, NeedsPlan(change));
      if (is_needed) SPLINEMAP_RETURN_IF_ERROR(Plan(change));
    }
  }

 private:
  static constexpr std::chrono::milliseconds kTick{2};
  static constexpr std::chrono::seconds kTryAgain{5};

  void Subscribe(const std::string& channel, std::function<void(const Pose2&)> take) {
    bus_.Subscribe(channel, [channel, take](const std::string&, absl::Span<const uint8_t> bytes) {
      if (const absl::StatusOr<TimedPose> pose = DecodePose(bytes); pose.ok()) {
        take(pose->world_T_robot);
      } else {
        fmt::print(stderr, "{}: {}\n", channel, PlainText(ErrorText(pose.status())));
      }
    });
  }

  void ReportNews() {
    if (const auto news = bus_.DrainNews()) fmt::print(stderr, "{}\n", *news);
  }

  void SetGoal(const Pose2& goal) {
    goal_ = goal;
    is_goal_new_ = true;
  }

  // For a new goal, where the path is blocked now, and where there was none: if the map is another,
  // and now and then, since a search that ends after a time may have missed a way.
  absl::StatusOr<bool> NeedsPlan(const std::optional<Changes::Change>& change) const {
    if (is_goal_new_) return true;
    if (path_.empty()) return change || Clock::now() - planned_at_ > kTryAgain;
    if (!change || !Touches(path_, flags_.planner.radius_m, change->region)) return false;
    SPLINEMAP_ASSIGN_OR_RETURN(const bool is_free, IsFree(map_, path_, flags_.planner.radius_m));
    return !is_free;
  }

  absl::Status Plan(const std::optional<Changes::Change>& change) {
    const Clock::time_point begin = Clock::now();
    absl::StatusOr<Path> path =
        PlanPath(map_, Mapped(*map_.View()), start_->position_m, goal_->position_m, flags_.planner);
    if (!path.ok() && !absl::IsNotFound(path.status())) return path.status();
    planned_at_ = Clock::now();
    const bool is_replanned = !is_goal_new_ && !path_.empty();
    const bool is_news = is_goal_new_ || path.ok() || is_replanned;
    is_goal_new_ = false;
    const Path before = std::exchange(path_, path.ok() ? *path : Path());
    if (!is_news) return absl::OkStatus();
    // The start alone says that there is no way.
    bus_.Publish(flags_.path_channel,
                 PathMessage(path.ok() ? *path : Path{start_->position_m}, goal_->yaw_rad));
    const Clock::time_point now = Clock::now();
    using Milliseconds = std::chrono::duration<double, std::milli>;
    fmt::print(stderr, "{}; {}\n",
               path.ok() ? fmt::format("a path of {} points, {:.2f} m", path_.size(), Length(path_))
                         : PlainText(ErrorText(path.status())),
               is_replanned && change
                   ? fmt::format("replanned in {:.0f} ms after the change",
                                 Milliseconds(now - change->since).count())
                   : fmt::format("planned in {:.0f} ms", Milliseconds(now - begin).count()));
    if (flags_.picture.empty()) return absl::OkStatus();
    return WritePicture(*map_.View(),
                        {is_replanned ? before : Path(), path_, flags_.planner.radius_m,
                         start_->position_m, goal_->position_m},
                        flags_.picture);
  }

  const Flags flags_;
  LcmBus& bus_;
  LocalMap map_{std::make_shared<const MapView>()};
  std::optional<Pose2> start_;
  std::optional<Pose2> goal_;
  bool is_goal_new_ = false;
  Path path_;  // the last that was published; empty where there was no way
  Clock::time_point planned_at_;
};

absl::Status Run(Flags flags) {
  if (!flags.keys.empty()) {
    SPLINEMAP_ASSIGN_OR_RETURN(flags.follow.keys, KeyRing::Read(flags.keys));
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const std::unique_ptr<LcmBus> bus, LcmBus::Open(flags.lcm_url));
  return PlannerNode(flags, *bus).Run();
}

constexpr const char* kExamples = R"(
Examples:
  splinemap-planner --pose SLAM_POSE --goal 3,6.5
  splinemap-planner --pose POSE --goal-channel GOAL --radius 0.3 --picture path.png

Follows the map of the daemons on a bus and publishes paths as Michigan's path2D_t
(robot_path_t): for each goal, and again when the map has changed so that the path is blocked.
Where there is no way the path is the start alone. Goals are pose_xyt_t or bot_core.pose_t. Runs
until Ctrl-C.)";

int Main(int argc, char** argv) {
  CLI::App app("splinemap-planner: an example of a planner that asks a map of splinemap.");
  app.footer(kExamples);
  Flags flags;
  app.add_option("--lcm-url", flags.lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL");
  app.add_option("--prefix", flags.follow.channel_prefix, "channel_prefix of the daemons");
  app.add_option("--keys", flags.keys,
                 "Folder of splinemap keys: sign, and believe trusted keys alone")
      ->type_name("FOLDER");
  auto* from = app.add_option_group("from")->require_option(1);
  from->add_option("--start", flags.start_m, "m, where the path begins")
      ->delimiter(',')
      ->expected(2)
      ->type_name("X,Y");
  from->add_option("--pose", flags.pose_channel, "Channel of the robot's poses, where it begins");
  auto* to = app.add_option_group("to")->require_option(1);
  to->add_option("--goal", flags.goal_m, "m, where the path ends")
      ->delimiter(',')
      ->expected(2)
      ->type_name("X,Y");
  to->add_option("--goal-channel", flags.goal_channel, "Channel of goals, each replaces the last");
  app.add_option("--radius", flags.planner.radius_m, "m, of the robot (default 0.2)")
      ->check(CLI::Range(0.01, Sweep::kMaxRadius_m));
  app.add_option("--channel", flags.path_channel, "To publish on (default CONTROLLER_PATH)");
  app.add_option("--picture", flags.picture, "PNG of the map with the path, of each")
      ->type_name("FILE");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  if (const absl::Status status = Run(flags); !status.ok()) {
    fmt::print(stderr, "splinemap-planner: {}\n", PlainLines(ErrorText(status)));
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
