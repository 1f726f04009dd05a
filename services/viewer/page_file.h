#pragma once

#include <string_view>

#include "absl/types/span.h"

namespace splinemap {

// A file of the page, as it was when the program was built.
struct PageFile {
  std::string_view path;
  std::string_view content_type;
  std::string_view content;
};

absl::Span<const PageFile> PageFiles();

}  // namespace splinemap
