#include "lib/fleet/work_sharing.h"

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <utility>

#include "fmt/format.h"

namespace splinemap {
namespace {

constexpr std::chrono::milliseconds kFollowLonger(1000);

using Claim = std::pair<uint64_t, uint64_t>;  // hash, worker: the greatest own the part

Claim ClaimOf(int part, uint64_t worker) {
  const std::array<uint64_t, 2> content{static_cast<uint64_t>(part), worker};
  return {XXH3_64bits(content.data(), sizeof(content)), worker};
}

std::optional<uint64_t> ParseHex(std::string_view text) {
  uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number, 16);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

}  // namespace

std::vector<uint64_t> OwnersOf(int part, const std::set<uint64_t>& workers) {
  std::vector<Claim> claims;
  claims.reserve(workers.size());
  for (const uint64_t worker : workers) claims.push_back(ClaimOf(part, worker));
  const size_t owners = std::min(kOwners, claims.size());
  std::partial_sort(claims.begin(), claims.begin() + static_cast<ptrdiff_t>(owners), claims.end(),
                    std::greater<>());
  std::vector<uint64_t> ids;
  for (size_t k = 0; k < owners; ++k) ids.push_back(claims[k].second);
  return ids;
}

std::string EncodeWord(const WorkerWord& word) {
  return fmt::format("{:016x} {:016x}", word.worker, word.complete.to_ullong());
}

std::optional<WorkerWord> DecodeWord(std::string_view text) {
  constexpr size_t kDigits = 16;
  if (text.size() != 2 * kDigits + 1 || text[kDigits] != ' ') return std::nullopt;
  const auto worker = ParseHex(text.substr(0, kDigits));
  const auto complete = ParseHex(text.substr(kDigits + 1));
  if (!worker || !complete) return std::nullopt;
  return WorkerWord{*worker, PartSet(*complete)};
}

void WorkShare::Hear(const WorkerWord& word, Clock::time_point now) {
  if (word.worker == worker_) return;
  if (heard_.contains(word.worker) || heard_.size() < kMaxWorkers) {
    heard_[word.worker] = {now, word.complete};
  }
}

void WorkShare::Update(Clock::time_point now) {
  std::erase_if(heard_, [&](const auto& heard) { return now - heard.second.when > kPatience; });
  std::set<uint64_t> workers = {worker_};
  for (const auto& [worker, heard] : heard_) workers.insert(worker);
  workers_ = workers.size();
  for (int part = 0; part < kParts; ++part) {
    const auto bit = static_cast<size_t>(part);
    const std::vector<uint64_t> owners = OwnersOf(part, workers);
    owned_[bit] = std::find(owners.begin(), owners.end(), worker_) != owners.end();
    published_[bit] = owners.front() == worker_;
    const bool others_have_it = std::any_of(owners.begin(), owners.end(), [&](uint64_t owner) {
      return owner != worker_ && heard_[owner].complete[bit];
    });
    if (owned_[bit] || (answered_[bit] && !others_have_it)) kept_until_[part] = now + kHandOver;
    const auto kept_until = kept_until_.find(part);
    answered_[bit] = kept_until != kept_until_.end() && now <= kept_until->second;
    followed_[bit] = kept_until != kept_until_.end() && now <= kept_until->second + kFollowLonger;
  }
}

}  // namespace splinemap
