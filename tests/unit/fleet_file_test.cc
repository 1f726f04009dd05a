#include "lib/fleet/fleet_file.h"

#include <gtest/gtest.h>

#include <fstream>
#include <random>
#include <string>

#include "lib/base/file.h"
#include "tests/support/memory_fleet_store.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::fleet_file_test {

const LayerId kId{"robot", 7};
constexpr auto kUnpaced = [](int64_t) { return true; };

class FleetFileTest : public testing::Test {
 protected:
  std::string Random(size_t bytes) {
    std::string text(bytes, '\0');
    for (char& c : text) c = static_cast<char>(random_());
    return text;
  }
  absl::Status Put(const std::string& content) {
    std::ofstream(from_, std::ios::binary) << content;
    return FleetFileUpload(store_, kId, from_, 5).Bring(kUnpaced);
  }
  std::string Got() {
    const std::string to = folder_.File("to" + std::to_string(++gets_));
    EXPECT_EQ(GetFleetFile(store_, kId, to), absl::OkStatus());
    return ReadFile(to).value_or("cannot be read");
  }

  std::mt19937_64 random_{1};
  TemporaryDirectory folder_;
  const std::string from_ = folder_.File("from");
  int gets_ = 0;
  MemoryFleetStore store_;
};

TEST_F(FleetFileTest, AFileComesBackAsItWas) {
  for (const size_t bytes : {0, 1, 131072, 131073, 1000000}) {
    const std::string content = Random(bytes);
    ASSERT_EQ(Put(content), absl::OkStatus());
    EXPECT_EQ(Got(), content);
    EXPECT_EQ(FindFleetFile(store_, kId)->bytes, static_cast<int64_t>(bytes));
    EXPECT_EQ(FindFleetFile(store_, kId)->utime, 5);
  }
}

TEST_F(FleetFileTest, OfALaterCopyOnlyWhatChangedIsSent) {
  std::string content = Random(10 << 17);
  ASSERT_EQ(Put(content), absl::OkStatus());
  const int64_t before = store_.writes();
  content[5 << 17] ^= 1;
  ASSERT_EQ(Put(content), absl::OkStatus());
  EXPECT_EQ(store_.writes(), before + 2);  // a chunk, the record
  EXPECT_EQ(Got(), content);
}

TEST_F(FleetFileTest, WhileALaterCopyIsOnItsWayTheEarlierIsWhole) {
  const std::string earlier = Random(10 << 17);
  ASSERT_EQ(Put(earlier), absl::OkStatus());
  const std::string later = Random(10 << 17);
  std::ofstream(from_, std::ios::binary) << later;
  int chunks = 0;
  const auto end_after_four = [&](int64_t) { return ++chunks <= 4; };
  FleetFileUpload upload(store_, kId, from_, 6);
  EXPECT_TRUE(absl::IsCancelled(upload.Bring(end_after_four)));
  EXPECT_EQ(Got(), earlier);
  int64_t before = store_.writes();
  store_.FailAfterWrites(2);
  EXPECT_TRUE(absl::IsUnavailable(upload.Bring(kUnpaced)));
  store_.FailAfterWrites(-1);
  EXPECT_EQ(Got(), earlier);
  ASSERT_EQ(upload.Bring(kUnpaced), absl::OkStatus());
  EXPECT_EQ(store_.writes(), before + 6 + 1 + 1);  // chunks, one twice, the record
  EXPECT_EQ(Got(), later);
  // Another process, which was ended as well.
  std::ofstream(from_, std::ios::binary) << earlier;
  chunks = 0;
  EXPECT_TRUE(absl::IsCancelled(FleetFileUpload(store_, kId, from_, 7).Bring(end_after_four)));
  EXPECT_EQ(Got(), later);
  before = store_.writes();
  ASSERT_EQ(FleetFileUpload(store_, kId, from_, 7).Bring(kUnpaced), absl::OkStatus());
  // The other keys still have it.
  EXPECT_EQ(store_.writes(), before + 1);
  EXPECT_EQ(Got(), earlier);
}

TEST_F(FleetFileTest, AShorterFileLeavesNoChunksOfALonger) {
  ASSERT_EQ(Put(Random(10 << 17)), absl::OkStatus());
  const std::string shorter = Random(3 << 17);
  ASSERT_EQ(Put(shorter), absl::OkStatus());
  ASSERT_EQ(Put(shorter), absl::OkStatus());
  EXPECT_EQ(Got(), shorter);
  size_t chunks = 0;
  for (const auto& [key, entry] : store_.Save()) chunks += entry.value.empty() ? 0 : 1;
  EXPECT_EQ(chunks, 3u + 3u + 1u);  // two of each number, the record
}

TEST_F(FleetFileTest, WhatIsDamagedOrGoneIsToldAndLeavesNoFile) {
  ASSERT_EQ(Put(Random(3 << 17)), absl::OkStatus());
  const std::string to = folder_.File("to");
  for (const auto& [key, entry] : store_.Save()) {
    const MemoryFleetStore::Backup backup = store_.Save();
    FleetEntry damaged = entry;
    damaged.value[0] ^= 1;
    store_.Write(damaged);
    EXPECT_TRUE(absl::IsDataLoss(GetFleetFile(store_, kId, to))) << key;
    store_.Restore(backup);
    store_.Write({key, "", 0});
    EXPECT_FALSE(GetFleetFile(store_, kId, to).ok()) << key;
    store_.Restore(backup);
  }
  EXPECT_FALSE(ReadFile(to).ok());
  EXPECT_TRUE(absl::IsOutOfRange(FindFleetFile(store_, {"other", 7}).status()));
}

}  // namespace splinemap::fleet_file_test
