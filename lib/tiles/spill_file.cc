#include "lib/tiles/spill_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "lib/base/status.h"

namespace splinemap {

absl::StatusOr<std::shared_ptr<SpillFile>> SpillFile::Make(const std::string& folder,
                                                           std::shared_ptr<TileMemory> memory) {
  std::string name = folder + "/.splinemap-spill-XXXXXX";
  const int descriptor = mkostemp(name.data(), O_CLOEXEC);
  if (descriptor < 0) return Unavailable("cannot write to {}: {}", folder, std::strerror(errno));
  unlink(name.c_str());
  return std::shared_ptr<SpillFile>(new SpillFile(descriptor, std::move(memory)));
}

SpillFile::~SpillFile() { close(descriptor_); }

void SpillFile::Take(const std::shared_ptr<SpillFile>& file, const TileTree& tiles,
                     uint64_t since) {
  tiles.ForEachChanged(since, [&](TileKey key, const TileTree::Entry& entry) {
    if (entry.tile->HasSource()) return;
    entry.tile->Checksum(key);  // which is asked for when it is gone
    int64_t number = 0;
    {
      MutexLock lock(file->mutex_);
      if (file->free_.empty()) file->free_.push_back(++file->slots_);
      number = file->free_.back();
      file->free_.pop_back();
    }
    const std::shared_ptr<const Tile> tile = entry.tile->Get();
    const ssize_t written = pwrite(file->descriptor_, tile.get(), sizeof(Tile),
                                   (number - 1) * static_cast<off_t>(sizeof(Tile)));
    const bool is_taken =
        written == static_cast<ssize_t>(sizeof(Tile)) && entry.tile->SetFirstSource(file, number);
    if (!is_taken) file->Forget(number);
  });
}

std::shared_ptr<const Tile> SpillFile::Load(int64_t number, uint64_t /*checksum*/) {
  auto tile = std::make_shared<Tile>();
  const ssize_t read =
      pread(descriptor_, tile.get(), sizeof(Tile), (number - 1) * static_cast<off_t>(sizeof(Tile)));
  if (read == static_cast<ssize_t>(sizeof(Tile))) return tile;
  has_lost_tiles_ = true;
  return nullptr;
}

void SpillFile::Forget(int64_t number) {
  MutexLock lock(mutex_);
  free_.push_back(number);
}

}  // namespace splinemap
