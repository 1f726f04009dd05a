// Asks a daemon how far a robot at the origin sees in four directions, and how near obstacles are.
#include <splinemap/client.h>

#include <cstdio>
#include <numbers>
#include <string>

namespace {

template <typename Answer>
bool IsGood(const absl::StatusOr<Answer>& answer) {
  if (!answer.ok()) {
    std::fprintf(stderr, "%s\n", std::string(answer.status().message()).c_str());
  }
  return answer.ok();
}

}  // namespace

int main() {
  splinemap::ClientOptions options;
  options.deadline = std::chrono::seconds(10);
  const auto client = splinemap::MapClient::Connect("", options);
  if (!IsGood(client)) return 1;
  std::printf("asked %s\n", (*client)->daemon().name.c_str());

  splinemap::RaysQuery rays;
  for (int quarter = 0; quarter < 4; ++quarter) {
    rays.rays.push_back({{0, 0}, quarter * std::numbers::pi / 2, 20});
  }
  const auto ends = (*client)->Ask(rays);
  if (!IsGood(ends)) return 1;
  for (const splinemap::RaysQuery::End& end : ends->ends) std::printf("%.3f m\n", end.range_m);

  const auto distances = (*client)->Ask(splinemap::DistancesQuery{{{0, 0}}, 10});
  if (!IsGood(distances)) return 1;
  std::printf("the nearest obstacle is %.3f m away\n", distances->distances[0].distance_m);
  return 0;
}
