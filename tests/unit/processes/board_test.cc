// SPDX-License-Identifier: Apache-2.0
#include "processes/board.h"

#include <atomic>
#include <thread>
#include <tuple>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>

#include "base/memory_file.h"
#include "session/distribution.h"

namespace xauto::runtime {
namespace {

TEST(Board, IsReadByOneWhoCannotWriteIt) {
  UniqueFd fd = private_memfd("board", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  ASSERT_TRUE(fd);
  EXPECT_EQ(Board::observe(read_only(fd.get())->get()).error().code, ErrorCode::kUnavailable);
  const int given = fd.get();
  const auto board = Board::create({3, 2, 5, 4}, fd);
  ASSERT_TRUE(board);
  EXPECT_EQ(fd.get(), given);
  name_line((*board)->module(1).name, "fusion");
  name_line((*board)->flow(3).name, std::string(500, 'x'));
  (*board)->module(1).dropped.store(7);
  (*board)->count_release();
  for (const std::int64_t us : {5, 1'000'000, 3, -1}) (*board)->flow(3).add(us, 7);

  // Names may still be missing: nobody is shown half of them.
  EXPECT_EQ(Board::observe(read_only(fd.get())->get()).error().code, ErrorCode::kUnavailable);
  EXPECT_EQ(Board::steer(fd.get()).error().code, ErrorCode::kUnavailable);
  EXPECT_TRUE(Board::map(fd.get(), {3, 2, 5, 4}));  // a member is there before
  (*board)->open_to_observers();
  const auto seen = Board::observe(read_only(fd.get())->get());
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
  EXPECT_EQ((*seen)->header().early.load(), 0u);
  (*board)->count_late(1, true);
  EXPECT_EQ((*seen)->late(), 4u);
  EXPECT_EQ((*seen)->header().early.load(), 1u);
  EXPECT_EQ((*seen)->unkept(), "");
  (*board)->tell_unkept(std::string(5'000, 'u'));
  EXPECT_EQ((*seen)->unkept(), std::string(kBoardTextBytes - 1, 'u'));
}

TEST(Board, WhatWasNearestToTheClaimOfAChangeIsKept) {
  SpannedLine line;
  EXPECT_FALSE(line.read());
  line.take({0, 1, 0, -1, 100, 100});  // nothing met the change
  EXPECT_FALSE(line.read());
  line.take({0, 1, 0, 900, 0, 0});
  EXPECT_EQ(line.read()->us, 900) << "nothing is claimed of it, but there is no other";
  line.take({0, 1, 0, 800, 0, 0});
  EXPECT_EQ(line.read()->us, 900);
  line.take({1, 2, 3, 40, 100, 102});
  EXPECT_EQ(line.read()->us, 40) << "something is claimed of this one";
  line.take({2, 0, 0, 5'000, 0, 0});
  line.take({2, 0, 0, 399, 1'000, 1'020});
  EXPECT_EQ(line.read()->us, 40) << "0.40 is nearer than 0.399";
  EXPECT_FALSE(line.read()->exceeds());
  line.take({2, 0, 4, 103, 100, 102});
  const auto worst = line.read();
  ASSERT_TRUE(worst);
  EXPECT_EQ(std::tuple(worst->from, worst->to, worst->flow, worst->us, worst->worst_case_us),
            std::tuple(2u, 0u, 4u, std::int64_t{103}, std::int64_t{100}));
  EXPECT_TRUE(worst->exceeds());
}

TEST(Board, WhatMetAChangeIsOfOneReleaseWhoeverReadsIt) {
  SpannedLine line;
  std::atomic<bool> over{false};
  std::thread writer([&] {
    for (std::uint32_t n = 1; n <= 200'000; ++n) {  // each nearer than the one before
      const std::int64_t us = n;
      line.take({n, n, n, us, 1'000'000, us});
    }
    over = true;
  });
  std::uint32_t torn = 0, last = 0;
  while (!over)
    if (const auto one = line.read()) {
      const std::int64_t us = one->us;
      torn += one->from != us || one->to != us || one->flow != us || one->allowed_us != us ? 1 : 0;
      EXPECT_GE(one->flow, last);
      last = one->flow;
    }
  writer.join();
  EXPECT_EQ(torn, 0u);
  EXPECT_EQ(line.read()->us, 200'000);
}

TEST(Board, AFlowTellsWhenTheLastResultWasInTime) {
  const auto board = Board::local({1, 0, 0, 3, 0, 0, 1});
  FlowLine& claims = board->flow(1);
  claims.worst_case_us = 100;
  claims.allowed_us = 102;
  EXPECT_EQ(claims.limit_us(), 102);
  claims.add(150, 1'000);  // the first one: from here on nothing was in time
  EXPECT_EQ(claims.in_time_ns.load(), 1'000);
  claims.add(102, 2'000);
  claims.add(103, 3'000);
  EXPECT_EQ(claims.in_time_ns.load(), 2'000);
  EXPECT_EQ(claims.last_ns.load(), 3'000);
  EXPECT_EQ(claims.sum_us.load(), 150 + 102 + 103);
  FlowLine& promises = board->flow(2);
  promises.allowed_us = 100;
  promises.deadline_us = 50;
  EXPECT_EQ(promises.limit_us(), 50);
  promises.add(50, 1'000);
  promises.add(51, 2'000);
  EXPECT_EQ(promises.in_time_ns.load(), 1'000);
  EXPECT_EQ(promises.over.load(), 0u);
  FlowLine& neither = board->flow(0);
  neither.add(1'000'000, 1'000);
  EXPECT_EQ(neither.in_time_ns.load(), 0);
  EXPECT_EQ(neither.over.load(), 0u);
}

TEST(Board, NamesAreUtf8WhateverIsThere) {
  const auto board = Board::local({1, 1});
  std::string name(kBoardNameBytes - 2, 'x');
  name_line(board->module(0).name, name + "\xc3\xb6");  // cut within the character
  EXPECT_EQ(line_name(board->module(0).name), name + "?");
}

TEST(Board, NamesDoNotPaintTheTerminalOfWhoLooks) {
  const auto board = Board::local({1, 1});
  name_line(board->module(0).name, "\x1b[31mred\n\xc2\x9b");  // C1's "CSI" as UTF-8
  EXPECT_EQ(line_name(board->module(0).name), "\\x1b[31mred\\x0a\\xc2\\x9b");
}

TEST(Board, OfAnotherShapeIsRefused) {
  UniqueFd fd;
  ASSERT_TRUE(Board::create({2, 2, 2, 2}, fd));
  EXPECT_TRUE(Board::map(fd.get(), {2, 2, 2, 2}));
  EXPECT_FALSE(Board::map(fd.get(), {2, 2, 2, 1}));
  EXPECT_FALSE(Board::map(fd.get(), {2, 2, 2, 3}));
  EXPECT_FALSE(Board::map(fd.get(), {2, 2, 2, 2, 0, 0, 1}));
}

TEST(Board, MemoryThatCouldShrinkIsNotLookedAt) {
  const UniqueFd fd = private_memfd("board", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  ASSERT_TRUE(write_memory_file(fd.get(), std::string(1 << 16, 'x')));
  EXPECT_FALSE(Board::observe(fd.get()));
}

TEST(Board, AReleaseKeepsItsTableThroughManyChanges) {
  const auto board = Board::local({1, 1});
  ASSERT_TRUE(board);
  for (std::uint32_t k = 0; k < 40; ++k) board->put_table(k == 0 ? 0 : 100 * k, k % 7);
  for (std::uint32_t k = 8; k < 40; ++k) {  // 32 are known
    EXPECT_EQ(board->table_of(100 * k), k % 7) << k;
    EXPECT_EQ(board->table_of(100 * k + 99), k % 7) << k;
  }
}

}  // namespace
}  // namespace xauto::runtime
