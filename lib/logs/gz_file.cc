#include "lib/logs/gz_file.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "lib/base/status.h"

namespace splinemap {

absl::StatusOr<GzFile> GzFile::Open(const std::string& path) {
  std::error_code error;
  const auto file_bytes = static_cast<double>(std::filesystem::file_size(path, error));
  if (error) return NotFound("cannot read {}: {}", path, error.message());
  const gzFile file = gzopen(path.c_str(), "rb");
  if (file == nullptr) return NotFound("cannot read {}: {}", path, std::strerror(errno));
  return GzFile(path, file, file_bytes);
}

size_t GzFile::Read(uint8_t* data, size_t size) {
  // Of gzip data in small steps, since zlib keeps nothing of the step in which it meets damage.
  constexpr size_t kStep = 1 << 12;
  constexpr size_t kPlainStep = 1 << 16;  // without a way by zlib's buffer
  const size_t step = gzdirect(file_.get()) == 1 ? kPlainStep : kStep;
  size_t done = 0;
  while (done < size) {
    const int count =
        gzread(file_.get(), data + done, static_cast<unsigned>(std::min(step, size - done)));
    if (count <= 0) break;
    done += static_cast<size_t>(count);
  }
  return done;
}

bool GzFile::ReadLine(std::string& line) {
  constexpr size_t kMaxLine = 1 << 20;
  line.clear();
  for (int c; (c = gzgetc(file_.get())) != -1;) {
    if (c == '\r') {
      const int next = gzgetc(file_.get());
      if (next != '\n' && next != -1) gzungetc(next, file_.get());
      return true;
    }
    if (c == '\n') return true;
    line += static_cast<char>(c);
    if (line.size() > kMaxLine) return true;
  }
  return !line.empty();
}

double GzFile::ShareRead() const {
  return static_cast<double>(gzoffset(file_.get())) / std::max(file_bytes_, 1.0);
}

absl::Status GzFile::status() const {
  int code = Z_OK;
  const char* text = gzerror(file_.get(), &code);
  if (code == Z_OK || code == Z_STREAM_END) return absl::OkStatus();
  if (code == Z_ERRNO) return DataLoss("{} cannot be read to its end: {}", path_, text);
  return DataLoss("{} is cut off or damaged, as its gzip data say", path_);
}

}  // namespace splinemap
