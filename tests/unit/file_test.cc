#include "lib/base/file.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>

#include "tests/support/full_disk.h"
#include "tests/support/temporary_directory.h"

namespace splinemap::file_test {

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

// Makes a part of `path` in another process, which then does what `end` does.
pid_t StartWriter(const std::string& path, void (*end)()) {
  const pid_t child = fork();
  if (child != 0) return child;
  RemoveTemporaryFilesAtSignals();
  auto file = NewFile::Create(path);
  if (!file.ok() || !file->Write("half").ok()) _exit(1);
  std::ofstream(file->temporary_path() + "-wal") << "beside";
  end();
  _exit(1);
}

TEST(NewFileTest, WhatAKilledProcessLeftTheNextOneRemoves) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("map");
  ASSERT_TRUE(WriteFile(path, "old").ok());
  ASSERT_TRUE(WriteFile(path + ".mine.part", "of somebody else").ok());
  const pid_t child = StartWriter(path, [] { raise(SIGKILL); });
  ASSERT_EQ(waitpid(child, nullptr, 0), child);
  EXPECT_EQ(directory.CountFiles(), 4);
  ASSERT_TRUE(WriteFile(path + "-2", "another").ok());
  EXPECT_EQ(directory.CountFiles(), 5) << "not of the other's name";
  ASSERT_TRUE(WriteFile(path, "new").ok());
  EXPECT_EQ(directory.CountFiles(), 3);
  EXPECT_EQ(*ReadFile(path), "new");
}

TEST(NewFileTest, WhatALivingProcessMakesStays) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("map");
  const pid_t child = StartWriter(path, [] {
    while (true) pause();
  });
  while (directory.CountFiles() < 2) usleep(1000);
  ASSERT_TRUE(WriteFile(path, "new").ok());
  EXPECT_EQ(directory.CountFiles(), 3);
  kill(child, SIGKILL);
  ASSERT_EQ(waitpid(child, nullptr, 0), child);
  // Its process is not seen here, but what holds the file is alive.
  const std::string foreign = path + ".999999999.0123456789abcdef.part";
  ASSERT_TRUE(WriteFile(foreign, "of another machine").ok());
  const int file = open(foreign.c_str(), O_RDONLY);
  ASSERT_EQ(flock(file, LOCK_EX), 0);
  ASSERT_TRUE(WriteFile(path, "newer").ok());
  EXPECT_EQ(directory.CountFiles(), 2);
  close(file);
  ASSERT_TRUE(WriteFile(path, "newest").ok());
  EXPECT_EQ(directory.CountFiles(), 1);
}

TEST(NewFileTest, SignalsThatEndAProcessRemoveWhatItWasMaking) {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    std::signal(signal, SIG_DFL);  // a job in the background of a shell ignores some
    const TemporaryDirectory directory;
    const pid_t child = StartWriter(directory.File("map"), [] {
      while (true) pause();
    });
    while (directory.CountFiles() < 2) usleep(1000);
    kill(child, signal);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFSIGNALED(status));
    EXPECT_EQ(WTERMSIG(status), signal);
    EXPECT_EQ(directory.CountFiles(), 0);
  }
}

}  // namespace splinemap::file_test
