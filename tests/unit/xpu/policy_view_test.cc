// SPDX-License-Identifier: Apache-2.0
#include "xpu/policy_view.h"

#include <string>

#include <gtest/gtest.h>

namespace xauto::xpu {
namespace {

TEST(PolicyView, ARowIsShownAsItIsAndLongNamesAreCutAndEndedByZero) {
  const xauto_bpf_policy row = shown({.xnode = std::string(60, 'x'),
                                      .xpu = "gpu0",
                                      .by = "key_us",
                                      .keys = 3,
                                      .value = -20,
                                      .xpu_index = 4,
                                      .table = 1});
  EXPECT_EQ(row.xnode, std::string(sizeof row.xnode - 1, 'x'));
  EXPECT_STREQ(row.xpu, "gpu0");
  EXPECT_STREQ(row.by, "key_us");
  EXPECT_EQ(row.keys, 3u);
  EXPECT_EQ(row.value, -20);
  EXPECT_EQ(row.xpu_index, 4u);
  EXPECT_EQ(row.table, 1u);
}

}  // namespace
}  // namespace xauto::xpu
