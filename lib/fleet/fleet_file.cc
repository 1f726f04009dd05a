#include "lib/fleet/fleet_file.h"

#include <xxhash.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <vector>

#include "lib/base/file.h"
#include "lib/base/status.h"
#include "lib/fleet/fleet.pb.h"
#include "lib/fleet/fleet_key.h"

namespace splinemap {
namespace {

constexpr size_t kChunkBytes = size_t{128} << 10;
constexpr size_t kMaxChunks = 45'000;

std::string HashOfChunk(const std::string& chunk) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(chunk.data(), chunk.size()));
  return {reinterpret_cast<const char*>(canonical.digest), sizeof canonical.digest};
}

std::string KeyPrefix(const LayerId& id) {
  const std::string filter = LayerFilter(id);
  return filter.substr(0, filter.size() - 1);
}

std::string ChunkKey(const LayerId& id, size_t number, char slot) {
  return fmt::format("{}chunk.{}.{}", KeyPrefix(id), number, static_cast<int>(slot));
}

uint64_t HashOfValue(const std::string& value) {
  return std::max<uint64_t>(XXH3_64bits(value.data(), value.size()), 1);
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
  if (!is_record || static_cast<size_t>(record.chunk_size()) > kMaxChunks ||
      record.slots().size() != static_cast<size_t>(record.chunk_size())) {
    return DataLoss("the record of the map file of {} is damaged", id.name);
  }
  return record;
}

}  // namespace

std::string FileKey(const LayerId& id) { return KeyPrefix(id) + "file"; }

FleetFileUpload::FleetFileUpload(FleetStore& files, LayerId id, std::string path, int64_t utime)
    : files_(files), id_(std::move(id)), path_(std::move(path)), utime_(utime) {}

absl::Status FleetFileUpload::Begin() {
  there_.clear();
  SPLINEMAP_RETURN_IF_ERROR(
      files_.List(KeyPrefix(id_) + "chunk.>", /*with_values=*/false,
                  [&](const FleetEntry& entry) { there_[entry.key] = entry.hash; }));
  const absl::StatusOr<fleet::FileRecord> record = ReadRecord(files_, id_);
  // One that is damaged is replaced.
  if (absl::IsUnavailable(record.status())) return record.status();
  slots_there_ = record.ok() ? record->slots() : "";
  has_begun_ = true;
  return absl::OkStatus();
}

absl::Status FleetFileUpload::Bring(Pace pace) {
  if (!has_begun_) SPLINEMAP_RETURN_IF_ERROR(Begin());
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path_.c_str(), "rbe"),
                                                             std::fclose);
  if (!file || std::fseek(file.get(), static_cast<long>(bytes_), SEEK_SET) != 0) {
    return NotFound("{} cannot be read", path_);
  }
  std::string chunk;
  while (true) {
    chunk.resize(kChunkBytes);
    chunk.resize(std::fread(chunk.data(), 1, kChunkBytes, file.get()));
    if (std::ferror(file.get()) != 0) return NotFound("{} cannot be read", path_);
    if (chunk.empty()) break;
    SPLINEMAP_RETURN_IF_ERROR(BringChunk(chunk, pace));
  }
  fleet::FileRecord record;
  record.mutable_layer()->set_name(id_.name);
  record.mutable_layer()->set_origin(id_.origin);
  record.set_utime(utime_);
  record.set_bytes(bytes_);
  for (const std::string& hash : chunks_) record.add_chunk(hash);
  record.set_slots(slots_);
  const std::string value = record.SerializeAsString();
  SPLINEMAP_RETURN_IF_ERROR(files_.Put({{FileKey(id_), value, HashOfValue(value)}}));
  // Of a longer file before.
  for (size_t number = chunks_.size(); number < slots_there_.size(); ++number) {
    for (const char slot : {'\0', '\1'}) {
      const std::string key = ChunkKey(id_, number, slot);
      if (there_.contains(key)) SPLINEMAP_RETURN_IF_ERROR(files_.Put({{key, "", 0}}));
    }
  }
  return absl::OkStatus();
}

absl::Status FleetFileUpload::BringChunk(const std::string& chunk, Pace pace) {
  const size_t number = chunks_.size();
  if (number >= kMaxChunks) {
    return InvalidArgument("{} is larger than {} MB", path_, kMaxChunks * kChunkBytes >> 20);
  }
  const uint64_t hash = HashOfValue(chunk);
  const char present = number < slots_there_.size() && slots_there_[number] == 0 ? 0 : 1;
  const auto has = [&](char slot) {
    const auto there = there_.find(ChunkKey(id_, number, slot));
    return there != there_.end() && there->second == hash;
  };
  const char slot = has(present) ? present : static_cast<char>(1 - present);
  const int64_t bytes = has(slot) ? 0 : static_cast<int64_t>(chunk.size());
  if (!pace(bytes)) return absl::CancelledError("it was ended");
  if (bytes > 0) {
    SPLINEMAP_RETURN_IF_ERROR(files_.Put({{ChunkKey(id_, number, slot), chunk, hash}}));
  }
  chunks_.push_back(HashOfChunk(chunk));
  slots_ += slot;
  bytes_ += chunk.size();
  return absl::OkStatus();
}

absl::StatusOr<FleetFile> FindFleetFile(FleetStore& files, const LayerId& id) {
  SPLINEMAP_ASSIGN_OR_RETURN(const fleet::FileRecord record, ReadRecord(files, id));
  return FleetFile{record.utime(), static_cast<int64_t>(record.bytes())};
}

absl::Status GetFleetFile(FleetStore& files, const LayerId& id, const std::string& path) {
  SPLINEMAP_ASSIGN_OR_RETURN(const fleet::FileRecord record, ReadRecord(files, id));
  SPLINEMAP_ASSIGN_OR_RETURN(NewFile file, NewFile::Create(path));
  for (int k = 0; k < record.chunk_size(); ++k) {
    const size_t number = static_cast<size_t>(k);
    const absl::StatusOr<FleetEntry> entry =
        files.Get(ChunkKey(id, number, record.slots()[number]));
    if (!entry.ok() && !absl::IsOutOfRange(entry.status())) return entry.status();
    if (!entry.ok() || HashOfChunk(entry->value) != record.chunk(k)) {
      return DataLoss("a part of the map file of {} is damaged or gone; the robot brings it again",
                      id.name);
    }
    SPLINEMAP_RETURN_IF_ERROR(file.Write(entry->value));
  }
  return file.Commit();
}

}  // namespace splinemap
