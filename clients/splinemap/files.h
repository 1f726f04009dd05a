#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace splinemap {

struct LayerSet;
struct LoadedMap;

// A file that a command writes.
struct Output {
  std::string path;
  bool force = false;  // whether it may replace a file
};

// Adds the file as the last positional of a command that has one input, and --force.
void AddOutput(CLI::App& command, const std::string& name, const std::string& what, Output& output);
// Adds -o,--out, for a command that takes a list of inputs, and --force.
CLI::Option* AddOutOption(CLI::App& command, const std::string& what, Output& output);
void AddForceFlag(CLI::App& command, bool& force);

// Whether a command that reads `inputs` may write `output`: its folder exists, and so does the file
// only with `force`. It is none of the inputs.
absl::Status CheckOutput(const Output& output, const std::vector<std::string>& inputs);
// The same for a map file, which no daemon may have open.
absl::Status CheckMapOutput(const Output& output, const std::vector<std::string>& inputs);

// Writes the map file, whole or not at all; not at all where a layer of it cannot be true.
absl::Status SaveAs(const LayerSet& set, const std::string& path);

// Adds --accept-corrupt, for commands that make a map file of others.
void AddCorruptFlag(CLI::App& command, bool& accepts_corrupt);
// Prints what is corrupt in an input, on stderr. DataLoss where there is any, unless accepted.
absl::Status CheckInput(const LoadedMap& loaded, const std::string& path, bool accepts_corrupt);
// Reads and checks an input.
absl::StatusOr<LoadedMap> ReadInput(const std::string& path, bool accepts_corrupt);

// Prints what is corrupt, on stderr. Returns the exit status of a command that else succeeded.
int ReportCorruption(const LoadedMap& loaded);

}  // namespace splinemap
