#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

#include "absl/types/span.h"

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
  std::string RestText() { return Text(rest_.size()); }

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

// Runs one input. What it must not do: crash, hang, fail a Require().
using FuzzRun = void (*)(FuzzInput input);

// Adds a target to the program that its file is linked into, as a constant of that file.
struct FuzzTarget {
  FuzzTarget(const std::string& name, FuzzRun run);
};

// Ends the process where the program has no such target.
FuzzRun FindFuzzTarget(const std::string& name);

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
