#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/types/span.h"

namespace splinemap {

// A value of a row: an integer, or the bytes of a text or blob. NULL is the integer 0.
struct PageColumn {
  int64_t integer = 0;
  std::string_view bytes;
  bool is_bytes = false;
};

// Visits the rows of all tables of a SQLite database in its pages, one after the other, without the
// trees that join them: for a file of which some pages are damaged. Which table a row is of shows
// in its columns alone, and whether it is what was written in its checksums alone. Pages are as of
// the last whole transaction, in the file or in the -wal beside it. Runs nothing that the file
// says. NotFound where the file cannot be read; what a damaged page holds may not be visited.
absl::Status ForEachRowOfPages(
    const std::string& path,
    absl::FunctionRef<void(int64_t rowid, absl::Span<const PageColumn> columns)> visit);

// Writes the pages that whole transactions have put into the -wal beside into the file, and brings
// it to the disk: a checkpoint, of a file that SQLite does not open. Unavailable where it cannot be
// written.
absl::Status CheckpointPages(const std::string& path);

}  // namespace splinemap
