// SPDX-License-Identifier: Apache-2.0
#include "model/period.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Period, OfARateIsExact) {
  EXPECT_EQ(Period::of_rate("30").value(), (Period{100'000, 3}));
  EXPECT_EQ(Period::of_rate("30.000").value(), (Period{100'000, 3}));
  EXPECT_EQ(Period::of_rate("30000/1001").value(), (Period{100'100, 3}));
  EXPECT_EQ(Period::of_rate("29.97").value(), (Period{100'000'000, 2997}));
  EXPECT_EQ(Period::of_rate("59.94/2").value(), Period::of_rate("29.97").value());
  EXPECT_EQ(Period::of_rate("10").value(), (Period{100'000, 1}));
  EXPECT_EQ(Period::of_rate("1000000").value(), (Period{1, 1}));
  EXPECT_EQ(Period::of_rate("1/3600").value(), (Period{kMaxPeriodUs, 1}));
}

TEST(Period, WhatIsNoRateIsRefused) {
  for (const char* text : {"",
                           ".",
                           "-1",
                           "+1",
                           "1e3",
                           "0",
                           "0.0",
                           "1/0",
                           "1/",
                           "/1",
                           "1/2/3",
                           "1 ",
                           " 1",
                           ".5",
                           "5.",
                           "1..2",
                           "nan",
                           "1234567890123456",
                           "1000000.1",
                           "1/3600.1",
                           "0.00027",
                           "999999999999999/0.99999999999999",
                           "0.00000000000001/999999999999999",
                           "999999999999999/0.00000000000001"})
    EXPECT_FALSE(Period::of_rate(text)) << text;
  // Numerator and denominator of 30 digits.
  EXPECT_FALSE(Period::of_rate("1.99999999999999/1.00000000000003"));
  EXPECT_NE(Period::of_rate("29.9999991").error().what.find("denominator"), std::string::npos);
}

TEST(Period, ItsRateComesBackAsThePeriod) {
  for (const Period period : {Period{100'000, 3}, Period{100'100, 3}, Period{1, 1},
                              Period{kMaxPeriodUs, 1}, Period{1'000'003, kMaxPeriodDen}}) {
    ASSERT_TRUE(period.valid());
    EXPECT_EQ(Period::of_rate(period.rate()).value(), period) << period.rate();
  }
  EXPECT_EQ((Period{100'000, 3}).text(), "30 Hz");
  EXPECT_EQ((Period{33'333, 1}).text(), "33333 us");
}

TEST(Period, OrderIsThatOfTheTimes) {
  EXPECT_LT((Period{33'333, 1}), (Period{100'000, 3}));
  EXPECT_LT((Period{100'000, 3}), (Period{33'334, 1}));
  EXPECT_LT((Period{kMaxPeriodUs * kMaxPeriodDen - 1, kMaxPeriodDen}), (Period{kMaxPeriodUs, 1}));
}

TEST(Period, OnlyLowestTermsInRangeAreValid) {
  EXPECT_TRUE((Period{100'000, 3}).valid());
  for (const Period period :
       {Period{200'000, 6}, Period{0, 1}, Period{1, 2}, Period{1, 0}, Period{-1, -1},
        Period{kMaxPeriodUs + 1, 1}, Period{kMaxPeriodDen + 2, kMaxPeriodDen + 1}}) {
    EXPECT_FALSE(period.valid()) << period.num << "/" << period.den;
    EXPECT_FALSE(period.text().empty());
  }
}

}  // namespace
}  // namespace xauto
