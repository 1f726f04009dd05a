#include "lib/base/file.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "tests/support/full_disk.h"
#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

TEST(NewFileTest, TheOldContentStaysUntilTheCommit) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("map");
  ASSERT_TRUE(WriteFile(path, "old").ok());
  auto file = NewFile::Create(path);
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(file->Write("new").ok());
  EXPECT_EQ(*ReadFile(path), "old");
  ASSERT_TRUE(file->Commit().ok());
  EXPECT_EQ(*ReadFile(path), "new");
  EXPECT_EQ(directory.CountFiles(), 1);
}

TEST(NewFileTest, WithoutACommitNothingIsLeftBehind) {
  const TemporaryDirectory directory;
  {
    auto file = NewFile::Create(directory.File("map"));
    ASSERT_TRUE(file->Write("half").ok());
    const NewFile moved = *std::move(file);
    EXPECT_EQ(directory.CountFiles(), 1);
  }
  EXPECT_EQ(directory.CountFiles(), 0);
}

TEST(NewFileTest, FoldersAndDevicesAreNotReplaced) {
  const TemporaryDirectory directory;
  EXPECT_TRUE(absl::IsUnavailable(NewFile::Create(directory.File("no/folder")).status()));
  EXPECT_TRUE(absl::IsInvalidArgument(WriteFile(directory.path(), "text")));
  std::filesystem::create_symlink("/dev/null", directory.File("device"));
  EXPECT_TRUE(absl::IsInvalidArgument(WriteFile(directory.File("device"), "text")));
  EXPECT_EQ(directory.CountFiles(), 1);
}

TEST(NewFileTest, TwoWritersOfOneFileDoNotMix) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("map");
  auto first = NewFile::Create(path);
  auto second = NewFile::Create(path);
  ASSERT_TRUE(first.ok() && second.ok());
  ASSERT_TRUE(first->Write("of the first").ok() && second->Write("second").ok());
  ASSERT_TRUE(first->Commit().ok());
  EXPECT_EQ(*ReadFile(path), "of the first");
  ASSERT_TRUE(second->Commit().ok());
  EXPECT_EQ(*ReadFile(path), "second");
  EXPECT_EQ(directory.CountFiles(), 1);
}

TEST(NewFileTest, AFailedCommitLeavesNothing) {
  const TemporaryDirectory directory;
  auto file = NewFile::Create(directory.File("map"));
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(std::filesystem::create_directory(directory.File("map")));  // in its way
  EXPECT_TRUE(absl::IsUnavailable(file->Commit()));
  EXPECT_EQ(directory.CountFiles(), 1);
}

TEST(NewFileTest, AFullDiskIsNoticedAtTheLatestByTheCommit) {
  const TemporaryDirectory directory;
  auto file = NewFile::Create(directory.File("map"));
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(file->Write("few bytes wait in the buffer").ok());
  const FullDisk full_disk;
  const absl::Status status = file->Commit();
  EXPECT_TRUE(absl::IsUnavailable(status));
  EXPECT_NE(status.message().find("File too large"), absl::string_view::npos) << status;
  EXPECT_EQ(directory.CountFiles(), 0);
}

}  // namespace
}  // namespace splinemap
