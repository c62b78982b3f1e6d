// SPDX-License-Identifier: Apache-2.0
#include "story/timeline.h"

#include <gtest/gtest.h>

namespace xauto::story {
namespace {

TEST(Timeline, HoldsEveryBarAndNeedsNoNetwork) {
  Timeline t{"driving on small", "emulated", {}};
  t.panels.push_back({"xauto",
                      "XAuto",
                      {"cpu0", "gpu0"},
                      1,
                      2,
                      3,
                      {1, 2},
                      0,
                      1,
                      {{0, "fcd.pre", "FCD", 0, 900, BarKind::kRun}}});
  const std::string page = timeline_html(t);
  EXPECT_NE(page.find(R"([0,"fcd.pre","FCD",0,900,0])"), std::string::npos);
  std::size_t at = 0;
  for (; (at = page.find("://", at)) != std::string::npos; ++at)
    EXPECT_EQ(page.substr(at - 4, 26), "http://www.w3.org/2000/svg");
  EXPECT_EQ(page.find("<link"), std::string::npos);
  EXPECT_EQ(page.find(" src="), std::string::npos);
}

TEST(Timeline, NamesCannotLeaveTheirString) {
  Timeline t;
  t.title = "</title><script>alert(1)</script>";
  t.panels.push_back({"x",
                      "</script><script>alert(2)</script>",
                      {"<!--"},
                      0,
                      0,
                      0,
                      {},
                      0,
                      0,
                      {{0, "<img onerror=alert(3)>", "\"];alert(4);//", 0, 1, BarKind::kRun}}});
  const std::string page = timeline_html(t);
  EXPECT_EQ(page.find("<script>alert"), std::string::npos);
  EXPECT_EQ(page.find("<img"), std::string::npos);
  EXPECT_EQ(page.find("<!--"), std::string::npos);
  EXPECT_EQ(page.find("\"\"];alert"), std::string::npos);
  EXPECT_NE(page.find(R"(\"];alert(4);//)"), std::string::npos);
}

TEST(Timeline, WhatWasNotMeasuredIsNoNumber) {
  Timeline t;
  t.panels.emplace_back();
  const std::string page = timeline_html(t);
  for (const char* key : {"p50", "p99", "max"})
    EXPECT_NE(page.find("\"" + std::string(key) + "\":null"), std::string::npos) << key;
  EXPECT_NE(page.find(R"("latencies":[])"), std::string::npos);
}

TEST(Timeline, BrokenUtf8DoesNotBreakThePage) {
  Timeline t;
  t.title = "\xff\xfe";
  EXPECT_NE(timeline_html(t).find("DATA"), std::string::npos);
}

}  // namespace
}  // namespace xauto::story
