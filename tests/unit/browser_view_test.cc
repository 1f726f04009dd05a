#include "services/viewer/browser_view.h"

#include <zlib.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "splinemap/surface.h"
#include "tests/support/random_map.h"

namespace splinemap::browser_view_test {

using nlohmann::json;

constexpr double kKnot_m = 0.05;

// A frame taken apart.
struct Frame {
  json text;
  std::map<TileKey, Tile> tiles;  // that it brings
  std::vector<TileKey> gone;
};

Tile Inflated(std::string_view bytes) {
  z_stream stream{};
  EXPECT_EQ(inflateInit2(&stream, -15), Z_OK);
  Tile tile;
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(tile.control_points.data());
  stream.avail_out = sizeof(tile.control_points);
  EXPECT_EQ(inflate(&stream, Z_FINISH), Z_STREAM_END);
  EXPECT_EQ(stream.total_out, sizeof(tile.control_points));
  inflateEnd(&stream);
  return tile;
}

Frame Parse(const std::string& bytes) {
  uint32_t length = 0;
  std::memcpy(&length, bytes.data(), sizeof(length));
  Frame frame{.text = json::parse(bytes.substr(sizeof(length), length)), .tiles = {}, .gone = {}};
  size_t at = sizeof(length) + length;
  if (frame.text.contains("tiles")) {
    for (const json& row : frame.text["tiles"]["list"]) {
      const TileKey key{row[1].get<int32_t>(), row[2].get<int32_t>()};
      const auto size = row[3].get<size_t>();
      if (size == 0) {
        frame.gone.push_back(key);
      } else {
        frame.tiles[key] = Inflated(std::string_view(bytes).substr(at, size));
      }
      at += size;
    }
  }
  EXPECT_EQ(at, bytes.size());
  return frame;
}

// A server of one surface, and a page that acknowledges what it takes in.
class BrowserViewTest : public testing::Test {
 protected:
  Tile& Edit(TileKey key) { return tiles_.Edit(key, ++revision_).Edit(); }
  void Commit(int64_t utime_ms = 1) {
    while (levels_.Advance(tiles_.Freeze(), utime_ms, 1'000'000)) {
    }
  }
  void Look(const std::string& region, int level = 0) {
    ASSERT_TRUE(view_
                    .Handle(R"({"view":{)" + region + R"(,"level":)" + std::to_string(level) +
                            R"(,"surfaces":["sum"]}})")
                    .ok());
  }
  std::optional<Frame> Next() {
    const auto bytes = view_.NextFrame(
        sections_, kKnot_m,
        [&](const std::string& name) { return name == "sum" ? &levels_ : nullptr; }, bodies_);
    if (!bytes) return std::nullopt;
    return Parse(*bytes);
  }
  void Acknowledge(const Frame& frame) {
    ASSERT_TRUE(view_.Handle(json{{"ack", frame.text["frame"]}}.dump()).ok());
  }
  // All that comes until nothing is new, as the page keeps it.
  void Receive() {
    while (const std::optional<Frame> frame = Next()) {
      for (const auto& [key, tile] : frame->tiles) page_[key] = tile;
      for (const TileKey key : frame->gone) page_.erase(key);
      ++frames_;
      Acknowledge(*frame);
    }
  }
  std::map<TileKey, Tile> InTree() const {
    std::map<TileKey, Tile> all;
    tiles_.tree().ForEach(
        [&](TileKey key, const TileTree::Entry& entry) { all[key] = *entry.tile->Get(); });
    return all;
  }

  static constexpr const char* kAll = R"("x0_m":-50,"y0_m":-50,"x1_m":50,"y1_m":50)";

