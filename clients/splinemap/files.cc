#include "clients/splinemap/files.h"

#include <unistd.h>

#include <CLI/App.hpp>
#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "absl/cleanup/cleanup.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/print.h"
#include "lib/base/file.h"
#include "lib/base/status.h"
#include "splinemap/file.h"

namespace splinemap {

void AddForceFlag(CLI::App& command, bool& force) {
  command.add_flag("--force", force, "Replace a file that exists");
}

void AddOutput(CLI::App& command, const std::string& name, const std::string& what,
               Output& output) {
  command.add_option(name, output.path, what)->required();
  AddForceFlag(command, output.force);
}

CLI::Option* AddOutOption(CLI::App& command, const std::string& what, Output& output) {
  AddForceFlag(command, output.force);
  return command.add_option("-o,--out", output.path, what)->type_name("OUT");
}

absl::Status CheckOutput(const Output& output, const std::vector<std::string>& inputs) {
  const std::string& path = output.path;
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::absolute(path, error).parent_path();
  if (!std::filesystem::is_directory(folder, error)) {
    return InvalidArgument("cannot write {}: there is no folder {}", path, folder.string());
  }
  if (access(folder.c_str(), W_OK) != 0) {
    return Unavailable("cannot write {}: {}", path, std::strerror(errno));
  }
  if (!std::filesystem::exists(path, error)) return absl::OkStatus();
  if (!std::filesystem::is_regular_file(path, error)) {
    return InvalidArgument("cannot write {}: it is not a regular file", path);
  }
  for (const std::string& input : inputs) {
    if (std::filesystem::equivalent(input, path, error)) {
      return InvalidArgument("cannot write {}: the command reads it", path);
    }
  }
  if (!output.force) return InvalidArgument("{} exists; --force replaces it", path);
  return absl::OkStatus();
}

absl::Status CheckMapOutput(const Output& output, const std::vector<std::string>& inputs) {
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(output, inputs));
  return MapFile::CheckNotInUse(output.path);
}

absl::Status SaveAs(const LayerSet& set, const std::string& path) {
  const std::string part = TemporaryPathFor(path);
  const absl::Cleanup remove_part = [&] { MapFile::Remove(part); };
  SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<std::string> left_out, MapFile::WriteNew(part, set));
  if (!left_out.empty()) {
    return InvalidArgument("{} is not written, it would lack {}", path, left_out.front());
  }
  return MapFile::Rename(part, path);
}

void AddCorruptFlag(CLI::App& command, bool& accepts_corrupt) {
  command.add_flag("--accept-corrupt", accepts_corrupt,
                   "Use what can be read of corrupt files; the exit status is 1 all the same");
}

absl::Status CheckInput(const LoadedMap& loaded, const std::string& path, bool accepts_corrupt) {
  if (ReportCorruption(loaded) == kSuccess || accepts_corrupt) return absl::OkStatus();
  return DataLoss("{} is corrupt; nothing is written. --accept-corrupt uses what can be read of it",
                  path);
}

absl::StatusOr<LoadedMap> ReadInput(const std::string& path, bool accepts_corrupt) {
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadMapFile(path));
  SPLINEMAP_RETURN_IF_ERROR(CheckInput(loaded, path, accepts_corrupt));
  return loaded;
}

int ReportCorruption(const LoadedMap& loaded) {
  constexpr size_t kMaxLines = 20;
  const size_t count = loaded.corruption.size();
  for (size_t k = 0; k < std::min(count, kMaxLines); ++k) {
    PrintLine(stderr, "{}", loaded.corruption[k]);
  }
  if (count > kMaxLines) PrintLine(stderr, "and {} more", count - kMaxLines);
  return count == 0 ? kSuccess : kFailed;
}

}  // namespace splinemap
