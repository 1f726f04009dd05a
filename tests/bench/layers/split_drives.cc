#include "tests/bench/layers/split_drives.h"

#include "tests/bench/accuracy/table.h"
#include "tests/bench/layers/robots.h"
#include "tests/bench/layers/scheme.h"

namespace splinemap {
namespace {

enum class Split { kStretches, kInTurn };

const char* NameOf(Split split) { return split == Split::kStretches ? "stretches" : "in turn"; }

LayersOfRobots MapSplit(const JudgedDrive& drive, Split split, size_t count, double clamp) {
  Robots robots(count, clamp);
  const size_t scans = drive.no_return_ignored.size();
  for (size_t k = 0; k < scans; ++k) {
    const size_t robot = split == Split::kStretches ? k * count / scans : k % count;
    robots.AddScan(robot, drive.no_return_ignored[k]);
  }
  return robots.Layers(count - 1);
}

Judgement JudgeMap(const MapView& map, const JudgedDrive& drive) {
  return Judge(
      [&](const Eigen::Vector2d& point_m) {
        const SurfaceSample sample = map.Evaluate(point_m.x(), point_m.y());
        return sample.known ? sample.log_odds : 0;
      },
      drive);
}

// Judgements of one scheme over the drives.
struct MeanOfDrives {
  std::string scheme;
  size_t robots;
  Split split;
  Judgement sum;

  void Add(const Judgement& judgement) {
    sum.auc += judgement.auc;
    sum.auc_near += judgement.auc_near;
    sum.log_likelihood += judgement.log_likelihood;
  }
};

void WriteMeans(const std::vector<MeanOfDrives>& means, size_t drives, const std::string& out) {
  Table table(out + "/split_drives_mean.csv",
              {"scheme", "robots", "split", "auc", "auc_near", "log_likelihood", "auc_gain",
               "auc_near_gain", "log_likelihood_gain"});
  const double n = static_cast<double>(drives);
  const Judgement& one = means.front().sum;
  for (const auto& [scheme, robots, split, sum] : means) {
    table.Row(scheme, static_cast<int>(robots), std::string(NameOf(split)), sum.auc / n,
              sum.auc_near / n, sum.log_likelihood / n, (sum.auc - one.auc) / n,
              (sum.auc_near - one.auc_near) / n, (sum.log_likelihood - one.log_likelihood) / n);
  }
}

}  // namespace

void WriteSplitDrives(const std::vector<JudgedDrive>& drives, const std::vector<size_t>& robots,
                      const std::string& out) {
  if (drives.empty()) return;
  std::vector<MeanOfDrives> means;  // the first is of one robot with the defaults
  {
    Table table(out + "/split_drives.csv",
                {"scheme", "robots", "split", "drive", "auc", "auc_near", "log_likelihood"});
    for (const std::vector<Scheme>& schemes : SchemesByClamp()) {
      for (const size_t count : robots) {
        for (const Split split : {Split::kStretches, Split::kInTurn}) {
          if (count == 1 && split == Split::kInTurn) continue;
          const size_t first = means.size();
          for (const Scheme& scheme : schemes) means.push_back({scheme.name, count, split, {}});
          for (const JudgedDrive& drive : drives) {
            const LayersOfRobots layers =
                MapSplit(drive, split, count, schemes.front().layer_clamp);
            for (size_t k = 0; k < schemes.size(); ++k) {
              const Judgement judgement = JudgeMap(Merge(layers, schemes[k]), drive);
              means[first + k].Add(judgement);
              table.Row(schemes[k].name, static_cast<int>(count), std::string(NameOf(split)),
                        drive.name, judgement.auc, judgement.auc_near, judgement.log_likelihood);
            }
          }
        }
      }
    }
  }
  WriteMeans(means, drives.size(), out);
}

}  // namespace splinemap
