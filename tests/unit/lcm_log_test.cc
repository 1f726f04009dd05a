#include "lib/logs/lcm_log.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <lcm/lcm-cpp.hpp>
#include <random>

#include "lib/base/status.h"
#include "lib/wire/encode.h"
#include "lib/wire/message_type.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::lcm_log_test {

class LcmLogTest : public testing::Test {
 protected:
  LcmLogTest() {
    auto writer = LcmLogWriter::Create(path_);
    for (int k = 0; k < 10; ++k) {
      EXPECT_TRUE(writer->Write(Utime(k), "POSE", PoseMessage({Utime(k), {}})).ok());
    }
    EXPECT_TRUE(writer->Close().ok());
    EXPECT_FALSE(writer->Close().ok());
  }

  std::string Bytes() const {
    std::ifstream in(path_, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  void SetBytes(const std::string& bytes) const { std::ofstream(path_, std::ios::binary) << bytes; }

  // Leaves the number of events in events_, and their time stamps, which are their numbers.
  absl::Status Read() {
    utimes_.clear();
    const absl::Status status = ReadLcmLog(
        path_,
        [&](const LogEvent& event) {
          utimes_.push_back(event.utime.count());
          EXPECT_EQ(event.channel, "POSE");
        },
        [](double share) { EXPECT_LE(share, 1); });
    events_ = utimes_.size();
    return status;
  }

  static constexpr size_t kEventBytes = 28 + 4 + 8 + 8 + 16 * 8;
  TemporaryDirectory directory_;
  std::string path_ = directory_.File("log");
  std::vector<int64_t> utimes_;
  size_t events_ = 0;
};

TEST_F(LcmLogTest, ReadsWhatWasWritten) {
  EXPECT_TRUE(Read().ok());
  EXPECT_EQ(events_, 10u);
}

TEST_F(LcmLogTest, ALogThatIsNotClosedLeavesTheOldOne) {
  const std::string before = Bytes();
  {
    auto writer = LcmLogWriter::Create(path_);
    EXPECT_TRUE(writer->Write(Utime(1), "POSE", PoseMessage({})).ok());
  }
  EXPECT_EQ(Bytes(), before);
  EXPECT_EQ(directory_.CountFiles(), 1);
}

TEST_F(LcmLogTest, LcmItselfReadsTheSame) {
  lcm::LogFile file(path_, "r");
  int count = 0;
  while (const lcm::LogEvent* event = file.readNextEvent()) {
    EXPECT_EQ(event->timestamp, count++);
    bot_core::pose_t pose;
    EXPECT_EQ(pose.decode(event->data, 0, event->datalen), event->datalen);
  }
  EXPECT_EQ(count, 10);
}

TEST_F(LcmLogTest, ALogThatEndsEarlyGivesTheEventsBefore) {
  const std::string whole = Bytes();
  for (const size_t cut : {1, 20, 100, 170}) {
    SetBytes(whole.substr(0, whole.size() - cut));
    EXPECT_TRUE(absl::IsDataLoss(Read())) << cut;
    EXPECT_EQ(events_, 9u);
  }
}

TEST_F(LcmLogTest, ADamagedLengthCostsItsEventOnly) {
  const std::string whole = Bytes();
  for (const int64_t event : {0, 4, 9}) {
    for (const size_t place : {20, 23, 24, 25, 26, 27}) {  // of the lengths in the header
      std::string bytes = whole;
      bytes[static_cast<size_t>(event) * kEventBytes + place] ^= 0x11;
      SetBytes(bytes);
      const absl::Status status = Read();
      EXPECT_TRUE(absl::IsDataLoss(status)) << status;
      std::erase(utimes_, event);  // cut short it may have come
      EXPECT_EQ(utimes_.size(), 9u) << event << " " << place;
    }
  }
}

TEST_F(LcmLogTest, DamageIsCountedAndPlaced) {
  std::string bytes = Bytes();
  bytes[7 * kEventBytes] = 0;                     // a sync word
  bytes.erase(3 * kEventBytes + 50, 60);          // a part of an event
  bytes.insert(kEventBytes, std::string(33, 1));  // something between two events
  SetBytes(bytes);
  const absl::Status status = Read();
  EXPECT_TRUE(absl::IsDataLoss(status)) << status;
  EXPECT_EQ(utimes_, (std::vector<int64_t>{0, 1, 2, 4, 5, 6, 8, 9}));
  const size_t skipped = 33 + (kEventBytes - 60) + kEventBytes;
  const std::string text = ErrorText(status);
  EXPECT_NE(text.find(fmt::format("skipped {} bytes (gaps: 3", skipped)), std::string::npos)
      << text;
  EXPECT_NE(text.find(fmt::format("byte {}", kEventBytes)), std::string::npos) << text;
}

TEST_F(LcmLogTest, ALogWithoutItsBeginningGivesTheRest) {
  SetBytes(Bytes().substr(100));
  EXPECT_TRUE(absl::IsDataLoss(Read()));
  EXPECT_EQ(events_, 9u);
}

TEST_F(LcmLogTest, DamageAndAnEndWithinAnEventAreBothSaid) {
  std::string bytes = Bytes();
  bytes[2 * kEventBytes] = 0;
  SetBytes(bytes.substr(0, bytes.size() - 1));
  const std::string text = ErrorText(Read());
  EXPECT_EQ(events_, 8u);
  EXPECT_NE(text.find("gaps: 1"), std::string::npos) << text;
  EXPECT_NE(text.find("ends within event"), std::string::npos) << text;
}

TEST_F(LcmLogTest, WhateverIsDamagedOtherEventsAreRead) {
  const std::string whole = Bytes();
  std::mt19937_64 random(1);
  for (int round = 0; round < 200; ++round) {
    std::string bytes = whole;
    const size_t first = random() % bytes.size();
    const size_t count = std::min(bytes.size() - first, 1 + random() % 40);
    for (size_t k = first; k < first + count; ++k) bytes[k] = static_cast<char>(random());
    SetBytes(bytes);
    std::vector<int64_t> read;
    ReadLcmLog(
        path_, [&](const LogEvent& event) { read.push_back(event.utime.count()); }, [](double) {})
        .IgnoreError();
    // All but those that were hit, and at most one before, whose end cannot be told.
    for (int64_t event = 0; event < 10; ++event) {
      const size_t begin = static_cast<size_t>(event) * kEventBytes;
      const bool is_near = begin < first + count && first < begin + kEventBytes + 4;
      const bool is_read = std::find(read.begin(), read.end(), event) != read.end();
      EXPECT_TRUE(is_read || is_near) << "event " << event << ", damage at " << first;
    }
  }
}

TEST_F(LcmLogTest, ReadsGzipAndSaysWhenItEndsEarly) {
  const std::string whole = Bytes();
  const gzFile file = gzopen(path_.c_str(), "wb");
  for (int k = 0; k < 2000; ++k) gzwrite(file, whole.data(), static_cast<unsigned>(whole.size()));
  gzclose(file);
  EXPECT_TRUE(Read().ok());
  EXPECT_EQ(events_, 20'000u);
  const std::string bytes = Bytes();
  SetBytes(bytes.substr(0, bytes.size() / 2));
  EXPECT_TRUE(absl::IsDataLoss(Read()));
  EXPECT_GT(events_, 1000u);
}

TEST_F(LcmLogTest, OtherFilesAreNoLogs) {
  for (const std::string& text :
       {std::string("FLASER 180 this is another kind of log, longer than a header"),
        std::string("short"), std::string("\x89PNG\r\n\x1a\n") + std::string(200'000, '\xED')}) {
    SetBytes(text);
    EXPECT_TRUE(absl::IsInvalidArgument(Read()));
  }
  EXPECT_TRUE(absl::IsNotFound(ReadLcmLog(
      directory_.File("none"), [](const LogEvent&) {}, [](double) {})));
  EXPECT_TRUE(absl::IsNotFound(ReadLcmLog(
      directory_.path(), [](const LogEvent&) {}, [](double) {})));
  EXPECT_FALSE(LcmLogWriter::Create(directory_.File("no/such/folder")).ok());
}

// The poses of a log come before all scans, or after them.
TEST_F(LcmLogTest, ChannelsAreBroughtIntoTheOrderOfTheirTimes) {
  const std::string path = directory_.File("apart");
  auto writer = LcmLogWriter::Create(path);
  for (int k = 0; k < 100; ++k) {
    ASSERT_TRUE(writer->Write(Utime(k), "POSE", PoseMessage({Utime(10 * k), {}})).ok());
    ASSERT_TRUE(writer->Write(Utime(k), "OTHER", PoseMessage({Utime(0), {}})).ok());
  }
  for (int k = 0; k < 100; ++k) {
    ASSERT_TRUE(writer->Write(Utime(k), "LASER", PoseMessage({Utime(10 * k + 5), {}})).ok());
  }
  ASSERT_TRUE(writer->Close().ok());
  std::vector<int64_t> times;
  const auto time_of = [](const LogEvent& event) { return UtimeOf(event.message); };
  const auto status = ReadLcmLogInOrder(
      path, {"LASER", "NONE", "POSE"}, time_of,
      [&](const LogEvent& event) {
        EXPECT_NE(event.channel, "OTHER");
        times.push_back(UtimeOf(event.message).count());
      },
      [](double share) { EXPECT_LE(share, 1); });
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_EQ(times.size(), 200u);
  EXPECT_TRUE(std::is_sorted(times.begin(), times.end()));
  EXPECT_TRUE(absl::IsNotFound(ReadLcmLogInOrder(
      directory_.File("none"), {"POSE"}, time_of, [](const LogEvent&) {}, [](double) {})));
}

}  // namespace splinemap::lcm_log_test