  std::mt19937_64 random_{1};
  TileTreeEditor tiles_;
  uint64_t revision_ = 0;
  SurfaceLevels levels_;
  Sections sections_;
  TileBodies bodies_;
  BrowserView view_;
  std::map<TileKey, Tile> page_;
  int frames_ = 0;
};

TEST_F(BrowserViewTest, APageEndsWithTheTilesOfTheMap) {
  for (int32_t n = -20; n < 20; ++n) Edit({n, -n / 2}) = RandomTile(random_, {-2560, 2560});
  Commit();
  Look(kAll);
  Receive();
  EXPECT_EQ(page_, InTree());
  // Now what changes, alone.
  Edit({3, 4}).control_points[5] = 77;
  Edit({3, -1}).control_points[6] = -77;
  Commit();
  const auto frame = Next();
  ASSERT_TRUE(frame.has_value());
  EXPECT_EQ(frame->tiles.size(), 2);
  EXPECT_EQ(frame->tiles.at({3, 4}).control_points[5], 77);
  EXPECT_TRUE(frame->text["tiles"]["is_complete"].get<bool>());
}

TEST_F(BrowserViewTest, NothingComesBeforeTheLastFrameIsAcknowledged) {
  Look(kAll);
  Edit({0, 0}).control_points[0] = 1;
  Commit();
  const auto first = Next();
  ASSERT_TRUE(first.has_value());
  for (int16_t n = 2; n < 50; ++n) {
    Edit({0, 0}).control_points[0] = n;
    Commit();
    ASSERT_FALSE(Next().has_value());
  }
  Acknowledge(*first);
  const auto second = Next();
  ASSERT_TRUE(second.has_value());
  EXPECT_EQ(second->tiles.at({0, 0}).control_points[0], 49);  // the newest, once
  EXPECT_FALSE(Next().has_value());
}

TEST_F(BrowserViewTest, AcknowledgementsOfFramesToComeCountNothing) {
  Look(kAll);
  ASSERT_TRUE(Next().has_value());
  ASSERT_TRUE(view_.Handle(R"({"ack":1000000})").ok());
  Edit({0, 0}).control_points[0] = 1;
  Commit();
  EXPECT_FALSE(Next().has_value());
}

TEST_F(BrowserViewTest, LargeMapsComeInPiecesNearestFirst) {
  for (int32_t ty = -20; ty < 20; ++ty) {
    for (int32_t tx = -20; tx < 20; ++tx) Edit({tx, ty}) = RandomTile(random_, {-2560, 2560});
  }
  Commit();
  Look(kAll);
  const auto first = Next();
  ASSERT_TRUE(first.has_value());
  EXPECT_FALSE(first->text["tiles"]["is_complete"].get<bool>());
  for (const TileKey key : {TileKey{0, 0}, {-1, -1}, {3, 3}})
    EXPECT_TRUE(first->tiles.contains(key));
  EXPECT_FALSE(first->tiles.contains({19, 19}));
  Acknowledge(*first);
  page_ = first->tiles;
  Receive();
  EXPECT_GT(frames_, 1);
  EXPECT_EQ(page_, InTree());
}

TEST_F(BrowserViewTest, AViewBringsWhatItDidNotHave) {
  for (int32_t n = 0; n < 40; ++n) Edit({n, 0}).control_points[0] = static_cast<int16_t>(n + 1);
  Commit();
  const double side_m = 32 * kKnot_m;
  const auto region = [&](int tx0, int tx1) {
    return fmt::format(R"("x0_m":{},"y0_m":0.2,"x1_m":{},"y1_m":0.3)", (tx0 + 0.5) * side_m,
                       (tx1 + 0.5) * side_m);
  };
  Look(region(0, 9));
  Receive();
  EXPECT_EQ(page_.size(), 10);
  Look(region(5, 14));
  const auto frame = Next();
  ASSERT_TRUE(frame.has_value());
  EXPECT_EQ(frame->tiles.size(), 5);
  EXPECT_TRUE(frame->tiles.contains({14, 0}));
  // Back again: what was out of view may have changed, so it comes once more.
  Acknowledge(*frame);
  Look(region(0, 9));
  const auto back = Next();
  ASSERT_TRUE(back.has_value());
  EXPECT_EQ(back->tiles.size(), 5);
}

TEST_F(BrowserViewTest, AViewThatNobodySawWasOneForThePage) {
  for (int32_t n = 0; n < 40; ++n) Edit({n, 0}).control_points[0] = 1;
  Commit();
  const double side_m = 32 * kKnot_m;
  const auto region = [&](int tx) {
    return fmt::format(R"("x0_m":{},"y0_m":0.2,"x1_m":{},"y1_m":0.3)", (tx + 0.5) * side_m,
                       (tx + 9.5) * side_m);
  };
  Look(region(0));
  Receive();
  ASSERT_EQ(page_.size(), 10);
  // The page goes away and back before the server looks: it has forgotten what it went from.
  Look(region(20));
  Look(region(0));
  page_.clear();
  Receive();
  EXPECT_EQ(page_.size(), 10);
}

TEST_F(BrowserViewTest, TilesOfALayerThatIsGoneGo) {
  Edit({0, 0}).control_points[0] = 1;
  Edit({1, 0}).control_points[0] = 2;
  Commit();
  Look(kAll);
  Receive();
  ASSERT_EQ(page_.size(), 2);
  tiles_ = TileTreeEditor();  // begun anew
  Edit({1, 0}).control_points[0] = 3;
  Commit();
  Receive();
  EXPECT_EQ(page_, InTree());
}

TEST_F(BrowserViewTest, WallsDoNotVanishFromFar) {
  Tile free;
  free.control_points.fill(-2048);
  for (int32_t ty = 0; ty < 16; ++ty) {
    for (int32_t tx = 0; tx < 16; ++tx) Edit({tx, ty}) = free;
  }
  Edit({7, 7}).control_points[100] = 1500;
  Commit();
  for (int level = 1; level <= 2; ++level) {
    page_.clear();
    Look(R"("x0_m":0,"y0_m":0,"x1_m":25,"y1_m":25)", level);
    Receive();
    int occupied = 0;
    for (const auto& [key, tile] : page_) {
      occupied += static_cast<int>(
          std::count(tile.control_points.begin(), tile.control_points.end(), 1500));
    }
    EXPECT_EQ(occupied, 1) << level;
  }
}

TEST_F(BrowserViewTest, FromFarASquareIsAsOccupiedAsItsParts) {
  // A quarter of the squares of level 2 is wall, and half of the tile unknown.
  Tile& tile = Edit({0, 0});
  for (int j = 0; j < 32; ++j) {
    for (int i = 0; i < 16; ++i) {
      const bool is_wall = i / 4 % 2 == 0 && j / 4 % 2 == 0;
      tile.control_points[IndexInTile(i, j)] = is_wall ? 2560 : -2560;
    }
  }
  Commit();
  const auto level_3 = FindTile(levels_.tiles(3), {0, 0});
  ASSERT_NE(level_3, nullptr);
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 2; ++i) {
      EXPECT_NEAR(Probability(level_3->control_points[IndexInTile(i, j)] / 256.0), 0.25, 0.001);
    }
    EXPECT_EQ(level_3->control_points[IndexInTile(2, j)], 0);
  }
  // Once more from one that is half there.
  const auto level_5 = FindTile(levels_.tiles(5), {0, 0});
  ASSERT_NE(level_5, nullptr);
  EXPECT_NEAR(Probability(level_5->control_points[0] / 256.0), 0.25, 0.001);
}

