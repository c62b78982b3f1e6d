// SPDX-License-Identifier: Apache-2.0
#include "processes/board.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>

#include "base/memory_file.h"
#include "session/distribution.h"

namespace xauto::runtime {
namespace {

UniqueFd read_only(int fd) {
  return UniqueFd(open(("/proc/self/fd/" + std::to_string(fd)).c_str(), O_RDONLY | O_CLOEXEC));
}

TEST(Board, IsReadByOneWhoCannotWriteIt) {
  UniqueFd fd = private_memfd("board", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  ASSERT_TRUE(fd);
  EXPECT_EQ(Board::observe(read_only(fd.get()).get()).error().code, ErrorCode::kUnavailable);
  const int given = fd.get();
  const auto board = Board::create({3, 2, 5, 4}, fd);
  ASSERT_TRUE(board);
  EXPECT_EQ(fd.get(), given);
  name_line((*board)->module(1).name, "fusion");
  name_line((*board)->flow(3).name, std::string(500, 'x'));
  (*board)->module(1).dropped.store(7);
  (*board)->count_release();
  for (const std::int64_t us : {5, 1'000'000, 3, -1}) (*board)->flow(3).add(us);

  const auto seen = Board::observe(read_only(fd.get()).get());
  ASSERT_TRUE(seen);
  EXPECT_EQ((*seen)->shape().modules, 2u);
  EXPECT_EQ((*seen)->shape().flows, 4u);
  EXPECT_EQ(line_name((*seen)->module(0).name), "");
  EXPECT_EQ(line_name((*seen)->module(1).name), "fusion");
  EXPECT_EQ(line_name((*seen)->flow(3).name), std::string(kBoardNameBytes - 1, 'x'));
  EXPECT_EQ((*seen)->module(1).dropped.load(), 7u);
  EXPECT_EQ((*seen)->released(), 1u);
  EXPECT_EQ((*seen)->flow(3).results.load(), 4u);
  EXPECT_EQ((*seen)->flow(3).latency_us[Distribution::bucket_of(1'000'000)].load(), 1u);
  EXPECT_EQ((*seen)->flow(2).results.load(), 0u);
  EXPECT_EQ((*seen)->flow(3).last_us.load(), -1);
  EXPECT_EQ((*seen)->flow(3).longest_us.load(), 1'000'000);
  EXPECT_EQ((*seen)->flow(2).longest_us.load(), -1);
  for (const std::int64_t ns : {5, 7, 6}) (*board)->count_late(ns);
  EXPECT_EQ((*seen)->late(), 3u);
  EXPECT_EQ((*seen)->latest_ns(), 7);
  EXPECT_EQ((*seen)->unkept(), "");
  (*board)->tell_unkept(std::string(5'000, 'u'));
  EXPECT_EQ((*seen)->unkept(), std::string(kBoardTextBytes - 1, 'u'));
}

TEST(Board, OfAnotherShapeIsRefused) {
  UniqueFd fd;
  ASSERT_TRUE(Board::create({2, 2, 2, 2}, fd));
  EXPECT_TRUE(Board::map(fd.get(), {2, 2, 2, 2}));
  EXPECT_FALSE(Board::map(fd.get(), {2, 2, 2, 1}));
  EXPECT_FALSE(Board::map(fd.get(), {2, 2, 2, 3}));
}

TEST(Board, MemoryThatCouldShrinkIsNotLookedAt) {
  const UniqueFd fd = private_memfd("board", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  ASSERT_TRUE(write_memory_file(fd.get(), std::string(1 << 16, 'x')));
  EXPECT_FALSE(Board::observe(fd.get()));
}

}  // namespace
}  // namespace xauto::runtime
