#include "lib/store/page_scan.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <map>
#include <optional>
#include <vector>

#include "absl/cleanup/cleanup.h"
#include "lib/base/file.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

// What MakeSchema() sets; a damaged header does not say it reliably.
constexpr size_t kPageBytes = 4096;
constexpr size_t kFileHeaderBytes = 100;
constexpr size_t kMaxRowBytes = 1 << 20;
constexpr size_t kMaxColumns = 8;
constexpr uint8_t kTableLeaf = 0x0d;

using Page = std::array<uint8_t, kPageBytes>;

uint32_t BigEndian32(const uint8_t* bytes) {
  return uint32_t{bytes[0]} << 24 | uint32_t{bytes[1]} << 16 | uint32_t{bytes[2]} << 8 | bytes[3];
}
uint32_t LittleEndian32(const uint8_t* bytes) {
  return uint32_t{bytes[3]} << 24 | uint32_t{bytes[2]} << 16 | uint32_t{bytes[1]} << 8 | bytes[0];
}

class File {
 public:
  explicit File(const std::string& path) : descriptor_(open(path.c_str(), O_RDONLY | O_CLOEXEC)) {}
  ~File() {
    if (descriptor_ >= 0) close(descriptor_);
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  bool is_open() const { return descriptor_ >= 0; }
  size_t Bytes() const {
    const off_t end = lseek(descriptor_, 0, SEEK_END);
    return end < 0 ? 0 : static_cast<size_t>(end);
  }
  // False where so many bytes are not there; the rest of them is 0 then.
  bool Read(size_t place, absl::Span<uint8_t> bytes) const {
    std::fill(bytes.begin(), bytes.end(), uint8_t{0});
    size_t done = 0;
    while (done < bytes.size()) {
      const ssize_t n = pread(descriptor_, bytes.data() + done, bytes.size() - done,
                              static_cast<off_t>(place + done));
      if (n <= 0) return false;
      done += static_cast<size_t>(n);
    }
    return true;
  }

 private:
  int descriptor_;
};

// Where the pages stand that transactions have put into the -wal, as in
// https://www.sqlite.org/fileformat2.html#walformat.
std::map<uint32_t, size_t> PagesOfLog(const File& log) {
  constexpr size_t kHeaderBytes = 32;
  constexpr size_t kFrameHeaderBytes = 24;
  constexpr uint32_t kMagic = 0x377f0682;  // | 1 where checksums are of big-endian words
  std::map<uint32_t, size_t> committed;
  std::array<uint8_t, kHeaderBytes> header{};
  if (!log.is_open() || !log.Read(0, absl::MakeSpan(header))) return committed;
  const uint32_t magic = BigEndian32(header.data());
  if ((magic & ~1U) != kMagic || BigEndian32(&header[8]) != kPageBytes) return committed;
  uint32_t s0 = 0;
  uint32_t s1 = 0;
  const auto sum = [&](absl::Span<const uint8_t> bytes) {
    const auto word = (magic & 1U) != 0 ? &BigEndian32 : &LittleEndian32;
    for (size_t k = 0; k < bytes.size(); k += 8) {
      s0 += word(&bytes[k]) + s1;
      s1 += word(&bytes[k + 4]) + s0;
    }
  };
  const auto matches = [&](const uint8_t* at) {
    return BigEndian32(at) == s0 && BigEndian32(at + 4) == s1;
  };
  sum(absl::MakeSpan(header).subspan(0, 24));
  if (!matches(&header[24])) return committed;
  std::map<uint32_t, size_t> pages;  // of the transaction under way
  std::array<uint8_t, kFrameHeaderBytes + kPageBytes> frame{};
  for (size_t place = kHeaderBytes; log.Read(place, absl::MakeSpan(frame)); place += frame.size()) {
    sum(absl::MakeSpan(frame).subspan(0, 8));
    sum(absl::MakeSpan(frame).subspan(kFrameHeaderBytes));
    const bool is_of_this_log = std::equal(&frame[8], &frame[16], &header[16]);
    if (!is_of_this_log || !matches(&frame[16])) break;
    pages[BigEndian32(frame.data())] = place + kFrameHeaderBytes;
    if (BigEndian32(&frame[4]) == 0) continue;
    for (const auto& [page, at] : pages) committed[page] = at;
    pages.clear();
  }
  return committed;
}

// The pages of a database; they count from 1.
class Pages {
 public:
  explicit Pages(const std::string& path)
      : file_(path), log_(path + "-wal"), in_log_(PagesOfLog(log_)) {
    count_ = static_cast<uint32_t>((file_.Bytes() + kPageBytes - 1) / kPageBytes);
    if (!in_log_.empty()) count_ = std::max(count_, in_log_.rbegin()->first);
  }

