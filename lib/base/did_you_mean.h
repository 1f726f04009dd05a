#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace splinemap {

// " (did you mean NAME?)" with the one of `names` that `word` was likely meant to be: upper and
// lower case aside, it begins with `word`, or is up to two letters away. Else an empty text.
std::string DidYouMean(std::string_view word, const std::vector<std::string>& names);

}  // namespace splinemap
