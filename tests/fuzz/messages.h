#pragma once

#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/types/span.h"
#include "splinemap/utime.h"
#include "tests/fuzz/fuzz.h"

namespace splinemap {

// The message of a type, by its hash, whose fields are these bytes.
std::vector<uint8_t> MessageOf(int64_t hash, absl::Span<const uint8_t> fields);

// Takes a step of message time: mostly some multiple of 10 ms, and rarely any time at all, which
// `clock` does not keep.
Utime ReadUtime(FuzzInput& input, Utime& clock);

using MessageSink =
    absl::FunctionRef<void(const std::string& channel, absl::Span<const uint8_t> message)>;

// A message for one of the channels: a valid one, one with raw fields, a damaged one or raw bytes.
void ReadMessage(FuzzInput& input, absl::Span<const std::string> channels, Utime& clock,
                 MessageSink sink);

// Some seconds of a drive in a room: scans for a channel that the input chooses, poses for the
// first one. Enough to search for flags, which takes the time of a hundred other messages.
void ReadDrive(FuzzInput& input, absl::Span<const std::string> channels, Utime& clock,
               MessageSink sink);

}  // namespace splinemap