  bool is_open() const { return file_.is_open(); }
  uint32_t count() const { return count_; }
  void Read(uint32_t number, Page& page) const {
    const auto found = in_log_.find(number);
    if (found != in_log_.end()) {
      log_.Read(found->second, absl::MakeSpan(page));
    } else {
      file_.Read((size_t{number} - 1) * kPageBytes, absl::MakeSpan(page));
    }
  }

 private:
  File file_;
  File log_;
  std::map<uint32_t, size_t> in_log_;
  uint32_t count_ = 0;
};

// Takes bytes from the front of what is left.
class Cursor {
 public:
  explicit Cursor(std::string_view bytes) : rest_(bytes) {}

  size_t size() const { return rest_.size(); }
  // Empty where the bytes end before.
  std::optional<uint64_t> Varint() {
    uint64_t value = 0;
    for (size_t k = 0; k < 9 && k < rest_.size(); ++k) {
      const auto byte = static_cast<uint8_t>(rest_[k]);
      value = k == 8 ? value << 8 | byte : value << 7 | (byte & 0x7fU);
      if (k < 8 && (byte & 0x80U) != 0) continue;
      rest_.remove_prefix(k + 1);
      return value;
    }
    return std::nullopt;
  }
  std::optional<std::string_view> Take(uint64_t bytes) {
    if (bytes > rest_.size()) return std::nullopt;
    const std::string_view taken = rest_.substr(0, bytes);
    rest_.remove_prefix(bytes);
    return taken;
  }

 private:
  std::string_view rest_;
};

// The column of a serial type, https://www.sqlite.org/fileformat2.html#record_format.
std::optional<PageColumn> ColumnOf(uint64_t type, Cursor& body) {
  constexpr std::array<uint64_t, 8> kIntegerBytes{0, 1, 2, 3, 4, 6, 8, 8};
  PageColumn column;
  if (type == 8 || type == 9) {
    column.integer = static_cast<int64_t>(type - 8);
    return column;
  }
  if (type == 10 || type == 11) return std::nullopt;  // not in files
  const auto bytes = body.Take(type < 8 ? kIntegerBytes[type] : (type - 12) / 2);
  if (!bytes) return std::nullopt;
  if (type >= 12) {
    column.bytes = *bytes;
    column.is_bytes = true;
    return column;
  }
  uint64_t value = !bytes->empty() && (bytes->front() & 0x80) != 0 ? ~uint64_t{0} : 0;
  for (const char byte : *bytes) value = value << 8 | static_cast<uint8_t>(byte);
  column.integer = static_cast<int64_t>(value);
  return column;
}

std::optional<std::vector<PageColumn>> ColumnsOf(std::string_view payload) {
  Cursor body(payload);
  const auto header_bytes = body.Varint();
  if (!header_bytes || *header_bytes > payload.size()) return std::nullopt;
  const size_t taken = payload.size() - body.size();
  if (*header_bytes < taken) return std::nullopt;
  Cursor types(*body.Take(*header_bytes - taken));
  std::vector<PageColumn> columns;
  while (types.size() > 0) {
    const auto type = types.Varint();
    if (!type || columns.size() == kMaxColumns) return std::nullopt;
    const auto column = ColumnOf(*type, body);
    if (!column) return std::nullopt;
    columns.push_back(*column);
  }
  return columns;
}

// What a cell holds, with the pages that it overflows to, which `overflow_left` counts down: of a
// sound file each page belongs to one cell.
std::optional<std::string> PayloadOf(const Pages& pages, uint64_t bytes, Cursor cell,
                                     size_t& overflow_left) {
  constexpr size_t kMaxLocal = kPageBytes - 35;
  constexpr size_t kMinLocal = (kPageBytes - 12) * 32 / 255 - 23;
  constexpr size_t kOverflowBytes = kPageBytes - 4;
  if (bytes > kMaxRowBytes) return std::nullopt;
  if (bytes <= kMaxLocal) {
    const auto local = cell.Take(bytes);
    if (!local) return std::nullopt;
    return std::string(*local);
  }
  const size_t surplus = kMinLocal + (bytes - kMinLocal) % kOverflowBytes;
  const auto local = cell.Take(surplus <= kMaxLocal ? surplus : kMinLocal);
  auto next = cell.Take(4);
  if (!local || !next) return std::nullopt;
  std::string payload(*local);
  Page page{};
  while (payload.size() < bytes) {
    const uint32_t number = BigEndian32(reinterpret_cast<const uint8_t*>(next->data()));
    if (number == 0 || number > pages.count() || overflow_left == 0) return std::nullopt;
    --overflow_left;
    pages.Read(number, page);
    const auto* begin = reinterpret_cast<const char*>(page.data());
    payload.append(begin + 4, std::min(bytes - payload.size(), uint64_t{kOverflowBytes}));
    next = std::string_view(begin, 4);
  }
  return payload;
}

}  // namespace

