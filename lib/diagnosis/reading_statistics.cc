#include "lib/diagnosis/reading_statistics.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "fmt/format.h"

namespace splinemap {
namespace {

// No planar scanner on a robot sees so far with most of its beams.
constexpr double kLikelyMillimetres_m = 250;
// Readings beyond range_max_m that are worth words.
constexpr double kManyBeyond = 0.05;
// What range_max_m can be at 5 cm.
constexpr double kLongest_m = 200;
constexpr int64_t kLeastBeams = 20;
constexpr double kPileUpShare = 0.02;
// Longer readings than those of a pile-up are noise.
constexpr double kFewBeyondPileUp = 0.002;

}  // namespace

void ReadingStatistics::Add(const RangeReadings& readings) {
  ++scans_;
  readings_ += std::ssize(readings.ranges_m);
  for (const float range_m : readings.ranges_m) {
    if (!(range_m > 0) || !std::isfinite(range_m)) continue;
    ++ranges_;
    const double bin = double{range_m} / kBin_m;
    if (bin >= static_cast<double>(kMaxBins)) {
      ++far_;
      continue;
    }
    const auto index = static_cast<size_t>(static_cast<int32_t>(bin));  // which rounds down
    if (index >= bins_.size()) bins_.resize(index + 1);
    ++bins_[index];
  }
  // Only what all scans have is worth words.
  const bool all_in_degrees = scans_in_degrees_ == scans_ - 1;
  const bool all_one_bearing = scans_one_bearing_ == scans_ - 1;
  if (readings.bearings_rad.size() < 2 || !(all_in_degrees || all_one_bearing)) return;
  const auto [least, greatest] =
      std::minmax_element(readings.bearings_rad.begin(), readings.bearings_rad.end());
  scans_in_degrees_ += *greatest - *least > 1.2 * 2 * std::numbers::pi;
  scans_one_bearing_ += *greatest == *least;
}

double ReadingStatistics::Share(int64_t readings) const {
  return static_cast<double>(readings) / static_cast<double>(std::max<int64_t>(readings_, 1));
}

int64_t ReadingStatistics::CountBetween(double from_m, double to_m) const {
  int64_t count = 0;
  const auto bin = [&](double range_m) {
    const double most = static_cast<double>(bins_.size());
    return static_cast<size_t>(std::clamp(std::round(range_m / kBin_m), 0.0, most));
  };
  const size_t begin = bin(from_m);
  const size_t end = bin(to_m);
  for (size_t k = begin; k < end; ++k) count += bins_[k];
  return count;
}

std::optional<double> ReadingStatistics::PileUp() const {
  // A robot that stands still sees the same again and again.
  if (readings_ < kLeastBeams * scans_) return std::nullopt;
  // From the longest reading inwards, until too many have been passed.
  int64_t passed = far_;
  for (size_t k = bins_.size(); k-- > 0; passed += bins_[k]) {
    if (Share(passed) > kFewBeyondPileUp) return std::nullopt;
    if (Share(bins_[k]) < kPileUpShare / 2) continue;
    // One value may lie on the edge of two bins.
    const double value_m = static_cast<double>(k) * kBin_m;
    const int64_t at_value = CountBetween(value_m - 1.5 * kBin_m, value_m + 1.5 * kBin_m);
    const int64_t before = CountBetween(value_m - 0.5, value_m - 1.5 * kBin_m);
    if (Share(at_value) >= kPileUpShare && at_value > before) return value_m;
  }
  return std::nullopt;
}

double ReadingStatistics::Quantile(double share) const {
  const auto wanted = static_cast<int64_t>(std::ceil(share * static_cast<double>(ranges_)));
  int64_t passed = 0;
  for (size_t k = 0; k < bins_.size(); ++k) {
    passed += bins_[k];
    if (passed >= wanted) return static_cast<double>(k + 1) * kBin_m;
  }
  return static_cast<double>(kMaxBins) * kBin_m;
}

std::optional<ReadingsComplaint> ReadingStatistics::Complain(double range_max_m) const {
  if (scans_ < kMinScans) return std::nullopt;
  if (scans_one_bearing_ == scans_) {
    return ReadingsComplaint{"all beams of a scan have one bearing: radstep is 0", std::nullopt};
  }
  if (scans_in_degrees_ == scans_) {
    return ReadingsComplaint{
        "the bearings of a scan span more than a turn: they seem to be degrees, and messages have "
        "radians",
        std::nullopt};
  }
  if (ranges_ == 0) {
    return ReadingsComplaint{"none of its readings is a range: all are 0, infinite or no number",
                             std::nullopt};
  }
  if (Quantile(0.5) > kLikelyMillimetres_m) {
    return ReadingsComplaint{
        fmt::format("half of its ranges are longer than {:.0f} m: they seem to be millimetres, and "
                    "messages have metres",
                    kLikelyMillimetres_m),
        std::nullopt};
  }
  const std::optional<double> pile_up_m = PileUp();
  // Beyond it there is no return, too where sensors have several values for it.
  const double end_m = pile_up_m ? *pile_up_m - 2 * kBin_m : Quantile(1) - 0.3;
  const double beyond = Share(CountBetween(range_max_m, end_m));
  if (beyond >= kManyBeyond) {
    // With room for longer ones, unless what is longer is no return.
    const double right_m =
        pile_up_m ? end_m : std::min(std::ceil(1.05 * Quantile(0.999)), kLongest_m);
    return ReadingsComplaint{
        fmt::format("{:.0f} % of its readings lie beyond range_max_m ({:g} m) and are not used; "
                    "set range_max_m={:g}",
                    100 * beyond, range_max_m, right_m),
        right_m};
  }
  if (pile_up_m && *pile_up_m < range_max_m) {
    const double right_m = std::round(end_m / kBin_m) * kBin_m;
    return ReadingsComplaint{
        fmt::format("{:.0f} % of its readings are {:.2f} m, which hardly any exceeds: that is how "
                    "the sensor says no return, and each makes a wall; set range_max_m={:g}",
                    100 * Share(CountBetween(end_m, *pile_up_m + 2 * kBin_m)), *pile_up_m, right_m),
        right_m};
  }
  return std::nullopt;
}

}  // namespace splinemap
