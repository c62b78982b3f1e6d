// SPDX-License-Identifier: Apache-2.0
// How the tool says times, and why a status is 1.
#include "xauto/command.h"

#include <gtest/gtest.h>

namespace xauto::cli {
namespace {

TEST(Words, ATimeBelowAMillisecondIsNotRoundedToNothing) {
  EXPECT_EQ(ms(0), "0.000 ms");
  EXPECT_EQ(ms(4), "0.004 ms");
  EXPECT_EQ(ms(999), "0.999 ms");
  EXPECT_EQ(ms(-7), "-0.007 ms");
  EXPECT_EQ(ms(1000), "1.00 ms");
  EXPECT_EQ(ms(12'344), "12.34 ms");
}

TEST(Words, WhatIsMissedIsNamed) {
  EXPECT_EQ(words_of_missed({}), "");
  EXPECT_EQ(words_of_missed({"a: 2 ms of 1 ms", "b"}),
            "But it misses what was asked for, so the exit status is 1: a: 2 ms of 1 ms; b.\n");
  EXPECT_EQ(words_of_missed({"a", "b", "c", "d", "e"}),
            "But it misses what was asked for, so the exit status is 1: a; b; c; 2 more.\n");
}

}  // namespace
}  // namespace xauto::cli