absl::Status ForEachRowOfPages(
    const std::string& path,
    absl::FunctionRef<void(int64_t rowid, absl::Span<const PageColumn> columns)> visit) {
  const Pages pages(path);
  if (!pages.is_open()) return NotFound("cannot read {}: {}", path, std::strerror(errno));
  size_t overflow_left = 2 * size_t{pages.count()};
  Page page{};
  for (uint32_t number = 1; number <= pages.count(); ++number) {
    pages.Read(number, page);
    const size_t header = number == 1 ? kFileHeaderBytes : 0;
    if (page[header] != kTableLeaf) continue;
    const std::string_view bytes(reinterpret_cast<const char*>(page.data()), page.size());
    const size_t cells = size_t{page[header + 3]} << 8 | page[header + 4];
    for (size_t k = 0; k < cells && header + 10 + 2 * k <= kPageBytes; ++k) {
      const size_t place = header + 8 + 2 * k;
      Cursor cell(bytes.substr(std::min(size_t{page[place]} << 8 | page[place + 1], kPageBytes)));
      const auto payload_bytes = cell.Varint();
      const auto rowid = cell.Varint();
      if (!payload_bytes || !rowid) continue;
      const auto payload = PayloadOf(pages, *payload_bytes, cell, overflow_left);
      if (!payload) continue;
      const auto columns = ColumnsOf(*payload);
      if (columns) visit(static_cast<int64_t>(*rowid), *columns);
    }
  }
  return absl::OkStatus();
}

absl::Status CheckpointPages(const std::string& path) {
  const File log(path + "-wal");
  const std::map<uint32_t, size_t> in_log = PagesOfLog(log);
  const int file = open(path.c_str(), O_WRONLY | O_CLOEXEC);
  if (file < 0) return Unavailable("cannot write {}: {}", path, std::strerror(errno));
  const absl::Cleanup close_file = [&] { close(file); };
  Page page{};
  for (const auto& [number, place] : in_log) {
    log.Read(place, absl::MakeSpan(page));
    const auto at = static_cast<off_t>((size_t{number} - 1) * kPageBytes);
    if (pwrite(file, page.data(), page.size(), at) != static_cast<ssize_t>(page.size())) {
      return Unavailable("cannot write {}: {}", path, std::strerror(errno));
    }
  }
  return SyncFile(path);
}

}  // namespace splinemap
