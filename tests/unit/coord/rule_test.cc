// SPDX-License-Identifier: Apache-2.0
// The rule, against its definition: a strict total order, and a choice that every order of asking
// leads to.
#include "coord/rule.h"

#include <algorithm>
#include <vector>

#include <gtest/gtest.h>

namespace xauto::coord {
namespace {

std::vector<Claim> all_claims() {
  std::vector<Claim> claims;
  for (const Key key : {INT64_MIN, std::int64_t{-1}, std::int64_t{0}, INT64_MAX})
    for (const std::uint64_t since : {std::uint64_t{0}, std::uint64_t{7}, UINT64_MAX})
      for (const int slot : {0, 1, 63}) claims.push_back({key, since, slot});
  return claims;
}

TEST(Rule, IsAStrictTotalOrder) {
  const std::vector<Claim> claims = all_claims();
  for (const Claim& a : claims) {
    EXPECT_FALSE(more_urgent(a, a));
    for (const Claim& b : claims) {
      EXPECT_EQ(more_urgent(a, b) != more_urgent(b, a), !(a == b));
      EXPECT_TRUE(more_urgent(a, b) || !takes(a, b)) << "who takes is more urgent";
      for (const Claim& c : claims)
        EXPECT_TRUE(more_urgent(a, c) || !more_urgent(a, b) || !more_urgent(b, c));
    }
  }
}

TEST(Rule, KeyThenWhoAskedFirst) {
  EXPECT_TRUE(more_urgent({1, 9, 9}, {2, 0, 0}));
  EXPECT_TRUE(more_urgent({1, 3, 9}, {1, 4, 0}));
  EXPECT_TRUE(more_urgent({1, 3, 0}, {1, 3, 1}));
  EXPECT_FALSE(takes({1, 3, 0}, {1, 4, 1})) << "being as urgent is no reason to suspend anybody";
}

TEST(Rule, NextIsTheSameWhateverTheOrderOfAsking) {
  std::vector<Claim> claims = {{3, 5, 0}, {1, 5, 1}, {1, 4, 2}, {2, 1, 3}};
  std::sort(claims.begin(), claims.end(), [](auto& a, auto& b) { return a.slot < b.slot; });
  do {
    Next next;
    EXPECT_EQ(next.slot(), -1);
    for (std::size_t i = 0; i < claims.size(); ++i) {
      next.consider(claims[i]);
      EXPECT_EQ(next.more(), i > 0);
    }
    EXPECT_EQ(next.slot(), 2);
  } while (std::next_permutation(claims.begin(), claims.end(),
                                 [](auto& a, auto& b) { return a.slot < b.slot; }));
}

TEST(Rule, OrderHoldsUntilEveryPredecessorOfTheActivationIsOver) {
  const Order order({{4, 1}, {2, 1}, {2, 3}});
  std::vector<std::uint64_t> over(5, 0);
  const auto eligible = [&](std::uint32_t xnode, std::uint64_t sequence) {
    return order.eligible(xnode, sequence, [&](std::uint32_t u) { return over[u]; });
  };
  EXPECT_TRUE(eligible(0, 9));
  EXPECT_TRUE(eligible(4, 9));
  EXPECT_TRUE(eligible(1000, 9)) << "beyond what any pair names";
  EXPECT_FALSE(eligible(1, 0));
  over[4] = 1;
  EXPECT_FALSE(eligible(1, 0));
  over[2] = 1;
  EXPECT_TRUE(eligible(1, 0));
  EXPECT_FALSE(eligible(1, 1));
  EXPECT_TRUE(eligible(3, 0));
  EXPECT_TRUE(order.tracks(4));
  EXPECT_FALSE(order.tracks(1));
  EXPECT_FALSE(order.tracks(1000));
  EXPECT_EQ(order.predecessors(), (std::vector<std::uint32_t>{4, 2}));
}

}  // namespace
}  // namespace xauto::coord