TEST_F(BrowserViewTest, CoarserLevelsFollowPieceByPiece) {
  for (int n = 0; n < 300; ++n) {
    Edit(RandomKey(random_, 30)) = RandomTile(random_, {-2560, 2560});
    const TileTree tree = tiles_.Freeze();
    if (n % 3 == 0) levels_.Advance(tree, n, 2);  // never gets done
  }
  Commit();
  SurfaceLevels at_once;
  while (at_once.Advance(tiles_.Freeze(), 1, 1'000'000)) {
  }
  for (int level = 1; level <= LevelOfDetail::kMaxLevel; ++level) {
    at_once.tiles(level).ForEach([&](TileKey key, const TileTree::Entry& entry) {
      const auto tile = FindTile(levels_.tiles(level), key);
      ASSERT_NE(tile, nullptr);
      ASSERT_EQ(*tile, *entry.tile->Get());
    });
    EXPECT_GE(levels_.tiles(level).size(), at_once.tiles(level).size());
  }
}

TEST_F(BrowserViewTest, SectionsComeWhenTheyChange) {
  sections_.Set(Sections::kMap, R"({"tiles":1})");
  const auto first = Next();
  ASSERT_TRUE(first.has_value());
  EXPECT_EQ(first->text["map"]["tiles"], 1);
  EXPECT_FALSE(first->text.contains("tiles"));
  Acknowledge(*first);
  sections_.Set(Sections::kMap, R"({"tiles":1})");
  EXPECT_FALSE(Next().has_value());
  sections_.Set(Sections::kPoses, "[]");
  const auto second = Next();
  ASSERT_TRUE(second.has_value());
  EXPECT_TRUE(second->text.contains("poses"));
  EXPECT_FALSE(second->text.contains("map"));
}

