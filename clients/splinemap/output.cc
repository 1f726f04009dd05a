#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "absl/cleanup/cleanup.h"
#include "clients/splinemap/commands.h"
#include "clients/splinemap/say.h"
#include "lib/base/file.h"
#include "lib/base/status.h"

namespace splinemap {

absl::Status CheckOutput(const std::string& path, bool force) {
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
    return InvalidArgument("cannot write {}: it is no ordinary file", path);
  }
  if (!force) return InvalidArgument("{} exists; --force replaces it", path);
  return absl::OkStatus();
}

void AddMapOutputFlags(CLI::App& command, MapOutput& output) {
  command.add_option("-o,--out", output.out, "Map file to write")->required()->type_name("MAP");
  command.add_flag("--force", output.force, "Replace the map file if it exists");
  command.add_flag("--damaged", output.accepts_damaged,
                   "Take what is left of damaged files; exit status 1 all the same");
}

absl::Status CheckOutputOf(const std::vector<std::string>& inputs, const MapOutput& output) {
  for (const std::string& input : inputs) {
    std::error_code none_there;
    if (std::filesystem::equivalent(input, output.out, none_there)) {
      return InvalidArgument("{} is read and cannot be written; give another file", output.out);
    }
  }
  SPLINEMAP_RETURN_IF_ERROR(CheckOutput(output.out, output.force));
  return MapFile::CheckNotInUse(output.out);
}

absl::Status CheckInput(const LoadedMap& loaded, const std::string& path, const MapOutput& output) {
  if (ReportCorruption(loaded) == kSuccess || output.accepts_damaged) return absl::OkStatus();
  return DataLoss("{} is damaged, so that nothing is written; --damaged takes what is left of it",
                  path);
}

absl::StatusOr<LoadedMap> ReadInput(const std::string& path, const MapOutput& output) {
  SPLINEMAP_ASSIGN_OR_RETURN(LoadedMap loaded, ReadMapFile(path));
  SPLINEMAP_RETURN_IF_ERROR(CheckInput(loaded, path, output));
  return loaded;
}

absl::Status SaveAs(const LayerSet& set, const std::string& out) {
  const std::string part = TemporaryPathFor(out);
  const absl::Cleanup remove_part = [&] { MapFile::Remove(part); };
  {
    SPLINEMAP_ASSIGN_OR_RETURN(MapFile file, MapFile::Open(part));
    SPLINEMAP_ASSIGN_OR_RETURN(const std::vector<std::string> left_out, file.Save(set));
    if (!left_out.empty()) {
      return InvalidArgument("{} is not written: it would be without {}", out, left_out.front());
    }
    SPLINEMAP_RETURN_IF_ERROR(file.Close());
  }
  return MapFile::Rename(part, out);
}

int ReportCorruption(const LoadedMap& loaded) {
  constexpr size_t kMaxLines = 20;
  const size_t count = loaded.corruption.size();
  for (size_t k = 0; k < std::min(count, kMaxLines); ++k) {
    Say(stderr, "{}", loaded.corruption[k]);
  }
  if (count > kMaxLines) Say(stderr, "and {} more", count - kMaxLines);
  return count == 0 ? kSuccess : kFailed;
}

}  // namespace splinemap
