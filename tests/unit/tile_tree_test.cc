#include "splinemap/tile_tree.h"

#include <gtest/gtest.h>

#include <map>
#include <random>
#include <utility>
#include <vector>

#include "tests/support/random_map.h"

namespace splinemap::tile_tree_test {

using Content = std::map<std::pair<int32_t, int32_t>, std::pair<Tile, uint64_t>>;

Content ContentOf(const TileTree& tree, uint64_t since = 0) {
  Content content;
  tree.ForEachChanged(since, [&](TileKey key, const TileTree::Entry& entry) {
    const bool is_new =
        content.emplace(std::pair(key.tx, key.ty), std::pair(*entry.tile->Get(), entry.revision))
            .second;
    EXPECT_TRUE(is_new) << "visited twice";
  });
  return content;
}

TEST(TileTreeTest, FindsNothingInAnEmptyTree) {
  const TileTree tree;
  EXPECT_EQ(tree.Find({0, 0}), nullptr);
  EXPECT_EQ(tree.size(), 0u);
  EXPECT_TRUE(ContentOf(tree).empty());
}

TEST(TileTreeTest, VisitsWhatLiesInARectangle) {
  constexpr int32_t kFar = kMaxKnotIndex >> 5;
  TileTreeEditor editor;
  std::mt19937_64 random(1);
  const auto coordinate = [&] { return static_cast<int32_t>(random() % 60) - 30; };
  for (int n = 0; n < 1000; ++n) editor.Edit({coordinate(), coordinate()}, 1);
  editor.Edit({kFar, kFar}, 1);
  for (int n = 0; n < 1000; ++n) {
    const TileKey first{coordinate(), coordinate()};
    const TileKey last{first.tx + static_cast<int32_t>(random() % 20) - 1,
                       first.ty + static_cast<int32_t>(random() % 20) - 1};
    std::map<std::pair<int32_t, int32_t>, const StoredTile*> expected;
    editor.tree().ForEach([&](TileKey key, const TileTree::Entry& entry) {
      if (key.tx < first.tx || key.tx > last.tx || key.ty < first.ty || key.ty > last.ty) return;
      expected[{key.tx, key.ty}] = entry.tile.get();
    });
    std::map<std::pair<int32_t, int32_t>, const StoredTile*> visited;
    editor.tree().ForEachIn(first, last, [&](TileKey key, const TileTree::Entry& entry) {
      EXPECT_TRUE(visited.emplace(std::pair(key.tx, key.ty), entry.tile.get()).second);
    });
    EXPECT_EQ(visited, expected);
  }
  int count = 0;
  editor.tree().ForEachIn({kFar - 2, kFar - 2}, {kFar + 4, kFar + 4},
                          [&](TileKey, const TileTree::Entry&) { ++count; });
  EXPECT_EQ(count, 1);
  TileTree().ForEachIn({-1, -1}, {1, 1}, [&](TileKey, const TileTree::Entry&) { ++count; });
  EXPECT_EQ(count, 1);
}

TEST(TileTreeTest, HintsStayWithAFrozenTree) {
  TileTreeEditor editor;
  editor.Edit({2, 3}, 1);
  const TileTree frozen = editor.Freeze();
  EXPECT_EQ(frozen.FindSlot({2, 2}).value, nullptr);
  EXPECT_EQ(frozen.FindSlot({1000, 3}).value, nullptr);
  const TileTree::Slot& slot = frozen.FindSlot({2, 3});
  EXPECT_EQ(slot.value.get(), frozen.Find({2, 3}));
  EXPECT_EQ(slot.hint.Get(0), nullptr);
  const Tile content;
  slot.hint.Set(&content, 5);
  EXPECT_EQ(TileTree(frozen).FindSlot({2, 3}).hint.Get(5), &content);
  // What is written is another tile, elsewhere.
  editor.Edit({2, 3}, 2);
  EXPECT_EQ(editor.tree().FindSlot({2, 3}).hint.Get(5), nullptr);
  EXPECT_EQ(slot.hint.Get(5), &content);
  // And so it is in a tree that nobody has frozen.
  editor.tree().FindSlot({2, 3}).hint.Set(&content, 5);
  editor.Edit({2, 3}, 3);
  EXPECT_EQ(editor.tree().FindSlot({2, 3}).hint.Get(5), nullptr);
  editor.tree().FindSlot({2, 3}).hint.Set(&content, 5);
  editor.Put({2, 3}, std::make_shared<const StoredTile>(), 4);
  EXPECT_EQ(editor.tree().FindSlot({2, 3}).hint.Get(5), nullptr);
}

TEST(TileTreeTest, AHintIsGoodForItsStampAlone) {
  const TileTree::Hint hint;
  const Tile content;
  constexpr uint64_t kTooLarge = uint64_t{1} << 22;
  for (const uint64_t stamp : {uint64_t{0}, uint64_t{7}, kTooLarge - 1}) {
    hint.Set(&content, stamp);
    EXPECT_EQ(hint.Get(stamp), &content);
    EXPECT_EQ(hint.Get(stamp + 1), nullptr);
    EXPECT_EQ(hint.Get(stamp + kTooLarge), nullptr);
  }
  hint.Set(&content, 3);
  const Tile other;
  hint.Set(&other, kTooLarge + 3);
  EXPECT_EQ(hint.Get(3), &content);
  EXPECT_EQ(hint.Get(kTooLarge + 3), nullptr);
}

TEST(TileTreeTest, HoldsKeysOfEverySignAndSize) {
  constexpr int32_t kFar = kMaxKnotIndex >> 5;
  const std::vector<TileKey> keys = {{0, 0},       {-1, 0},         {0, -1},       {-1, -1},
                                     {3, -4},      {4, -5},         {27, -36},     {28, -37},
                                     {1000, 1000}, {-1000, 123456}, {kFar, -kFar}, {-kFar, kFar}};
  TileTreeEditor editor;
  for (size_t k = 0; k < keys.size(); ++k) {
    EXPECT_EQ(editor.tree().Find(keys[k]), nullptr);
    editor.Edit(keys[k], k + 1).Edit().control_points[7] = static_cast<ControlPoint>(k + 1);
  }
  EXPECT_EQ(editor.tree().size(), keys.size());
  for (size_t k = 0; k < keys.size(); ++k) {
    const auto tile = FindTile(editor.tree(), keys[k]);
    ASSERT_NE(tile, nullptr) << keys[k].tx << " " << keys[k].ty;
    EXPECT_EQ(tile->control_points[7], static_cast<ControlPoint>(k + 1));
    EXPECT_EQ(editor.tree().RevisionOf(keys[k]), k + 1);
  }
  std::vector<TileKey> with_absent = keys;
  with_absent.insert(with_absent.begin() + 3, {7, 7});
  std::vector<const TileTree::Slot*> found(with_absent.size());
  editor.tree().FindSlots(with_absent, absl::MakeSpan(found));
  for (size_t k = 0; k < found.size(); ++k) {
    EXPECT_EQ(found[k]->value.get(), editor.tree().Find(with_absent[k])) << k;
  }
  EXPECT_EQ(ContentOf(editor.tree()).size(), keys.size());
  EXPECT_EQ(editor.tree().Find({kFar - 1, kFar}), nullptr);
}

// Against a std::map that is copied for each snapshot.
TEST(TileTreeTest, FrozenTreesKeepTheirContentWhateverComesAfter) {
  std::mt19937_64 random(11);
  TileTreeEditor editor;
  Content expected;
  std::vector<std::pair<TileTree, Content>> frozen;
  for (uint64_t revision = 1; revision <= 400; ++revision) {
    const TileKey key = RandomKey(random, revision % 3 == 0 ? 40 : 5);
    auto& [tile, tile_revision] = expected[{key.tx, key.ty}];
    tile_revision = revision;
    if (revision % 7 == 0) {
      tile = RandomTile(random);
      editor.Put(key, std::make_shared<const StoredTile>(tile), revision);
    } else {
      tile.control_points[revision % Tile::kSize] += 3;
      editor.Edit(key, revision).Edit().control_points[revision % Tile::kSize] += 3;
    }
    if (revision % 20 == 0) frozen.emplace_back(editor.Freeze(), expected);
  }
  EXPECT_EQ(ContentOf(editor.tree()), expected);
  EXPECT_EQ(editor.tree().size(), expected.size());
  for (const auto& [tree, content] : frozen) {
    EXPECT_EQ(ContentOf(tree), content);
    EXPECT_EQ(tree.size(), content.size());
  }
}

// Of all pairs of states of two lines that began as one.
TEST(TileTreeTest, DifferencesAreThoseOfTheContents) {
  std::mt19937_64 random(5);
  std::vector<TileTree> trees{TileTree()};
  TileTreeEditor one;
  TileTreeEditor other;
  for (uint64_t revision = 1; revision <= 120; ++revision) {
    TileTreeEditor& editor = revision > 40 && revision % 2 == 0 ? other : one;
    const TileKey key = RandomKey(random, revision < 20 ? 2 : 60);
    if (revision % 5 == 0 && editor.tree().Find(key) != nullptr) {
      editor.Put(key, editor.tree().Share(key), revision);  // at another revision
    } else {
      editor.Put(key, std::make_shared<const StoredTile>(RandomTile(random)), revision);
    }
    if (revision == 40) other = TileTreeEditor(one.Freeze());
    if (revision % 8 == 0) trees.push_back(editor.Freeze());
  }
  for (const TileTree& before : trees) {
    for (const TileTree& after : trees) {
      Content rest = ContentOf(before);
      size_t differences = 0;
      TileTree::ForEachDifference(
          before, after, [&](TileKey key, const TileTree::Entry* was, const TileTree::Entry* is) {
            ++differences;
            EXPECT_EQ(was == nullptr, !rest.contains({key.tx, key.ty}));
            rest.erase({key.tx, key.ty});
            if (is != nullptr) rest[{key.tx, key.ty}] = {*is->tile->Get(), is->revision};
          });
      EXPECT_EQ(rest, ContentOf(after));
      EXPECT_TRUE(&before != &after || differences == 0);
    }
  }
}

TEST(TileTreeTest, TwoEditorsOfOneTreeDoNotSeeEachOther) {
  TileTreeEditor first;
  first.Edit({0, 0}, 1).Edit().control_points[0] = 10;
  const TileTree base = first.Freeze();
  TileTreeEditor second(base);
  second.Edit({0, 0}, 2).Edit().control_points[0] = 20;
  first.Edit({0, 0}, 2).Edit().control_points[0] = 30;
  EXPECT_EQ(FindTile(base, {0, 0})->control_points[0], 10);
  EXPECT_EQ(FindTile(first.tree(), {0, 0})->control_points[0], 30);
  EXPECT_EQ(FindTile(second.tree(), {0, 0})->control_points[0], 20);
}

TEST(TileTreeTest, AnEditOfASharedTileCopiesIt) {
  const auto shared = std::make_shared<const StoredTile>();
  TileTreeEditor editor;
  editor.Put({1, 2}, shared, 1);
  editor.Edit({1, 2}, 2).Edit().control_points[5] = 9;
  EXPECT_EQ(shared->Get()->control_points[5], 0);
  EXPECT_EQ(FindTile(editor.tree(), {1, 2})->control_points[5], 9);
}

TEST(TileTreeTest, WritesInPlaceUntilTheNextFreeze) {
  TileTreeEditor editor;
  const Tile* tile = &editor.Edit({0, 0}, 1).Edit();
  EXPECT_EQ(&editor.Edit({0, 0}, 2).Edit(), tile);
  const TileTree frozen = editor.Freeze();
  EXPECT_NE(&editor.Edit({0, 0}, 3).Edit(), tile);
}

TEST(TileTreeTest, VisitsJustWhatChangedSinceAnEarlierFreeze) {
  std::mt19937_64 random(5);
  TileTreeEditor editor;
  std::map<std::pair<int32_t, int32_t>, int> changed_in;  // key: round of the last change
  std::vector<TileTree> frozen;
  for (int round = 0; round < 40; ++round) {
    for (int n = 0; n < 5; ++n) {
      const TileKey key = RandomKey(random, round == 20 ? 1000 : 20);
      // Revisions of an owner may come in any order; what changed here does not depend on them.
      if (n % 2 == 0) {
        editor.Edit(key, random() % 100).Edit().control_points[0] += 1;
      } else {
        editor.Put(key, std::make_shared<const StoredTile>(RandomTile(random)), random() % 100);
      }
      changed_in[{key.tx, key.ty}] = round;
    }
    frozen.push_back(editor.Freeze());
  }
  for (int round = 0; round < 40; ++round) {
    Content expected;
    for (const auto& [key, last_change] : changed_in) {
      if (last_change <= round) continue;
      const TileKey changed{key.first, key.second};
      expected[key] = {*FindTile(frozen.back(), changed), frozen.back().RevisionOf(changed)};
    }
    EXPECT_EQ(ContentOf(frozen.back(), frozen[round].version()), expected) << round;
  }
}

}  // namespace splinemap::tile_tree_test