TEST_F(BrowserViewTest, ATimeIsThatOfTheLastMessage) {
  EXPECT_FALSE(view_.time_request().has_value());
  ASSERT_TRUE(view_.Handle(R"({"at_utime":1796000000000000})").ok());
  EXPECT_EQ(view_.time_request()->utime, Utime(1796000000000000));
  ASSERT_TRUE(view_.Handle(R"({"at_utime":null})").ok());
  EXPECT_EQ(view_.time_request()->utime, std::nullopt);
  ASSERT_TRUE(view_.Handle(R"({"at_utime":18446744073709551615})").ok());
  EXPECT_EQ(view_.time_request()->utime, Utime::max());
  ASSERT_TRUE(view_.Handle(R"({"at_utime":-9223372036854775808})").ok());
  EXPECT_EQ(view_.time_request()->utime, Utime::min());
  ASSERT_TRUE(view_.Handle(R"({"ack":0})").ok());
  EXPECT_FALSE(view_.time_request().has_value());
  for (const char* time : {"\"now\"", "1.5", "1e300", "-1e999", "true", "[1]", "{}", ""}) {
    EXPECT_FALSE(view_.Handle(fmt::format(R"({{"at_utime":{}}})", time)).ok()) << time;
    EXPECT_FALSE(view_.time_request().has_value()) << time;
  }
}

TEST_F(BrowserViewTest, WhatIsNoMessageOfThePageIsRefused) {
  for (const char* message :
       {"", "x", "[]", "1", "\"ack\"", R"({"ack":"1"})", R"({"view":1})", R"({"view":{"x0_m":0}})",
        R"({"view":{"x0_m":0,"y0_m":0,"x1_m":1,"y1_m":1,"level":9,"surfaces":[]}})",
        R"({"view":{"x0_m":0,"y0_m":0,"x1_m":1,"y1_m":1,"level":-1,"surfaces":[]}})",
        R"({"view":{"x0_m":2,"y0_m":0,"x1_m":1,"y1_m":1,"level":0,"surfaces":[]}})",
        R"({"view":{"x0_m":0,"y0_m":0,"x1_m":1e999,"y1_m":1,"level":0,"surfaces":[]}})",
        R"({"view":{"x0_m":0,"y0_m":0,"x1_m":1,"y1_m":1,"level":0,"surfaces":[1]}})",
        "{\"ack\":1,\"x\":\"\xff\"}"}) {
    EXPECT_FALSE(view_.Handle(message).ok()) << message;
  }
  EXPECT_FALSE(view_.Handle(std::string(8000, '[')).ok());
  EXPECT_FALSE(
      view_.Handle("{\"view\":" + std::string(4000, '[') + std::string(4000, ']') + "}").ok());
  EXPECT_FALSE(view_.request().has_value());
}

TEST_F(BrowserViewTest, AViewOfTheWholeWorldIsBounded) {
  for (int32_t n = -200; n < 200; ++n) Edit({n, n}).control_points[0] = 1;
  Commit();
  Look(R"("x0_m":-1e12,"y0_m":-1e12,"x1_m":1e12,"y1_m":1e12)");
  Receive();
  EXPECT_LE(page_.size(), ViewRequest::kMaxTiles);
}

TEST(TileBodiesTest, ATileIsCompressedOnceAndMemoryIsBounded) {
  TileBodies bodies;
  const auto tile = std::make_shared<const StoredTile>();
  const std::string* first = &bodies.Of(tile);
  EXPECT_EQ(first, &bodies.Of(tile));
  std::weak_ptr<const StoredTile> oldest;
  for (size_t k = 0; k <= TileBodies::kMaxTiles; ++k) {
    const auto other = std::make_shared<const StoredTile>();
    if (k == 0) oldest = other;
    bodies.Of(other);
  }
  EXPECT_TRUE(oldest.expired());
}

}  // namespace splinemap::browser_view_test
