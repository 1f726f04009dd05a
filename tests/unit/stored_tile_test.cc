#include "splinemap/stored_tile.h"

#include <gtest/gtest.h>

#include <atomic>
#include <map>
#include <memory>
#include <thread>
#include <vector>

#include "lib/base/mutex.h"
#include "lib/base/read_section.h"
#include "lib/tiles/tile_codec.h"
#include "lib/tiles/tile_memory.h"
#include "splinemap/tile_tree.h"

namespace splinemap::stored_tile_test {

Tile TileOf(int value) {
  Tile tile;
  tile.control_points.fill(static_cast<ControlPoint>(value));
  return tile;
}

// Has the tile n of TileOf(n).
class Numbers : public TileSource {
 public:
  using TileSource::TileSource;

  std::shared_ptr<const Tile> Load(int64_t number, uint64_t /*checksum*/) override {
    ++loads;
    if (is_broken) return nullptr;
    return std::make_shared<const Tile>(TileOf(static_cast<int>(number)));
  }
  void Forget(int64_t number) override {
    MutexLock lock(mutex);
    forgotten.push_back(number);
  }

  std::atomic<int> loads = 0;
  std::atomic<bool> is_broken = false;
  Mutex mutex;
  std::vector<int64_t> forgotten;
};

class StoredTileTest : public testing::Test {
 protected:
  std::shared_ptr<const StoredTile> At(int64_t number) {
    return std::make_shared<const StoredTile>(source_, number);
  }

