#pragma once

#include <zlib.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace splinemap {

// A file, plain or gzip, that is read once from its beginning. Thread-compatible.
class GzFile {
 public:
  // NotFound in words where it cannot be opened.
  static absl::StatusOr<GzFile> Open(const std::string& path);

  // Reads up to `size` bytes; fewer only at the end, or where the file is damaged.
  size_t Read(uint8_t* data, size_t size);

  // The next line without its end (LF, CR LF or CR); false at the end of the file. A line of more
  // than a MiB comes in parts.
  bool ReadLine(std::string& line);

  // The share of the file that was read, 0 .. 1.
  double ShareRead() const;

  // DataLoss where gzip data are cut off or damaged, or the system could not read on.
  absl::Status status() const;

 private:
  struct Closer {
    void operator()(gzFile file) const { gzclose(file); }
  };

  GzFile(std::string path, gzFile file, double file_bytes)
      : path_(std::move(path)), file_(file), file_bytes_(file_bytes) {}

  std::string path_;
  std::unique_ptr<std::remove_pointer_t<gzFile>, Closer> file_;
  double file_bytes_;
};

}  // namespace splinemap
