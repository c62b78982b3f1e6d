// SPDX-License-Identifier: Apache-2.0
#include "base/number.h"

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Number, WhatIsWrittenReadsBack) {
  std::mt19937_64 rng(1);
  for (int i = 0; i < 5000; ++i) {
    const double value = real_of_bits(rng());
    if (!std::isfinite(value)) continue;
    ASSERT_EQ(real_of(text_of(value)), value) << text_of(value);
    const std::string plain = decimal_of(value);
    ASSERT_LT(plain.size(), 64u);
    if (!plain.empty()) {
      ASSERT_EQ(real_of(plain), value) << plain;
      ASSERT_EQ(plain.find_first_not_of("-.0123456789"), plain.npos) << plain;
    }
  }
}

TEST(Number, IsAsShortAsCanBe) {
  EXPECT_EQ(text_of(0.1), "0.1");
  EXPECT_EQ(text_of(30), "30");
  EXPECT_EQ(text_of(-2.5e-9), "-2.5e-09");
  EXPECT_EQ(decimal_of(29.97), "29.97");
  EXPECT_EQ(decimal_of(1e-9), "0.000000001");
  EXPECT_EQ(decimal_of(1e15), "1000000000000000");
  EXPECT_EQ(decimal_of(1e-300), "");
  EXPECT_EQ(decimal_of(std::numeric_limits<double>::max()), "");
}

TEST(Number, NothingElseIsANumber) {
  for (const char* text : {"", " 1", "1 ", "+1", "1,5", "0x10", "1e", "--1", "1.5.2", "one"})
    EXPECT_FALSE(real_of(text)) << '"' << text << '"';
  EXPECT_EQ(real_of("-1.5e3"), -1500);
  EXPECT_EQ(real_of(".5"), 0.5);
}

}  // namespace
}  // namespace xauto
