#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "splinemap/utime.h"

namespace splinemap {

// One message of an LCM log. Views are valid during the visit.
struct LogEvent {
  Utime utime{0};  // when the logger heard it
  std::string channel;
  absl::Span<const uint8_t> message;
};

// Visits the events of a log, plain or gzip, in the order of the file. Where the log is damaged it
// goes on at the next event that can be read. `progress` is called now and then with the share of
// the file that was read, 0 .. 1. Errors, after all that could be read was visited: DataLoss with
// what was skipped and where, or that the log ends within an event; InvalidArgument for a file that
// has no event.
absl::Status ReadLcmLog(const std::string& path, absl::FunctionRef<void(const LogEvent&)> visit,
                        absl::FunctionRef<void(double)> progress);

// The same for messages of `channels` alone, in the order of `time_of`, where a channel comes late
// in the file: each channel keeps the order of the file, and the one goes on whose next message is
// the earliest. Reads the file once for each channel, in little memory.
absl::Status ReadLcmLogInOrder(const std::string& path, const std::vector<std::string>& channels,
                               absl::FunctionRef<Utime(const LogEvent&)> time_of,
                               absl::FunctionRef<void(const LogEvent&)> visit,
                               absl::FunctionRef<void(double)> progress);

// Writes an LCM log, which gets its name when it is closed: a log that is cut short by a failure is
// removed, and an older one stays. Thread-compatible.
class LcmLogWriter {
 public:
  // Unavailable where the file cannot be written.
  static absl::StatusOr<LcmLogWriter> Create(const std::string& path);

  LcmLogWriter(LcmLogWriter&&) noexcept;
  LcmLogWriter& operator=(LcmLogWriter&&) noexcept;
  ~LcmLogWriter();

  template <typename Message>
  absl::Status Write(Utime utime, const std::string& channel, const Message& message) {
    std::vector<uint8_t> bytes(message.getEncodedSize());
    message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
    return WriteBytes(utime, channel, bytes);
  }
  absl::Status WriteBytes(Utime utime, const std::string& channel, std::vector<uint8_t>& message);

  // Closes the file, which replaces an older one; every later call fails. Says whether all of it
  // reached the system.
  absl::Status Close();

 private:
  struct Impl;
  explicit LcmLogWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace splinemap
