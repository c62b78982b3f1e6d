// SPDX-License-Identifier: Apache-2.0
#include "session/limits.h"

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

TEST(Limits, ComeFromTheWcetOrAreSaid) {
  Deployment d;
  d.defaults.budget_pct = 150;
  d.defaults.hang_pct = 1000;
  d.modules["B"].hang_us = 77;
  d.modules["B"].on_hang = OnHang::kDrop;
  d.budgets_us["a2"] = 5;
  const Limits a1 = Limits::of(d, "A", "a1", 200);
  EXPECT_EQ(a1.budget_ns, 300'000);
  EXPECT_EQ(a1.hang_ns, 2'000'000);
  EXPECT_EQ(a1.on_hang, OnHang::kLog);
  EXPECT_EQ(Limits::of(d, "A", "a2", 200).budget_ns, 5'000);
  EXPECT_EQ(Limits::of(d, "B", "b1", 200).hang_ns, 77'000);
  EXPECT_EQ(Limits::of(d, "B", "b1", 200).on_hang, OnHang::kDrop);
  EXPECT_FALSE(Limits::of({}, "A", "a1", 200).any());
  EXPECT_GT(Limits::of(d, "A", "a1", 1'000'000'000'000).hang_ns, 0);  // no overflow
}

}  // namespace
}  // namespace xauto::runtime
