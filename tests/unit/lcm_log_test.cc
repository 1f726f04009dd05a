#include "lib/logs/lcm_log.h"

#include <gtest/gtest.h>

#include <fstream>
#include <lcm/lcm-cpp.hpp>

#include "lib/wire/encode.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

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

  absl::Status Read() {
    events_ = 0;
    return ReadLcmLog(
        path_,
        [&](const LogEvent& event) {
          EXPECT_EQ(event.utime, Utime(events_++));
          EXPECT_EQ(event.channel, "POSE");
        },
        [](double) {});
  }

  TemporaryDirectory directory_;
  std::string path_ = directory_.File("log");
  int events_ = 0;
};

TEST_F(LcmLogTest, ReadsWhatWasWritten) {
  EXPECT_TRUE(Read().ok());
  EXPECT_EQ(events_, 10);
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
    EXPECT_EQ(events_, 9);
  }
}

TEST_F(LcmLogTest, DamageIsNamedAndAllocatesNothing) {
  std::string lengths = Bytes();
  for (size_t k = 24; k < 28; ++k) lengths[k] = '\x7f';
  SetBytes(lengths);
  const absl::Status status = Read();
  EXPECT_TRUE(absl::IsDataLoss(status)) << status;
  EXPECT_EQ(events_, 0);
}

TEST_F(LcmLogTest, OtherFilesAreNoLogs) {
  SetBytes("FLASER 180 this is another kind of log, longer than a header");
  EXPECT_TRUE(absl::IsInvalidArgument(Read()));
  EXPECT_TRUE(absl::IsNotFound(ReadLcmLog(
      directory_.File("none"), [](const LogEvent&) {}, [](double) {})));
  EXPECT_FALSE(LcmLogWriter::Create(directory_.File("no/such/folder")).ok());
}

}  // namespace
}  // namespace splinemap
