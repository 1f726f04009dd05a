#include "lib/fleet/fleet_file.h"

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <memory>
#include <set>
#include <vector>

#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet.pb.h"
#include "lib/fleet/fleet_key.h"

namespace splinemap {
namespace {

constexpr size_t kChunkBytes = size_t{128} << 10;
constexpr int kMaxChunks = 65'536;

std::string HashOfChunk(const std::string& chunk) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(chunk.data(), chunk.size()));
  return {reinterpret_cast<const char*>(canonical.digest), sizeof canonical.digest};
}

std::string ChunkPrefix(const LayerId& id) {
  return fmt::format("layers.{}.{:016x}.chunk.", TokenOf(id.name), id.origin);
}

std::string ChunkKey(const LayerId& id, const std::string& hash) {
  std::string key = ChunkPrefix(id);
  for (const char byte : hash) key += fmt::format("{:02x}", static_cast<unsigned char>(byte));
  return key;
}

uint64_t HashOfValue(const std::string& value) {
  return std::max<uint64_t>(XXH3_64bits(value.data(), value.size()), 1);
}

// Calls `handle` for each chunk.
absl::Status ReadChunks(const std::string& path,
                        absl::FunctionRef<absl::Status(const std::string& chunk)> handle) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "rbe"),
                                                             std::fclose);
  if (!file) return NotFound("{} cannot be read", path);
  std::string chunk(kChunkBytes, '\0');
  while (true) {
    chunk.resize(kChunkBytes);
    chunk.resize(std::fread(chunk.data(), 1, kChunkBytes, file.get()));
    if (std::ferror(file.get()) != 0) return Unavailable("{} cannot be read", path);
    if (chunk.empty()) return absl::OkStatus();
    SPLINEMAP_RETURN_IF_ERROR(handle(chunk));
  }
}

absl::StatusOr<fleet::FileRecord> ReadRecord(FleetStore& files, const LayerId& id) {
  SPLINEMAP_ASSIGN_OR_RETURN(const FleetEntry entry, files.Get(FileKey(id)));
  if (entry.value.empty()) {
    return absl::OutOfRangeError(fmt::format("there is no map file of {}", id.name));
  }
  fleet::FileRecord record;
  const bool is_record = record.ParseFromString(entry.value) &&
                         HashOfValue(entry.value) == entry.hash &&
                         record.layer().name() == id.name && record.layer().origin() == id.origin;
  if (!is_record || record.chunk_size() > kMaxChunks) {
    return DataLoss("the record of the map file of {} is damaged", id.name);
  }
  return record;
}

}  // namespace

std::string FileKey(const LayerId& id) {
  return fmt::format("layers.{}.{:016x}.file", TokenOf(id.name), id.origin);
}

absl::Status FleetFileUpload::Bring(const std::string& path, int64_t utime, FilePace pace) {
  if (!there_) SPLINEMAP_RETURN_IF_ERROR(List());
  absl::Status status = BringChunks(path, utime, pace);
  // Nobody knows what became of a write that failed; and what is there may be forgotten.
  if (!absl::IsCancelled(status)) there_.reset();
  return status;
}

absl::Status FleetFileUpload::List() {
  std::set<std::string> there;
  SPLINEMAP_RETURN_IF_ERROR(
      files_.List(ChunkPrefix(id_) + ">", /*with_values=*/false, [&](const FleetEntry& entry) {
        if (entry.hash != 0) there.insert(entry.key);
      }));
  there_ = std::move(there);
  return absl::OkStatus();
}

absl::Status FleetFileUpload::BringChunks(const std::string& path, int64_t utime, FilePace pace) {
  fleet::FileRecord record;
  record.mutable_layer()->set_name(id_.name);
  record.mutable_layer()->set_origin(id_.origin);
  record.set_utime(utime);
  const absl::Status brought = ReadChunks(path, [&](const std::string& chunk) -> absl::Status {
    if (record.chunk_size() >= kMaxChunks) {
      return InvalidArgument("{} is larger than {} MB", path, kMaxChunks * kChunkBytes >> 20);
    }
    const std::string hash = HashOfChunk(chunk);
    record.add_chunk(hash);
    record.set_bytes(record.bytes() + chunk.size());
    const std::string key = ChunkKey(id_, hash);
    if (there_->contains(key)) return absl::OkStatus();
    if (!pace(static_cast<int64_t>(chunk.size()))) return absl::CancelledError("it was ended");
    SPLINEMAP_RETURN_IF_ERROR(files_.Put({{key, chunk, HashOfValue(chunk)}}));
    there_->insert(key);
    return absl::OkStatus();
  });
  SPLINEMAP_RETURN_IF_ERROR(brought);
  const std::string value = record.SerializeAsString();
  SPLINEMAP_RETURN_IF_ERROR(files_.Put({{FileKey(id_), value, HashOfValue(value)}}));
  for (const std::string& hash : record.chunk()) there_->erase(ChunkKey(id_, hash));
  std::vector<FleetEntry> unused;
  for (const std::string& key : *there_) unused.push_back({key, "", 0});
  return files_.Put(unused);
}

absl::StatusOr<FleetFile> FindFleetFile(FleetStore& files, const LayerId& id) {
  SPLINEMAP_ASSIGN_OR_RETURN(const fleet::FileRecord record, ReadRecord(files, id));
  return FleetFile{record.utime(), static_cast<int64_t>(record.bytes())};
}

absl::Status GetFleetFile(FleetStore& files, const LayerId& id, const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const fleet::FileRecord record, ReadRecord(files, id));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
  for (const std::string& hash : record.chunk()) {
    const absl::StatusOr<FleetEntry> entry = files.Get(ChunkKey(id, hash));
    if (!entry.ok() && !absl::IsOutOfRange(entry.status())) return entry.status();
    if (!entry.ok() || HashOfChunk(entry->value) != hash) {
      return DataLoss("a part of the map file of {} is damaged or gone; the robot brings it again",
                      id.name);
    }
    SPLINEMAP_RETURN_IF_ERROR(file.Write(entry->value));
  }
  return file.Commit();
}

}  // namespace splinemap
