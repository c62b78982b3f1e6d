// SPDX-License-Identifier: Apache-2.0
#include "kernel/queue_files.h"

#include <filesystem>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

QueueFile classified(const std::string& target) {
  QueueFile file;
  EXPECT_TRUE(classify_queue_file(target, file)) << target;
  return file;
}

TEST(QueueFiles, AnAnonymousTsgIsKnownByItsName) {
  EXPECT_EQ(classified("anon_inode:nvgpu-ga10b-tsg12").type, QueueType::kGpuTsg);
  EXPECT_EQ(classified("anon_inode:nvgpu-gv11b-tsg0").type, QueueType::kGpuTsg);
}

TEST(QueueFiles, TsgNodesOfBothHierarchiesAreKnown) {
  EXPECT_EQ(classified("/dev/nvgpu/igpu0/tsg").type, QueueType::kGpuTsg);
  EXPECT_EQ(classified("/dev/nvhost-tsg-gpu").type, QueueType::kGpuTsg);
}

TEST(QueueFiles, ADlaNodeTellsItsInstance) {
  const QueueFile file = classified("/dev/nvhost-ctrl-nvdla1");
  EXPECT_EQ(file.type, QueueType::kDla);
  EXPECT_EQ(file.instance, 1);
}

TEST(QueueFiles, WhatOnlyLooksLikeOneIsNone) {
  QueueFile file;
  for (const char* target :
       {"anon_inode:nvgpu-ga10b-tsg", "anon_inode:nvgpu-ga10b-tsg1x", "anon_inode:nvhost-ga10b-fd4",
        "anon_inode:[eventfd]", "/dev/nvgpu/igpu0/ctrl", "/dev/nvgpu/igpu0/channel",
        "/dev/nvhost-ctrl-nvdla", "/dev/nvhost-ctrl-nvdla0x", "/tmp/nvgpu/tsg", "", "socket:[12]"})
    EXPECT_FALSE(classify_queue_file(target, file)) << target;
}

TEST(QueueFiles, AProcesssDescriptorsAreReadInOrder) {
  const fs::path root = fs::temp_directory_path() / ("xauto-fd-" + std::to_string(getpid()));
  const fs::path folder = root / "proc/42/fd";
  fs::create_directories(folder);
  fs::create_symlink("/dev/nvhost-ctrl-nvdla0", folder / "11");
  fs::create_symlink("/dev/null", folder / "1");
  fs::create_symlink("anon_inode:nvgpu-ga10b-tsg9", folder / "9");
  const auto files = find_queue_files(42, root.string());
  fs::remove_all(root);
  ASSERT_TRUE(files);
  ASSERT_EQ(files->size(), 2u);
  EXPECT_EQ((*files)[0].fd, 9);
  EXPECT_EQ((*files)[1].fd, 11);
  EXPECT_EQ((*files)[1].instance, 0);
}

TEST(QueueFiles, AProcessThatIsNotThereIsAnError) {
  const auto files = find_queue_files(1 << 30);
  ASSERT_FALSE(files);
  EXPECT_EQ(files.error().code, ErrorCode::kNotFound);
}

TEST(QueueFiles, ADescriptorOfAProcessThatIsNotThereIsAnError) {
  const auto fd = take_descriptor(1 << 30, 0);
  ASSERT_FALSE(fd);
  EXPECT_EQ(fd.error().code, ErrorCode::kNotFound);
}

TEST(QueueFiles, ADescriptorOfOurOwnIsTaken) {
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  const auto copy = take_descriptor(getpid(), pipe_ends[1]);
  if (!copy && copy.error().code == ErrorCode::kPermission)
    GTEST_SKIP() << copy.error().to_string();
  ASSERT_TRUE(copy) << copy.error().to_string();
  char byte = 'x';
  EXPECT_EQ(write(copy->get(), &byte, 1), 1);
  EXPECT_EQ(read(pipe_ends[0], &byte, 1), 1);
  close(pipe_ends[0]);
  close(pipe_ends[1]);
}

}  // namespace
}  // namespace xauto::kernel
