#include "lib/base/file.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "tests/support/temporary_directory.h"

namespace splinemap {
namespace {

int CountFiles(const std::string& folder) {
  int files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++files;
  return files;
}

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
  EXPECT_EQ(CountFiles(directory.path()), 1);
}

TEST(NewFileTest, WithoutACommitNothingIsLeftBehind) {
  const TemporaryDirectory directory;
  {
    auto file = NewFile::Create(directory.File("map"));
    ASSERT_TRUE(file->Write("half").ok());
    const NewFile moved = *std::move(file);
    EXPECT_EQ(CountFiles(directory.path()), 1);
  }
  EXPECT_EQ(CountFiles(directory.path()), 0);
}

TEST(NewFileTest, FoldersAndDevicesAreNotReplaced) {
  const TemporaryDirectory directory;
  EXPECT_TRUE(absl::IsUnavailable(NewFile::Create(directory.File("no/folder")).status()));
  EXPECT_TRUE(absl::IsInvalidArgument(WriteFile(directory.path(), "text")));
  std::filesystem::create_symlink("/dev/null", directory.File("device"));
  EXPECT_TRUE(absl::IsInvalidArgument(WriteFile(directory.File("device"), "text")));
  EXPECT_EQ(CountFiles(directory.path()), 1);
}

TEST(NewFileTest, AFailedCommitLeavesNothing) {
  const TemporaryDirectory directory;
  auto file = NewFile::Create(directory.File("map"));
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(std::filesystem::create_directory(directory.File("map")));  // in its way
  EXPECT_TRUE(absl::IsUnavailable(file->Commit()));
  EXPECT_EQ(CountFiles(directory.path()), 1);
}

TEST(NewFileTest, AFullDiskIsNoticedAtTheLatestByTheCommit) {
  const TemporaryDirectory directory;
  std::filesystem::create_symlink("/dev/full", directory.File("map.part"));
  auto file = NewFile::Create(directory.File("map"));
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(file->Write("few bytes wait in the buffer").ok());
  const absl::Status status = file->Commit();
  EXPECT_TRUE(absl::IsUnavailable(status));
  EXPECT_NE(status.message().find("No space left"), absl::string_view::npos);
  EXPECT_EQ(CountFiles(directory.path()), 0);
}

}  // namespace
}  // namespace splinemap
