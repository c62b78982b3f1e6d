// SPDX-License-Identifier: Apache-2.0
// By keys: from which microsecond on a table counts, and whether what asked for it was noticed in time.
// By docs/keys.md, theorem 8: S, what is released before S keeps its table, and S <= t + n.
#include "tables/table_switch.h"

#include <gtest/gtest.h>

#include "processes/board.h"

namespace xauto::runtime {
namespace {

TEST(TableSwitch, TheReleaseThatDecidesHasTheNewTableAtWhateverNanosecondItIs) {
  const auto board = Board::local({1, 1});
  ASSERT_TRUE(board);
  const auto table_at = [&](std::int64_t ns) {
    return board->table_of(static_cast<std::uint64_t>(ns) / 1000);
  };
  board->put_table(0, 1);
  std::int64_t newest_ns = 0;
  std::uint32_t table = 1;
  for (std::int64_t k = 1; k < 20; ++k) {
    const std::int64_t nominal_ns = k * 100'000'000 / 3;  // 30 Hz
    board->put_table(first_us_of_table(nominal_ns, newest_ns), ++table % 2);
    EXPECT_EQ(table_at(nominal_ns), table % 2) << k;
    EXPECT_EQ(table_at(newest_ns), 1 - table % 2) << k << ": what was released keeps its own";
    newest_ns = nominal_ns;
  }
}

TEST(TableSwitch, WhatWasReleasedInTheSameMicrosecondOrLaterKeepsItsTable) {
  EXPECT_EQ(first_us_of_table(5'300, 5'200), 6u);
  EXPECT_EQ(first_us_of_table(5'300, 9'999), 10u);
  EXPECT_EQ(first_us_of_table(5'300, 4'999), 5u);
}

TEST(TableSwitch, AJobMayBeTooLongForTheNoticeBeforeAReleaseWithTheOldTable) {
  // Too long since 1000; the last release with the old table was at 1300.
  EXPECT_TRUE(noticed_in_time(5000, 4000, 1300, 300));
  EXPECT_FALSE(noticed_in_time(5000, 4000, 1301, 300));
  EXPECT_TRUE(noticed_in_time(5000, 4000, 900, 0)) << "nothing was released since";
}

}  // namespace
}  // namespace xauto::runtime
