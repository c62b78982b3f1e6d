// SPDX-License-Identifier: Apache-2.0
// Quantiles: exact for few values, within 1/64 for many; what cannot be is refused.
#include "session/distribution.h"

#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

TEST(Distribution, EveryValueLiesInItsBucketAndBucketsAreNarrow) {
  std::int64_t value = 0;
  for (std::uint32_t last = 0; value < std::int64_t{1} << 61; value += 1 + value / 97) {
    const std::uint32_t bucket = Distribution::bucket_of(value);
    EXPECT_GE(bucket, last);
    last = bucket;
    const std::int64_t end = Distribution::end_of(bucket);
    EXPECT_GE(end, value);
    EXPECT_LE(end - value, value / 64);
    EXPECT_EQ(Distribution::bucket_of(end), bucket);
    EXPECT_EQ(Distribution::bucket_of(end + 1), bucket + 1);
  }
}

TEST(Distribution, IsExactForFewAndCloseForMany) {
  std::mt19937_64 random(1);
  std::lognormal_distribution<double> values(8, 1);
  Distribution d;
  std::vector<std::int64_t> all;
  const auto check = [&](double slack) {
    std::vector<std::int64_t> sorted = all;
    std::sort(sorted.begin(), sorted.end());
    for (const double q : {0.001, 0.5, 0.99, 0.999, 1.0}) {
      const auto rank = static_cast<std::size_t>(std::ceil(q * static_cast<double>(all.size())));
      const auto exact = static_cast<double>(sorted[std::max<std::size_t>(rank, 1) - 1]);
      EXPECT_GE(static_cast<double>(d.quantile(q)), exact);
      EXPECT_LE(static_cast<double>(d.quantile(q)), exact * (1 + slack));
    }
    EXPECT_EQ(d.max(), sorted.back());
    EXPECT_EQ(d.count(), all.size());
  };
  EXPECT_EQ(d.quantile(0.5), 0);
  for (int i = 0; i < 200'000; ++i) {
    all.push_back(static_cast<std::int64_t>(values(random)));
    d.add(all.back());
    if (i == 1000) check(0);
  }
  EXPECT_TRUE(d.exact().empty());
  check(1.0 / 64);
}

TEST(Distribution, MergesAndTravels) {
  Distribution few, many, both;
  for (std::int64_t i = 0; i < 100; ++i) few.add(i);
  for (std::int64_t i = 0; i < 70'000; ++i) many.add(1000 + i);
  both.merge(few);
  both.merge(many);
  EXPECT_EQ(both.count(), 70'100u);
  EXPECT_EQ(both.max(), 70'999);
  EXPECT_EQ(both.quantile(0.0001), 7);
  Distribution arrived;
  ASSERT_TRUE(Distribution::restore(both.exact(), both.buckets(), both.sum(), both.max(), arrived));
  EXPECT_EQ(arrived.count(), both.count());
  EXPECT_EQ(arrived.quantile(0.9), both.quantile(0.9));
  EXPECT_FALSE(Distribution::restore({1}, {{1, 1}}, 2, 1, arrived));
  EXPECT_FALSE(Distribution::restore({}, {{100'000, 1}}, 1, 1, arrived));
}

}  // namespace
}  // namespace xauto::runtime
