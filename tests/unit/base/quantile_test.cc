// SPDX-License-Identifier: Apache-2.0
#include "base/quantile.h"

#include <vector>

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Quantile, IsTheSmallestValueThatEnoughOthersDoNotExceed) {
  for (std::uint64_t count = 1; count <= 300; ++count) {
    std::vector<std::int64_t> sorted;
    for (std::uint64_t i = 0; i < count; ++i) sorted.push_back(static_cast<std::int64_t>(7 * i));
    for (const double q : {0.0, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0}) {
      // By the definition, without a formula.
      std::uint64_t rank = 1;
      while (static_cast<double>(rank) < q * static_cast<double>(count)) ++rank;
      EXPECT_EQ(nearest_rank(q, count), rank) << q << " of " << count;
      EXPECT_EQ(quantile_of_sorted(sorted, q), sorted[rank - 1]);
    }
  }
}

TEST(Quantile, OfNothingIsNothing) {
  EXPECT_EQ(quantile_of_sorted({}, 0.5), 0);
}

TEST(Quantile, StaysInsideForAQOutside) {
  EXPECT_EQ(nearest_rank(-1, 5), 1u);
  EXPECT_EQ(nearest_rank(2, 5), 5u);
}

}  // namespace
}  // namespace xauto
