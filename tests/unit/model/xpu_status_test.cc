// SPDX-License-Identifier: Apache-2.0
#include "model/xpu_status.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(XpuStatus, ComesBackAsItWent) {
  const XpuStatus status{"gpu\"0",
                         42,
                         Discipline::kKernel,
                         true,
                         7,
                         9,
                         {{"a@gpu0", "idle", "", 0, 0, 0, ""},
                          {"b@gpu0", "suspended", "b.infer\n", UINT32_MAX, INT64_MIN, 5, "c.infer"},
                          {"d@gpu0", "running", "d.infer", 3, 0, 5, "", -7}}};
  const auto parsed = Json::parse(to_json(status).dump());
  ASSERT_TRUE(parsed);
  const auto back = parse_xpu_status(*parsed);
  ASSERT_TRUE(back) << back.error().to_string();
  EXPECT_EQ(*back, status);
}

TEST(XpuStatus, WhoeverAnswersIsNotTrusted) {
  for (const char* text :
       {"[]", "{}", R"({"xpu":1,"discipline":"gate"})", R"({"xpu":"g","discipline":"none"})",
        R"({"xpu":"g","discipline":"gate","workers":[{"worker":"w"}]})",
        R"({"xpu":"g","discipline":"gate","workers":["w"]})"})
    EXPECT_FALSE(parse_xpu_status(*Json::parse(text))) << text;
  const auto least =
      parse_xpu_status(*Json::parse(R"({"xpu":"g","discipline":"gate","looks":-3,"workers":{}})"));
  ASSERT_TRUE(least);
  EXPECT_EQ(least->looks, 0u);
}

}  // namespace
}  // namespace xauto
