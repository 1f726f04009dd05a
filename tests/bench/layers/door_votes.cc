#include "tests/bench/layers/door_votes.h"

#include <algorithm>
#include <iterator>
#include <random>
#include <vector>

#include "tests/bench/accuracy/corridor.h"
#include "tests/bench/accuracy/table.h"
#include "tests/bench/layers/robots.h"
#include "tests/bench/layers/scheme.h"

namespace splinemap {
namespace {

struct Situation {
  size_t others = 0;
  bool itself = false;      // saw the door before as the others did
  bool now_closed = false;  // and open before
};

struct Votes {
  int scans_most = -1;
  int scans_all = -1;
  int robots = -1;  // -1 where two more than the others are not enough
};

// Places along the corridor before the door, the first right before it.
Corridor At(size_t robot) {
  constexpr double kPlaces_m[] = {0, 0.3, -0.3, 0.6, -0.6};
  return Corridor({kPlaces_m[robot % std::size(kPlaces_m)], 0});
}

// Tiles with all control points of the surface at the door.
std::vector<TileKey> KeysAt(const std::vector<Eigen::Vector2d>& points_m) {
  std::vector<TileKey> keys;
  for (const Eigen::Vector2d& point_m : points_m) {
    const Eigen::Vector2i knot = (point_m / kKnotInterval_m).array().floor().cast<int>();
    for (const int x : {-1, 2}) {
      for (const int y : {-1, 2}) {
        const TileKey key = TileOf(knot.x() + x, knot.y() + y);
        if (std::find(keys.begin(), keys.end(), key) == keys.end()) keys.push_back(key);
      }
    }
  }
  return keys;
}

// All schemes over the same layers.
class Vote {
 public:
  Vote(const std::vector<Scheme>& schemes, const Situation& situation)
      : schemes_(schemes),
        situation_(situation),
        robots_(2 * situation.others + 3, schemes.front().layer_clamp),
        votes_(schemes.size()) {}

  std::vector<Votes> Run(const DoorEffort& effort) {
    const size_t first = situation_.others;  // of those that see the door as it is now
    for (size_t robot = 0; robot < first + (situation_.itself ? 1 : 0); ++robot) {
      See(robot, !situation_.now_closed, effort.scans_before);
    }
    for (int scans = 1; scans <= effort.max_scans; ++scans) {
      See(first, situation_.now_closed, 1);
      Count([&](Votes& votes, double share) {
        if (votes.scans_most < 0 && share > 0.5) votes.scans_most = scans;
        if (votes.scans_all < 0 && share == 1) votes.scans_all = scans;
      });
    }
    for (size_t robot = first; robot < 2 * first + 3; ++robot) {
      if (robot > first) See(robot, situation_.now_closed, effort.scans_before);
      Count([&](Votes& votes, double share) {
        if (votes.robots < 0 && share > 0.5) votes.robots = static_cast<int>(robot - first + 1);
      });
    }
    return votes_;
  }

 private:
  void See(size_t robot, bool closed, int scans) {
    const Corridor corridor = At(robot < situation_.others ? robot + 1 : robot - situation_.others);
    for (int n = 0; n < scans; ++n) robots_.AddScan(robot, corridor.Scan(closed, random_));
  }

  // Shares of the door's points that each scheme sees as they are.
  template <typename Use>
  void Count(const Use& use) {
    const LayersOfRobots layers = robots_.Layers(situation_.others);
    for (size_t k = 0; k < schemes_.size(); ++k) {
      if (votes_[k].scans_all >= 0 && votes_[k].robots >= 0) continue;
      const MapView map = Merge(layers, schemes_[k], keys_);
      double agree = 0;
      for (const Eigen::Vector2d& point_m : points_m_) {
        const SurfaceSample sample = map.Evaluate(point_m.x(), point_m.y());
        if (!sample.known) continue;
        agree += situation_.now_closed ? sample.log_odds > 0 : sample.log_odds < 0;
      }
      use(votes_[k], agree / static_cast<double>(points_m_.size()));
    }
  }

  const std::vector<Scheme>& schemes_;
  const Situation situation_;
  const std::vector<Eigen::Vector2d> points_m_ = At(0).door_points_m();
  const std::vector<TileKey> keys_ = KeysAt(points_m_);
  Robots robots_;
  std::mt19937_64 random_{1};
  std::vector<Votes> votes_;
};

}  // namespace

void WriteDoorVotes(const DoorEffort& effort, const std::string& out) {
  Table table(out + "/door_votes.csv", {"scheme", "others", "itself", "now", "scans_until_most",
                                        "scans_until_all", "robots"});
  for (const std::vector<Scheme>& schemes : SchemesByClamp()) {
    for (const size_t others : {0, 1, 2, 4, 9}) {
      for (const bool itself : {false, true}) {
        if (others == 0 && !itself) continue;
        for (const bool now_closed : {true, false}) {
          const std::vector<Votes> votes = Vote(schemes, {others, itself, now_closed}).Run(effort);
          for (size_t k = 0; k < schemes.size(); ++k) {
            table.Row(schemes[k].name, static_cast<int>(others), static_cast<int>(itself),
                      std::string(now_closed ? "closed" : "open"), votes[k].scans_most,
                      votes[k].scans_all, votes[k].robots);
          }
        }
      }
    }
  }
}

}  // namespace splinemap
