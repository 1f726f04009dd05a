#include "lib/logs/lcm_log.h"

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "lcm/lcm-cpp.hpp"
#include "lib/base/status.h"

namespace splinemap {
namespace {

constexpr std::array<unsigned char, 4> kSync = {0xED, 0xA1, 0xDA, 0x01};
constexpr size_t kHeaderBytes = 28;  // sync, event number, time stamp, two lengths
constexpr uint32_t kMaxChannelBytes = 1000;
constexpr uint32_t kMaxMessageBytes = 64 << 20;

struct FileCloser {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

uint64_t BigEndian(const unsigned char* bytes, int count) {
  uint64_t value = 0;
  for (int k = 0; k < count; ++k) value = (value << 8) | bytes[k];
  return value;
}

}  // namespace

// Not lcm::LogFile, whose reader allocates whatever a damaged length claims.
absl::Status ReadLcmLog(const std::string& path, absl::FunctionRef<void(const LogEvent&)> visit,
                        absl::FunctionRef<void(double)> progress) {
  std::unique_ptr<std::FILE, FileCloser> file(std::fopen(path.c_str(), "rb"));
  if (!file) return NotFound("cannot read {}: {}", path, std::strerror(errno));
  std::error_code error;
  const auto file_bytes = static_cast<double>(std::filesystem::file_size(path, error));
  if (error) return InvalidArgument("cannot read {}: {}", path, error.message());

  std::array<unsigned char, kHeaderBytes> header;
  std::vector<uint8_t> message;
  LogEvent event;
  size_t bytes_read = 0;
  for (int64_t count = 0;; ++count) {
    if (count % 256 == 0) progress(static_cast<double>(bytes_read) / std::max(file_bytes, 1.0));
    const size_t header_size = std::fread(header.data(), 1, header.size(), file.get());
    if (header_size == 0) break;
    if (header_size < header.size()) {
      return DataLoss("{} ends within event {}", path, count);
    }
    if (!std::equal(kSync.begin(), kSync.end(), header.begin())) {
      if (count == 0) {
        return InvalidArgument("{} is no LCM log (a CARMEN log is: splinemap import-carmen)", path);
      }
      return DataLoss("{} is damaged: no event {} at byte {}", path, count, bytes_read);
    }
    const auto channel_bytes = static_cast<uint32_t>(BigEndian(&header[20], 4));
    const auto message_bytes = static_cast<uint32_t>(BigEndian(&header[24], 4));
    if (channel_bytes > kMaxChannelBytes || message_bytes > kMaxMessageBytes) {
      return DataLoss("{} is damaged: event {} at byte {} claims {} bytes", path, count, bytes_read,
                      message_bytes);
    }
    event.utime = Utime(static_cast<int64_t>(BigEndian(&header[12], 8)));
    bytes_read += kHeaderBytes + channel_bytes + message_bytes;
    const bool is_complete = static_cast<double>(bytes_read) <= file_bytes;
    event.channel.resize(channel_bytes);
    message.resize(is_complete ? message_bytes : 0);
    if (!is_complete ||
        std::fread(event.channel.data(), 1, channel_bytes, file.get()) != channel_bytes ||
        std::fread(message.data(), 1, message_bytes, file.get()) != message_bytes) {
      return DataLoss("{} ends within event {}", path, count);
    }
    event.message = message;
    visit(event);
  }
  if (std::ferror(file.get())) {
    return DataLoss("cannot read {}: {}", path, std::strerror(errno));
  }
  progress(1);
  return absl::OkStatus();
}

struct LcmLogWriter::Impl {
  explicit Impl(const std::string& log_path) : path(log_path), file(log_path, "w") {}
  std::string path;
  lcm::LogFile file;
};

LcmLogWriter::LcmLogWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
LcmLogWriter::LcmLogWriter(LcmLogWriter&&) noexcept = default;
LcmLogWriter& LcmLogWriter::operator=(LcmLogWriter&&) noexcept = default;
LcmLogWriter::~LcmLogWriter() = default;

absl::StatusOr<LcmLogWriter> LcmLogWriter::Create(const std::string& path) {
  auto impl = std::make_unique<Impl>(path);
  if (!impl->file.good()) return Unavailable("cannot write {}: {}", path, std::strerror(errno));
  return LcmLogWriter(std::move(impl));
}

absl::Status LcmLogWriter::WriteBytes(Utime utime, const std::string& channel,
                                      std::vector<uint8_t>& message) {
  if (!impl_) return FailedPrecondition("this log is closed");
  lcm::LogEvent event;
  event.timestamp = utime.count();
  event.channel = channel;
  event.datalen = static_cast<int32_t>(message.size());
  event.data = message.data();
  if (impl_->file.writeEvent(&event) != 0) {
    return Unavailable("cannot write {}: {}", impl_->path, std::strerror(errno));
  }
  return absl::OkStatus();
}

absl::Status LcmLogWriter::Close() {
  if (!impl_) return FailedPrecondition("this log is closed");
  const bool flushed = std::fflush(impl_->file.getFilePtr()) == 0;
  const absl::Status status =
      flushed ? absl::OkStatus()
              : Unavailable("cannot write {}: {}", impl_->path, std::strerror(errno));
  impl_.reset();
  return status;
}

}  // namespace splinemap
