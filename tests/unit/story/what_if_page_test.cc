// SPDX-License-Identifier: Apache-2.0
#include "story/what_if_page.h"

#include <gtest/gtest.h>

namespace xauto::story {
namespace {

TEST(WhatIfPage, NamesAreTextWhateverTheyAre) {
  const std::string evil = "</p><script>alert('1')</script>\xff";
  WhatIfPage page;
  page.title = page.assumes = evil;
  page.verdict = page.todo = {evil};
  page.chains = {{evil, 3000, {{evil, 2, 1000, -1, 2000, 2500}}}};
  page.loads = {{evil, {{evil, 0.5}}}};
  const std::string html = what_if_html(page);
  EXPECT_EQ(html.find("<script"), std::string::npos);
  EXPECT_EQ(html.find('\xff'), std::string::npos);
  EXPECT_NE(html.find("50.0 %"), std::string::npos);
}

TEST(WhatIfPage, AStripEndsWithTheLongestOfTimesClaimsAndDeadline) {
  WhatIfPage page;
  page.chains = {
      {"chain", 10'000, {{"now", 200, 1000, 3000, 5000}, {"keys", 200, 500, 900, 1000, 2000}}}};
  const std::string html = what_if_html(page);
  // 10 ms and a twentieth are the whole: 1 ms is 9.52 %, 5 ms less 1 is 38.10 %, the deadline is at 95.24 %.
  EXPECT_NE(html.find("x='9.52%' y='8' width='38.10%'"), std::string::npos) << html;
  EXPECT_NE(html.find("class='deadline' x1='95.24%'"), std::string::npos);
  EXPECT_NE(html.find("class='claim' x1='19.05%'"), std::string::npos);
  EXPECT_NE(html.find("p99 3.00"), std::string::npos);
}

}  // namespace
}  // namespace xauto::story
