#include "lib/logs/lcm_log.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <list>
#include <optional>

#include "lcm/lcm-cpp.hpp"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/logs/gz_file.h"

namespace splinemap {
namespace {

constexpr std::array<unsigned char, 4> kSync = {0xED, 0xA1, 0xDA, 0x01};
constexpr size_t kHeaderBytes = 28;  // sync, event number, time stamp, two lengths
constexpr size_t kMaxChannelBytes = 1000;
constexpr size_t kMaxMessageBytes = 64 << 20;

uint64_t BigEndian(const unsigned char* bytes, int count) {
  uint64_t value = 0;
  for (int k = 0; k < count; ++k) value = (value << 8) | bytes[k];
  return value;
}

// The part of a file that is looked at, by offsets from the file's beginning.
class Window {
 public:
  explicit Window(GzFile file) : file_(std::move(file)) {}

  // `size` bytes from `offset` on, fewer at the end of the file. Valid until the next call.
  // Requires that nothing at or after `offset` was dropped.
  absl::Span<const uint8_t> Bytes(uint64_t offset, size_t size) {
    const size_t first = offset - begin_;
    while (bytes_.size() < first + size && ReadOn()) {
    }
    return absl::MakeConstSpan(bytes_).subspan(std::min(first, bytes_.size()), size);
  }

  // Requires that the bytes before `offset` were read.
  void DropBefore(uint64_t offset) {
    const auto passed = static_cast<std::ptrdiff_t>(offset - begin_);
    // Now and then, so that each byte is moved once or so.
    if (offset - begin_ < std::max(kStep, bytes_.size() / 2)) return;
    bytes_.erase(bytes_.begin(), bytes_.begin() + passed);
    begin_ = offset;
  }

  const GzFile& file() const { return file_; }

 private:
  static constexpr size_t kStep = 1 << 16;

  bool ReadOn() {
    const size_t size = bytes_.size();
    bytes_.resize(size + kStep);
    bytes_.resize(size + file_.Read(bytes_.data() + size, kStep));
    return bytes_.size() > size;
  }

  GzFile file_;
  uint64_t begin_ = 0;  // offset of bytes_
  std::vector<uint8_t> bytes_;
};

struct EventHeader {
  Utime utime{0};
  size_t channel_bytes = 0;
  size_t message_bytes = 0;
  size_t size() const { return kHeaderBytes + channel_bytes + message_bytes; }
};

// Walks over the events of a file. Where it is damaged, goes on at the next whole event that
// another one or the end of the file follows.
class LogReader {
 public:
  LogReader(std::string path, GzFile file) : path_(std::move(path)), window_(std::move(file)) {}

  // The next event; false at the end of the file. The message is valid until the next call.
  bool Next(LogEvent& event) {
    while (true) {
      window_.DropBefore(offset_);
      const std::optional<EventHeader> header = HeaderAt(offset_);
      if (header && IsEvent(*header)) {
        Take(*header, event);
        return true;
      }
      if (window_.Bytes(offset_, 1).empty()) return false;
      Skip(header.has_value());
    }
  }

  double ShareRead() const { return window_.file().ShareRead(); }

  // Whether everything was read; call it at the end.
  absl::Status status() {
    const bool is_cut = gap_ && gap_->is_cut_event;
    const int64_t gaps = gaps_ - (is_cut ? 1 : 0);
    const uint64_t skipped = skipped_ - (is_cut ? offset_ - gap_->begin : 0);
    if (gaps > 0 && events_ == 0) {
      return InvalidArgument("{} is no LCM log (a CARMEN log is: splinemap import-carmen)", path_);
    }
    std::string text;
    if (gaps > 0) {
      text = fmt::format("{} is damaged: skipped {} bytes (gaps: {}, the first at byte {})", path_,
                         skipped, gaps, first_gap_);
    }
    if (is_cut) {
      text += text.empty() ? path_ : "; it";
      text += fmt::format(" ends within event {}", events_);
    }
    if (text.empty()) return window_.file().status();
    return absl::DataLossError(text);
  }

 private:
  struct Gap {
    uint64_t begin = 0;
    bool is_cut_event = false;  // if it goes on to the end of the file
  };

  // True also for a part of the sync word at the end of the file.
  bool HasSyncAt(uint64_t offset) {
    const absl::Span<const uint8_t> bytes = window_.Bytes(offset, kSync.size());
    return std::equal(bytes.begin(), bytes.end(), kSync.begin());
  }

  // Nothing where no event begins, or none that ends.
  std::optional<EventHeader> HeaderAt(uint64_t offset) {
    const absl::Span<const uint8_t> bytes = window_.Bytes(offset, kHeaderBytes);
    if (bytes.size() < kHeaderBytes || !HasSyncAt(offset)) return std::nullopt;
    EventHeader header;
    header.utime = Utime(static_cast<int64_t>(BigEndian(&bytes[12], 8)));
    header.channel_bytes = BigEndian(&bytes[20], 4);
    header.message_bytes = BigEndian(&bytes[24], 4);
    if (header.channel_bytes > kMaxChannelBytes || header.message_bytes > kMaxMessageBytes ||
        window_.Bytes(offset, header.size()).size() < header.size()) {
      return std::nullopt;
    }
    return header;
  }

  bool IsFollowedByEvent(uint64_t offset, const EventHeader& header) {
    return HasSyncAt(offset + header.size());
  }

