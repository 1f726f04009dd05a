#include "clients/splinemap/map_source.h"

#include "absl/strings/numbers.h"
#include "clients/splinemap/commands.h"
#include "lib/base/status.h"
#include "lib/map/summed_layers.h"
#include "lib/query/local_map.h"
#include "lib/store/map_file.h"

namespace splinemap {

void AddAskedMapFlags(CLI::App& command, const std::string& words, const std::string& what,
                      MapSourceFlags& flags) {
  command.add_option(words, flags.words, "Map file, but with --live none; " + what);
  CLI::Option* const live =
      command.add_flag("--live", flags.live, "Ask a running splinemapd instead of a map file");
  command.add_option("--lcm-url", flags.lcm_url, "LCM bus (default: LCM_DEFAULT_URL)")
      ->type_name("URL")
      ->needs(live);
  command.add_option("--prefix", flags.client.channel_prefix, "channel_prefix of the daemon")
      ->needs(live);
  command
      .add_option("--robot", flags.client.robot, "Robot to ask (default: the first that answers)")
      ->type_name("NAME")
      ->needs(live);
  command.add_option("--timeout", flags.timeout_s, "s until it gives up (default 2)")
      ->check(CLI::Range(0.01, 1e6))
      ->needs(live);
}

absl::StatusOr<absl::Span<const std::string>> WordsAfterMap(const MapSourceFlags& flags) {
  const absl::Span<const std::string> words = flags.words;
  if (flags.live) return words;
  if (words.empty()) return InvalidArgument("name a map file, or ask a daemon with --live");
  return words.subspan(1);
}

absl::StatusOr<std::vector<double>> NumbersAfterMap(const MapSourceFlags& flags) {
  SPLINEMAP_ASSIGN_OR_RETURN(const auto words, WordsAfterMap(flags));
  std::vector<double> numbers;
  for (const std::string& word : words) {
    double number = 0;
    if (!absl::SimpleAtod(word, &number)) {
      return InvalidArgument("{} is no number{}", word,
                             flags.live ? "; with --live no map file is named" : "");
    }
    numbers.push_back(number);
  }
  return numbers;
}

std::vector<Eigen::Vector2d> PointsOf(absl::Span<const double> numbers) {
  std::vector<Eigen::Vector2d> points;
  for (size_t k = 0; k < numbers.size(); k += 2) points.emplace_back(numbers[k], numbers[k + 1]);
  return points;
}

absl::StatusOr<MapSource> OpenMapSource(const MapSourceFlags& flags) {
  if (flags.live) {
    ClientOptions options = flags.client;
    options.deadline = std::chrono::ceil<std::chrono::milliseconds>(
        std::chrono::duration<double>(flags.timeout_s));
    SPLINEMAP_ASSIGN_OR_RETURN(auto client, MapClient::Connect(flags.lcm_url, options));
    return MapSource{std::move(client), kSuccess};
  }
  SPLINEMAP_ASSIGN_OR_RETURN(const LoadedMap loaded, ReadMapFile(flags.words.at(0)));
  return MapSource{std::make_unique<LocalMap>(ViewOf(loaded.set)), ReportCorruption(loaded)};
}

void AddOccupiedFlag(CLI::App& command, double& occupied_log_odds) {
  command
      .add_option("--occupied", occupied_log_odds,
                  "Log-odds from which on a point is occupied (default 0)")
      ->type_name("LOG_ODDS");
}

void AddObstacleFlags(CLI::App& command, ObstacleFlags& flags) {
  AddOccupiedFlag(command, flags.occupied_log_odds);
  command
      .add_option("--unknown", flags.unknown,
                  "Whether what was never seen stops it, or passes as free (default stops)")
      ->check(CLI::IsMember({"stops", "passes"}));
}

const char* NameOf(Occupancy occupancy) {
  return occupancy == Occupancy::kFree       ? "free"
         : occupancy == Occupancy::kOccupied ? "occupied"
                                             : "unknown";
}

}  // namespace splinemap
