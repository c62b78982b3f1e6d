// SPDX-License-Identifier: Apache-2.0
// Text in columns: what is too long is cut, and lines end before column 80.
#include "base/columns.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Columns, ACharacterIsOne) {
  EXPECT_EQ(columns_of(""), 0U);
  EXPECT_EQ(columns_of("cpu0"), 4U);
  EXPECT_EQ(columns_of("Größe…"), 6U);
  EXPECT_EQ(columns_of("\xff\xfe"), 2U) << "what is no character";
}

TEST(Columns, WhatIsTooLongIsCut) {
  EXPECT_EQ(cut("planner", 7), "planner");
  EXPECT_EQ(cut("planner", 6), "plann…");
  EXPECT_EQ(cut("Größe", 3), "Gr…");
  EXPECT_EQ(cut("planner", 0), "");
  EXPECT_EQ(left("cpu0", 6), "cpu0  ");
  EXPECT_EQ(left("planner", 6), "plan… ") << "a blank before the next column";
}

TEST(Columns, OfAChainBothEndsStay) {
  EXPECT_EQ(cut("camera -> plan", 14), "camera -> plan");
  EXPECT_EQ(cut("camera/front/raw -> planner.control", 20), "camera/… -> planner…");
  EXPECT_EQ(cut("camera/front/raw -> ctl", 20), "camera/front… -> ctl");
  EXPECT_EQ(cut("imu -> planner.control.steer", 20), "imu -> planner.cont…");
  for (std::size_t columns = 0; columns < 40; ++columns)
    EXPECT_LE(columns_of(cut("camera/front/raw -> planner.control", columns)), columns);
}

TEST(Columns, ANameWithoutRoomHasALineOfItsOwn) {
  EXPECT_EQ(row_of("imu -> plan", 12), "  imu -> plan ");
  EXPECT_EQ(row_of("imu -> plan", 11), "  imu -> plan\n             ");
  EXPECT_EQ(columns_of(row_of(std::string(200, 'x'), 20)), 80U + 1 + 22);
}

TEST(Columns, TimesHaveSixColumns) {
  EXPECT_EQ(ms_in_row(-1), "-");
  EXPECT_EQ(ms_in_row(0), "0.00");
  EXPECT_EQ(ms_in_row(12'344), "12.34");
  for (const std::int64_t us : {999'994, 999'995, 9'999'949, 9'999'950, 999'999'499})
    EXPECT_LE(columns_of(ms_in_row(us)), 6U) << ms_in_row(us);
}

TEST(Columns, LinesEndBeforeColumn80) {
  EXPECT_EQ(wrapped("  short\n  lines\n", 4), "  short\n  lines\n");
  const std::string word(30, 'x'), long_word(100, 'y');
  EXPECT_EQ(wrapped("  " + word + " " + word + " " + word + "\n  z", 4),
            "  " + word + " " + word + "\n    " + word + "\n  z");
  EXPECT_EQ(wrapped("a " + long_word + " b", 2), "a\n  " + long_word + "\n  b");
  EXPECT_EQ(wrapped("", 2), "");
}

}  // namespace
}  // namespace xauto
