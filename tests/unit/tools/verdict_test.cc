// SPDX-License-Identifier: Apache-2.0
// Whom a run that exceeds its claims is sent to: the authors only where nothing whatever explains it.
#include "xauto/verdict.h"

#include <gtest/gtest.h>

namespace xauto::cli {
namespace {

constexpr const char* kReport = "please report this run";

std::string said(const runtime::RunReport& report, std::int64_t by_us) {
  return verdict(true, {}, taken_from(report, by_us));
}

TEST(Verdict, AsksForAReportOnlyWhereNothingExplainsIt) {
  runtime::RunReport report;
  EXPECT_NE(said(report, 500).find(kReport), std::string::npos);
  report.taken = {{"little", 40}, {"the thread 'x' waited", 28'000}};
  EXPECT_EQ(said(report, 30'000),
            "exceeded; the app broke nothing that is watched, but: the thread 'x' waited");
  report.taken = {{"little", 40}};
  EXPECT_NE(said(report, 30'000).find(kReport), std::string::npos) << "40 us do not explain 30 ms";
  EXPECT_EQ(said(report, 30).find(kReport), std::string::npos) << "they explain 30 us";
  report.not_watched = "/proc is not there";
  EXPECT_EQ(said(report, 30'000).find(kReport), std::string::npos);
  EXPECT_NE(said(report, 30'000).find("is not watched here (/proc is not there)"),
            std::string::npos);
}

TEST(Verdict, KeptIsKeptAndWhatIsBrokenGoesBeforeAll) {
  EXPECT_EQ(verdict(false, {}, {"waited"}), "kept, as far as it is watched");
  EXPECT_EQ(verdict(false, {"a"}, {}), "not claimed here: a");
  EXPECT_EQ(verdict(true, {"a", "b"}, {"waited"}), "exceeded, and not claimed here: a; b");
  EXPECT_EQ(verdict(true, {"a", "b"}, {}, Layout::kList),
            "exceeded, and not claimed here:\n    - a\n    - b");
}

}  // namespace
}  // namespace xauto::cli
