#include "lib/fleet/fleet_key.h"

#include <algorithm>
#include <charconv>
#include <vector>

#include "absl/strings/str_split.h"
#include "fmt/format.h"
#include "lib/layers/validity.h"

namespace splinemap {
namespace {

bool IsPlain(unsigned char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
         c == '-';
}

template <typename Integer>
std::optional<Integer> ParseInteger(std::string_view text, int base) {
  Integer value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, base);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::string LayerToken(const LayerId& id) {
  return fmt::format("{}.{:016x}", TokenOf(id.name), id.origin);
}

}  // namespace

int PartOf(BlockKey block) {
  // Neighbours are in different parts, so that several workers share a building.
  constexpr int kBlocks = kSquareSide / BlockKey::kSide;
  static_assert(kBlocks == 8);
  const auto x = static_cast<uint32_t>(block.x >> 3);
  const auto y = static_cast<uint32_t>(block.y >> 3);
  return static_cast<int>((x % 8) + 8 * (y % 8));
}

std::string TokenOf(std::string_view name) {
  std::string token;
  for (const char c : name) {
    if (IsPlain(static_cast<unsigned char>(c))) {
      token += c;
    } else {
      token += fmt::format("={:02x}", static_cast<unsigned char>(c));
    }
  }
  return token;
}

std::string NameOfToken(std::string_view token) {
  std::string name;
  for (size_t k = 0; k < token.size(); ++k) {
    if (token[k] != '=') {
      name += token[k];
      continue;
    }
    const auto byte = ParseInteger<uint8_t>(token.substr(k + 1, 2), 16);
    if (!byte || k + 2 >= token.size()) return "";
    name += static_cast<char>(*byte);
    k += 2;
  }
  return TokenOf(name) == token ? name : "";  // each name has one token
}

std::string SettingsKey(const LayerId& id) { return "settings." + LayerToken(id); }
std::string DigestKey(const LayerId& id) { return "layers." + LayerToken(id) + ".digest"; }

std::string BlockKeyOf(const LayerId& id, BlockKey block) {
  return fmt::format("layers.{}.tiles.{:02}.{}.{}", LayerToken(id), PartOf(block), block.x,
                     block.y);
}

std::string DigestFilter(const std::string& name) {
  return "layers." + TokenOf(name) + ".*.digest";
}
std::string LayerFilter(const LayerId& id) { return "layers." + LayerToken(id) + ".>"; }
std::string TilesFilter(const LayerId& id) { return "layers." + LayerToken(id) + ".tiles.>"; }
std::string PartFilter(int part) { return fmt::format("layers.*.*.tiles.{:02}.>", part); }

bool MatchesFilter(std::string_view filter, std::string_view key) {
  while (true) {
    if (filter == ">") return !key.empty();
    const size_t filter_end = std::min(filter.find('.'), filter.size());
    const size_t key_end = std::min(key.find('.'), key.size());
    const std::string_view token = filter.substr(0, filter_end);
    if (token != "*" && token != key.substr(0, key_end)) return false;
    if (filter_end == filter.size() || key_end == key.size()) {
      return filter_end == filter.size() && key_end == key.size();
    }
    filter.remove_prefix(filter_end + 1);
    key.remove_prefix(key_end + 1);
  }
}

FleetKey ParseFleetKey(std::string_view key) {
  using Kind = FleetKey::Kind;
  if (key == kMapKey) return {.kind = Kind::kMap};
  const std::vector<std::string> tokens = absl::StrSplit(std::string(key), '.');
  if (tokens.size() < 3) return {};
  const auto origin = ParseInteger<uint64_t>(tokens[2], 16);
  FleetKey parsed{.layer = {NameOfToken(tokens[1]), origin.value_or(0)}};
  if (!origin || !CheckLayerId(parsed.layer).ok()) return {};
  if (key == SettingsKey(parsed.layer)) {
    parsed.kind = Kind::kSettings;
  } else if (key == DigestKey(parsed.layer)) {
    parsed.kind = Kind::kDigest;
  } else if (tokens[0] == "layers" && tokens.size() == 7 && tokens[3] == "tiles") {
    const auto x = ParseInteger<int32_t>(tokens[5], 10);
    const auto y = ParseInteger<int32_t>(tokens[6], 10);
    if (!x || !y) return {};
    parsed.kind = Kind::kBlock;
    parsed.block = {*x, *y};
    if (!parsed.block.IsInRange() || BlockKeyOf(parsed.layer, parsed.block) != key) {
      return {};
    }
  }
  return parsed;
}

}  // namespace splinemap