  const std::shared_ptr<TileMemory> memory_ = std::make_shared<TileMemory>(10);
  const std::shared_ptr<Numbers> source_ = std::make_shared<Numbers>(memory_);
};

TEST_F(StoredTileTest, ComesWhenItIsAskedForAndGoesWhenOthersAreUsed) {
  std::vector<std::shared_ptr<const StoredTile>> tiles;
  for (int n = 1; n <= 100; ++n) tiles.push_back(At(n));
  EXPECT_EQ(source_->loads, 0);
  for (int round = 0; round < 3; ++round) {
    for (int n = 1; n <= 100; ++n) {
      EXPECT_EQ(*tiles[n - 1]->Get(), TileOf(n));
      EXPECT_LE(memory_->num_tiles(), 10u);
    }
  }
  EXPECT_EQ(source_->loads, 300);
}

TEST_F(StoredTileTest, WhatIsUsedStays) {
  std::vector<std::shared_ptr<const StoredTile>> tiles;
  for (int n = 1; n <= 100; ++n) tiles.push_back(At(n));
  for (int n = 2; n <= 100; ++n) {
    tiles[0]->Get();
    tiles[n - 1]->Get();
  }
  EXPECT_EQ(source_->loads, 100);
}

TEST_F(StoredTileTest, WhoHasTheContentKeepsIt) {
  const auto tile = At(7);
  const std::shared_ptr<const Tile> content = tile->Get();
  for (int n = 100; n < 200; ++n) At(n)->Get();
  EXPECT_EQ(*content, TileOf(7));
}

TEST_F(StoredTileTest, KnowsItsSumsWithoutItsContent) {
  const StoredTile known(source_, 3, 42, TouchedPoints{.points = 1, .i0 = 5, .i1 = 31});
  EXPECT_EQ(known.Checksum({0, 0}), 42u);
  EXPECT_EQ(known.Touched().i1, 31);
  EXPECT_EQ(source_->loads, 0);
  const StoredTile unknown(source_, 3);
  EXPECT_EQ(unknown.Checksum({4, 5}), TileChecksum({4, 5}, TileOf(3)));
  EXPECT_EQ(unknown.Touched(), TouchedPointsOf(TileOf(3)));
}

TEST_F(StoredTileTest, AnEditIsOfACopyThatStaysInMemory) {
  TileTreeEditor editor;
  editor.Put({0, 0}, At(5), 1);
  const TileTree before = editor.Freeze();
  editor.Edit({0, 0}, 2).Edit().control_points[0] = 1;
  for (int n = 100; n < 200; ++n) At(n)->Get();
  EXPECT_EQ(*before.Find({0, 0})->Get(), TileOf(5));
  EXPECT_EQ(editor.tree().Find({0, 0})->Get()->control_points[0], 1);
  EXPECT_EQ(editor.tree().Find({0, 0})->Get()->control_points[1], 5);
  EXPECT_EQ(editor.tree().Find({0, 0})->NumberAt(source_.get()), 0);
}

TEST_F(StoredTileTest, ANumberIsForgottenWithItsTile) {
  {
    const auto tile = std::make_shared<const StoredTile>(TileOf(9));
    tile->SetSource(source_, 9);
    EXPECT_EQ(tile->NumberAt(source_.get()), 9);
    for (int n = 100; n < 120; ++n) At(n)->Get();
    EXPECT_EQ(*tile->Get(), TileOf(9));
    source_->forgotten.clear();
    const auto elsewhere = std::make_shared<Numbers>(memory_);
    tile->SetSource(elsewhere, 9);
    EXPECT_EQ(source_->forgotten, std::vector<int64_t>{9});
    EXPECT_EQ(tile->NumberAt(source_.get()), 0);
    EXPECT_TRUE(elsewhere->forgotten.empty());
  }
  EXPECT_EQ(memory_->num_tiles(), 0u);
}

TEST_F(StoredTileTest, WhatCannotBeReadIsReadWhenItCan) {
  const auto tile = At(7);
  source_->is_broken = true;
  EXPECT_EQ(tile->TryGet(), nullptr);
  EXPECT_EQ(*tile->Get(), Tile());
  source_->is_broken = false;
  EXPECT_EQ(*tile->Get(), TileOf(7));
}

TEST_F(StoredTileTest, WhatIsInMemoryStaysWhereThereIsRoom) {
  const auto large = std::make_shared<TileMemory>(100'000);
  const auto source = std::make_shared<Numbers>(large);
  std::vector<std::shared_ptr<const StoredTile>> tiles;
  for (int n = 0; n < 3000; ++n) {
    tiles.push_back(std::make_shared<const StoredTile>(source, n));
    tiles.back()->Get();
  }
  for (int n = 0; n < 20'000; ++n) {  // they come and go
    std::make_shared<const StoredTile>(TileOf(n))->SetSource(source, n);
  }
  EXPECT_EQ(large->num_tiles(), 3000u);
}

TEST_F(StoredTileTest, OnlyTheFirstOfTwoSourcesIsTaken) {
  const auto tile = std::make_shared<const StoredTile>(TileOf(1));
  EXPECT_TRUE(tile->SetFirstSource(source_, 1));
  EXPECT_FALSE(tile->SetFirstSource(std::make_shared<Numbers>(memory_), 5));
  EXPECT_EQ(tile->NumberAt(source_.get()), 1);
}

TEST_F(StoredTileTest, ManyThreadsSeeTheSameTiles) {
  std::vector<std::shared_ptr<const StoredTile>> tiles;
  for (int n = 0; n < 50; ++n) tiles.push_back(At(n));
  std::vector<std::jthread> threads;
  for (int thread = 0; thread < 4; ++thread) {
    threads.emplace_back([&tiles, thread] {
      for (int k = 0; k < 5'000; ++k) {
        const int n = (k * (2 * thread + 1)) % 50;
        ASSERT_EQ(tiles[n]->Get()->control_points[k % Tile::kSize], n);
      }
    });
  }
  threads.clear();
  EXPECT_LE(memory_->num_tiles(), 10u);
  tiles.clear();
  EXPECT_EQ(memory_->num_tiles(), 0u);
}

TEST_F(StoredTileTest, WhatASectionReadsStaysWhileOthersTakeItsPlace) {
  const auto tile = At(7);
  const ReadSection section;
  const Tile& content = tile->Read(section);
  std::vector<std::shared_ptr<const StoredTile>> others;
  for (int n = 100; n < 400; ++n) {  // so many that what is retired is let go, but for the section
    others.push_back(At(n));
    others.back()->Read(section);
  }
  EXPECT_EQ(source_->loads, 301);
  EXPECT_EQ(content, TileOf(7));
  EXPECT_EQ(tile->Read(section), TileOf(7));
  EXPECT_EQ(source_->loads, 302) << "it had left";
}

TEST_F(StoredTileTest, WhatSectionsReadIsUsed) {
  std::vector<std::shared_ptr<const StoredTile>> tiles;
  for (int n = 1; n <= 100; ++n) tiles.push_back(At(n));
  const ReadSection section;
  for (int n = 2; n <= 100; ++n) {
    tiles[0]->Read(section);
    tiles[n - 1]->Read(section);
  }
  EXPECT_EQ(source_->loads, 100);
}

TEST_F(StoredTileTest, ManyThreadsReadWhatOthersDriveOut) {
  std::vector<std::shared_ptr<const StoredTile>> tiles;
  for (int n = 0; n < 50; ++n) tiles.push_back(At(n));
  std::vector<std::jthread> threads;
  for (int thread = 0; thread < 4; ++thread) {
    threads.emplace_back([&tiles, thread] {
      for (int k = 0; k < 2'000; ++k) {
        const ReadSection section;
        const int n = (k * (2 * thread + 1)) % 50;
        const int m = (n + 25) % 50;
        const Tile& first = tiles[n]->Read(section);
        const Tile& second = tiles[m]->Read(section);
        ASSERT_EQ(first.control_points[k % Tile::kSize], n);
        ASSERT_EQ(second.control_points[k % Tile::kSize], m);
      }
    });
  }
  threads.clear();
  EXPECT_LE(memory_->num_tiles(), 10u);
}

}  // namespace splinemap::stored_tile_test
