#include "lib/base/did_you_mean.h"

#include <algorithm>
#include <cctype>
#include <numeric>

namespace splinemap {
namespace {

// Levenshtein's: letters to insert, remove or replace, row by row of the table.
size_t EditDistance(std::string_view a, std::string_view b) {
  std::vector<size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), size_t{0});
  for (const char letter : a) {
    size_t diagonal = row[0]++;
    for (size_t k = 0; k < b.size(); ++k) {
      const size_t replaced = diagonal + (std::tolower(letter) != std::tolower(b[k]) ? 1 : 0);
      diagonal = row[k + 1];
      row[k + 1] = std::min({replaced, row[k] + 1, diagonal + 1});
    }
  }
  return row.back();
}

size_t Distance(std::string_view word, std::string_view name) {
  const bool begins_so = word.size() > 1 && EditDistance(word, name.substr(0, word.size())) == 0;
  return begins_so ? 0 : EditDistance(word, name);
}

}  // namespace

std::string DidYouMean(std::string_view word, const std::vector<std::string>& names) {
  constexpr size_t kMaxDistance = 2;
  constexpr size_t kMaxLength = 100;  // of what may come from a hostile bus
  size_t nearest = std::min(kMaxDistance, word.size() / 2) + 1;
  std::string found;
  for (const std::string& name : names) {
    if (word.size() > kMaxLength || name.size() > kMaxLength) continue;
    const size_t distance = Distance(word, name);
    if (distance < nearest) found = name;
    nearest = std::min(nearest, distance);
  }
  return found.empty() ? "" : " (did you mean " + found + "?)";
}

}  // namespace splinemap
