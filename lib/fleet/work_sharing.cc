#include "lib/fleet/work_sharing.h"

#include <xxhash.h>

#include <array>
#include <utility>

namespace splinemap {
namespace {

using Claim = std::pair<uint64_t, uint64_t>;  // hash, worker: the greatest own the part

Claim ClaimOf(int part, uint64_t worker) {
  const std::array<uint64_t, 2> content{static_cast<uint64_t>(part), worker};
  return {XXH3_64bits(content.data(), sizeof(content)), worker};
}

}  // namespace

WorkShare ShareOf(uint64_t worker, const std::set<uint64_t>& workers) {
  WorkShare share;
  for (int part = 0; part < kParts; ++part) {
    const Claim own = ClaimOf(part, worker);
    int before = 0;
    for (const uint64_t other : workers) {
      if (other != worker && ClaimOf(part, other) > own) ++before;
    }
    share.parts[static_cast<size_t>(part)] = before < kOwners;
    share.published[static_cast<size_t>(part)] = before == 0;
  }
  return share;
}

void WorkersHeard::Hear(uint64_t worker, Clock::time_point now) {
  if (heard_.contains(worker) || heard_.size() < kMaxWorkers) heard_[worker] = now;
}

std::set<uint64_t> WorkersHeard::Alive(Clock::time_point now) {
  std::erase_if(heard_, [&](const auto& heard) { return now - heard.second > kPatience; });
  std::set<uint64_t> alive;
  for (const auto& [worker, when] : heard_) alive.insert(worker);
  return alive;
}

}  // namespace splinemap
