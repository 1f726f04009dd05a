#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "absl/types/span.h"

// What every target defines: runs one input. What it must not do: crash, hang, fail a Require().
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

namespace splinemap {

// Ends the process with `what` where the condition does not hold.
void Require(bool condition, const char* what);

// Takes values off the input of a target; zeros after its end.
class FuzzInput {
 public:
  FuzzInput(const uint8_t* data, size_t size) : rest_(data, size) {}

  bool empty() const { return rest_.empty(); }

  // At most `size` bytes.
  absl::Span<const uint8_t> Bytes(size_t size) {
    const absl::Span<const uint8_t> bytes = rest_.subspan(0, size);
    rest_.remove_prefix(bytes.size());
    return bytes;
  }
  absl::Span<const uint8_t> Rest() { return Bytes(rest_.size()); }
  std::string Text(size_t size) {
    const absl::Span<const uint8_t> bytes = Bytes(size);
    return {bytes.begin(), bytes.end()};
  }

  // A number or a plain struct, byte by byte, whatever that makes it.
  template <typename Value>
  Value Take() {
    Value value{};
    const absl::Span<const uint8_t> bytes = Bytes(sizeof value);
    if (!bytes.empty()) std::memcpy(&value, bytes.data(), bytes.size());
    return value;
  }
  uint8_t Byte() { return Take<uint8_t>(); }

 private:
  absl::Span<const uint8_t> rest_;
};

// A file that is in memory and has a path.
class MemoryFile {
 public:
  MemoryFile();
  ~MemoryFile();
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;

  void Set(absl::Span<const uint8_t> content);
  const std::string& path() const { return path_; }

 private:
  int descriptor_;
  std::string path_;
};

}  // namespace splinemap
