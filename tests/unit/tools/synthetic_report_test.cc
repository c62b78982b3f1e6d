// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "bench/synthetic/report.h"

namespace xauto::bench {
namespace {

TEST(GeometricMean, IsTheRootOfTheProduct) {
  EXPECT_NEAR(geometric_mean({2, 8}), 4, 1e-12);
  EXPECT_NEAR(geometric_mean({1, 10, 100}), 10, 1e-9);
  EXPECT_DOUBLE_EQ(geometric_mean({1.7}), 1.7);
  EXPECT_EQ(geometric_mean({}), 0);
}

TEST(GeometricMean, OfInverseRatiosIsTheInverse) {
  // What the arithmetic mean of ratios gets wrong: of {1/2, 2} it says 1.25, whichever way round.
  EXPECT_NEAR(geometric_mean({0.5, 2}), 1, 1e-12);
  EXPECT_NEAR(geometric_mean({1.2, 3.4, 0.9}) * geometric_mean({1 / 1.2, 1 / 3.4, 1 / 0.9}), 1,
              1e-12);
}

TEST(GeometricMean, NeitherOverflowsNorUnderflows) {
  EXPECT_NEAR(geometric_mean(std::vector<double>(1000, 1e10)), 1e10, 1);
  EXPECT_NEAR(geometric_mean(std::vector<double>(1000, 1e-10)), 1e-10, 1e-16);
}

TEST(JsonLine, IsReadAgain) {
  Measured m;
  m.platform = "small";
  m.nodes = 30;
  m.seed = 7;
  m.ros2_slices = 300'000;
  m.xauto = 200'000;
  m.bound = 199'000;
  m.optimal = true;
  m.solve_s = 0.25;
  const auto read = read_line(json_line(m));
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(read->platform, "small");
  EXPECT_EQ(read->nodes, 30);
  EXPECT_EQ(read->seed, 7u);
  EXPECT_EQ(read->ros2_slices, 300'000);
  EXPECT_EQ(read->bound, 199'000);
  EXPECT_TRUE(read->optimal);
  EXPECT_DOUBLE_EQ(read->solve_s, 0.25);
  EXPECT_FALSE(read_line(json_line(m).substr(0, 100)).has_value());  // a run that was cut short
}

}  // namespace
}  // namespace xauto::bench