  // Whether the event at offset_ can be believed. One that no other follows either stands before
  // damage or has a damaged length; then there is another event within it.
  bool IsEvent(const EventHeader& header) {
    if (IsFollowedByEvent(offset_, header)) return true;
    if (gap_) return false;
    const uint64_t end = offset_ + header.size();
    for (uint64_t inner = NextSync(offset_ + 1, end); inner < end;
         inner = NextSync(inner + 1, end)) {
      const std::optional<EventHeader> inner_header = HeaderAt(inner);
      if (inner_header && IsFollowedByEvent(inner, *inner_header)) return false;
    }
    return true;
  }

  // The next sync word from `offset` on that begins before `end`, or else `end` or the end of the
  // file.
  uint64_t NextSync(uint64_t offset, uint64_t end) {
    const absl::Span<const uint8_t> bytes = window_.Bytes(offset, end - offset + kSync.size() - 1);
    const auto place = std::search(bytes.begin(), bytes.end(), kSync.begin(), kSync.end());
    if (place == bytes.end()) return std::min(end, offset + bytes.size());
    return offset + static_cast<uint64_t>(place - bytes.begin());
  }

  void Take(const EventHeader& header, LogEvent& event) {
    gap_.reset();
    ++events_;
    const absl::Span<const uint8_t> bytes =
        window_.Bytes(offset_, header.size()).subspan(kHeaderBytes);
    event.utime = header.utime;
    event.channel.assign(bytes.begin(), bytes.begin() + header.channel_bytes);
    event.message = bytes.subspan(header.channel_bytes);
    offset_ += header.size();
  }

  void Skip(bool is_whole_event) {
    if (!gap_) {
      gap_ = Gap{offset_, HasSyncAt(offset_) && !is_whole_event};
      if (gaps_++ == 0) first_gap_ = offset_;
    }
    constexpr uint64_t kStep = 1 << 16;
    const uint64_t next = NextSync(offset_ + 1, offset_ + kStep);
    skipped_ += next - offset_;
    offset_ = next;
  }

  std::string path_;
  Window window_;
  uint64_t offset_ = 0;  // of the next event
  int64_t events_ = 0;
  std::optional<Gap> gap_;  // while no event was found after it
  int64_t gaps_ = 0;
  uint64_t skipped_ = 0;
  uint64_t first_gap_ = 0;
};

}  // namespace

// Not lcm::LogFile, whose reader allocates whatever a damaged length claims.
absl::Status ReadLcmLog(const std::string& path, absl::FunctionRef<void(const LogEvent&)> visit,
                        absl::FunctionRef<void(double)> progress) {
  SPLINEMAP_ASSIGN_OR_RETURN(GzFile file, GzFile::Open(path));
  LogReader reader(path, std::move(file));
  LogEvent event;
  for (int64_t count = 0; reader.Next(event); ++count) {
    if (count % 256 == 0) progress(reader.ShareRead());
    visit(event);
  }
  progress(1);
  return reader.status();
}

absl::Status ReadLcmLogInOrder(const std::string& path, const std::vector<std::string>& channels,
                               absl::FunctionRef<Utime(const LogEvent&)> time_of,
                               absl::FunctionRef<void(const LogEvent&)> visit,
                               absl::FunctionRef<void(double)> progress) {
  struct Stream {
    std::string channel;
    LogReader reader;
    LogEvent next;
    Utime time{0};

    bool ReadOn(absl::FunctionRef<Utime(const LogEvent&)> time_of) {
      while (reader.Next(next)) {
        if (next.channel != channel) continue;
        time = time_of(next);
        return true;
      }
      return false;
    }
  };
  std::list<Stream> streams;
  for (const std::string& channel : channels) {
    SPLINEMAP_ASSIGN_OR_RETURN(GzFile file, GzFile::Open(path));
    streams.push_back({channel, LogReader(path, std::move(file)), {}});
  }
  absl::Status status;
  const auto read_on = [&](std::list<Stream>::iterator stream) {
    if (stream->ReadOn(time_of)) return;
    status.Update(stream->reader.status());
    streams.erase(stream);
  };
  for (auto stream = streams.begin(); stream != streams.end();) read_on(stream++);
  for (int64_t count = 0; !streams.empty(); ++count) {
    const auto earliest =
        std::min_element(streams.begin(), streams.end(),
                         [](const Stream& a, const Stream& b) { return a.time < b.time; });
    if (count % 256 == 0) progress(earliest->reader.ShareRead());
    visit(earliest->next);
    read_on(earliest);
  }
  progress(1);
  return status;
}

struct LcmLogWriter::Impl {
  explicit Impl(NewFile new_file)
      : file(std::move(new_file)), log(std::in_place, file.temporary_path(), "w") {}
  absl::Status CannotWrite() const {
    return Unavailable("cannot write {}: {}", file.path(), std::strerror(errno));
  }

  NewFile file;
  std::optional<lcm::LogFile> log;
};

LcmLogWriter::LcmLogWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
LcmLogWriter::LcmLogWriter(LcmLogWriter&&) noexcept = default;
LcmLogWriter& LcmLogWriter::operator=(LcmLogWriter&&) noexcept = default;
LcmLogWriter::~LcmLogWriter() = default;

absl::StatusOr<LcmLogWriter> LcmLogWriter::Create(const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
  auto impl = std::make_unique<Impl>(std::move(file));
  if (!impl->log->good()) return impl->CannotWrite();
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
  return impl_->log->writeEvent(&event) == 0 ? absl::OkStatus() : impl_->CannotWrite();
}

absl::Status LcmLogWriter::Close() {
  if (!impl_) return FailedPrecondition("this log is closed");
  const std::unique_ptr<Impl> impl = std::move(impl_);
  if (std::fflush(impl->log->getFilePtr()) != 0) return impl->CannotWrite();
  impl->log.reset();
  return impl->file.Commit();
}

}  // namespace splinemap
