// SPDX-License-Identifier: Apache-2.0
#include "model/asked.h"

#include <algorithm>

#include <gtest/gtest.h>

#include <xauto/rate.h>

#include "model/json.h"
#include "model/periodic.h"

namespace xauto {
namespace {

using namespace literals;

/// What `profile` made of a program: camera -> a -> b, lidar -> c.
AppSpec fresh_app() {
  return parse_app(R"({"schema": "xauto.app", "version": 3, "name": "p",
    "sources": [{"name": "camera", "rate_hz": 30, "jitter_us": 300}, {"name": "lidar", "period_us": 100000, "jitter_us": 300}],
    "xnodes": [{"name": "a", "module": "m", "source": "camera", "wcet_us": {"cpu": 10}},
               {"name": "b", "module": "m", "wcet_us": {"cpu": 20}},
               {"name": "c", "module": "n", "source": "lidar", "wcet_us": {"cpu": 30}}],
    "edges": [["a", "b"]]})",
                   "fresh")
      .value();
}

struct Kept {
  AppSpec app;
  std::string text;
  std::vector<std::string> lines;
  [[nodiscard]] bool says(const std::string& part) const {
    return std::any_of(lines.begin(), lines.end(), [&](const std::string& line) {
      return line.find(part) != std::string::npos;
    });
  }
};
Kept keep(const std::string& old) {
  Kept kept;
  auto text = with_what_was_asked(fresh_app(), old, "app.json", kept.lines);
  EXPECT_TRUE(text) << text.error().to_string();
  if (!text) return kept;
  kept.text = *text;
  auto app = parse_app(*text, "app.json");
  EXPECT_TRUE(app) << app.error().to_string();
  if (app) kept.app = *app;
  return kept;
}

std::string old_app(const std::string& sources, const std::string& more = "",
                    const std::string& last = "c") {
  return R"({"schema": "xauto.app", "version": 3, "name": "p", "sources": [)" + sources + R"(],
    "xnodes": [{"name": "a", "module": "m", "source": "camera", "wcet_us": {"cpu": 99}},
               {"name": "b", "module": "m", "wcet_us": {"cpu": 99}},
               {"name": ")" +
         last + R"(", "module": "n", "source": "lidar", "wcet_us": {"cpu": 99}}],
    "edges": [["a", "b"]])" +
         more + "}";
}
const char* const kSources =
    R"({"name": "camera", "rate_hz": 30}, {"name": "lidar", "period_us": 100000})";

TEST(Asked, WcetsAreThoseThatWereMeasured) {
  const Kept kept = keep(old_app(kSources));
  EXPECT_EQ(kept.app.xnodes[0].wcet_on("cpu"), 10);
  EXPECT_EQ(kept.app.xnodes[2].wcet_on("cpu"), 30);
}

TEST(Asked, WhatSourcesAreToldStays) {
  const Kept kept = keep(old_app(
      R"({"name": "camera", "rate_hz": 60, "jitter_us": 900, "clock": "cam", "offset_us": 5}, {"name": "lidar", "period_us": 100000, "jitter_us": 1})",
      R"(, "clocks": [{"name": "cam", "ppm": 20}])"));
  const SourceSpec& camera = kept.app.sources[0];
  EXPECT_EQ(camera.period, Period::of_rate("60").value());
  EXPECT_EQ(camera.jitter_us, 900);
  EXPECT_EQ(camera.offset_us, 5);
  EXPECT_EQ(kept.app.clocks[static_cast<std::size_t>(camera.clock)].name, "cam");
  EXPECT_EQ(kept.app.sources[1].jitter_us, 300) << "the larger one: it was seen";
  EXPECT_TRUE(kept.says("source 'camera': 60 Hz") || kept.says("source 'camera': 16666"))
      << kept.lines[0];
  EXPECT_TRUE(kept.says("jitter_us 900"));
}

TEST(Asked, ChainsWithDeadlinesStayAndNewEndsGetOne) {
  const std::string chains =
      R"(, "chains": [{"name": "see", "from": "camera", "to": "b", "deadline_us": 50000, "weight": 3}])";
  const Kept kept = keep(old_app(kSources, chains));
  ASSERT_EQ(kept.app.chains.size(), 1u) << "the one to c was left out by hand";
  EXPECT_EQ(kept.app.chains[0].name, "see");
  EXPECT_EQ(kept.app.chains[0].deadline_us, 50000);
  EXPECT_EQ(kept.app.chains[0].weight, 3);
  EXPECT_TRUE(kept.says("not asked for"));

  const Kept grown = keep(old_app(kSources, chains, "gone"));  // c is new
  ASSERT_EQ(grown.app.chains.size(), 2u);
  EXPECT_EQ(grown.app.xnodes[static_cast<std::size_t>(grown.app.chains[1].to)].name, "c");
}

TEST(Asked, WhatTheSolverAloneReadsStaysWhereItFits) {
  const Kept kept = keep(old_app(
      kSources,
      R"(, "pins": [{"xnode": "a", "xpu": "cpu0"}, {"xnode": "gone", "xpu": "cpu0"}], "groups": [["a", "b"], ["gone", "c"]])",
      "gone"));
  EXPECT_NE(kept.text.find("\"pins\""), std::string::npos);
  EXPECT_NE(kept.text.find("\"groups\""), std::string::npos);
  EXPECT_EQ(kept.text.find("gone"), std::string::npos);
  EXPECT_TRUE(kept.says("left: an entry of \"pins\""));
  EXPECT_TRUE(kept.says("left: an entry of \"groups\""));
}

TEST(Asked, WhatATraceShowedIsNotOfTheProfile) {
  const Kept kept =
      keep(old_app(R"({"name": "camera", "rate_hz": 30}, {"name": "lidar", "period_us": 100000})",
                   R"(, "todo": [{"what": "w"}])"));
  EXPECT_TRUE(kept.says("\"todo\""));
  EXPECT_EQ(kept.text.find("todo"), std::string::npos);
}

TEST(Asked, AnotherAppsFileIsNotMixedIn) {
  std::string other = old_app(kSources);
  other.replace(other.find("\"p\""), 3, "\"q\"");
  const Kept kept = keep(other);
  EXPECT_EQ(kept.app, fresh_app());
  EXPECT_TRUE(kept.says("left: all of app 'q'"));
}

TEST(Asked, WhatIsNoAppIsNotOverwritten) {
  std::vector<std::string> lines;
  EXPECT_FALSE(with_what_was_asked(fresh_app(), "{}", "app.json", lines));
  EXPECT_FALSE(with_what_was_asked(fresh_app(), "", "app.json", lines));
}

// By hand: n / 10^k Hz.
TEST(Rates, AreExact) {
  constexpr Rate thirty = 30_hz, ntsc = 29.97_hz, thousand = 1'000_hz;
  static_assert(thirty.num == 30 && thirty.den == 1);
  static_assert(ntsc.num == 2997 && ntsc.den == 100);
  static_assert(thousand.num == 1000 && thousand.den == 1);
}

TEST(Asked, TheFilesDeadlineGoesBeforeTheProgramsWhichFillsIn) {
  AppSpec fresh = fresh_app();
  for (ChainSpec& chain : fresh.chains) chain.deadline_us = 40'000;
  std::vector<std::string> lines;
  const std::string old = old_app(
      kSources,
      R"(, "chains": [{"name": "see", "from": "camera", "to": "b", "deadline_us": 50000}, {"name": "feel", "from": "lidar", "to": "c"}])");
  const auto app =
      parse_app(with_what_was_asked(fresh, old, "app.json", lines).value(), "app.json");
  ASSERT_TRUE(app);
  EXPECT_EQ(app->chains[0].deadline_us, 50'000);
  EXPECT_EQ(app->chains[1].deadline_us, 40'000);
  EXPECT_EQ(std::count(lines.begin(), lines.end(),
                       "kept: the deadline of chain 'see': 50000 us (the program says 40000)"),
            1);
}

TEST(Asked, RatesOrNoneAreTheFilesAndOfAllSources) {
  const char* const without = R"({"name": "camera"}, {"name": "lidar"})";
  const Kept none = keep(old_app(without));
  EXPECT_TRUE(none.app.one_at_a_time);
  EXPECT_TRUE(none.says("kept: no source has a rate (the program gives rates)"));

  AppSpec fresh = parse_app(old_app(without), "fresh").value();
  std::vector<std::string> lines;
  const auto rates = parse_app(
      with_what_was_asked(fresh, old_app(kSources), "app.json", lines).value(), "app.json");
  ASSERT_TRUE(rates) << rates.error().to_string();
  EXPECT_FALSE(rates->one_at_a_time);
  EXPECT_EQ(rates->sources[1].period, parse_app(old_app(kSources), "old")->sources[1].period);
  EXPECT_EQ(lines.front(), "kept: the sources' rates (the program gives none)");

  // A source of the program's alone has what the others have not.
  for (const bool file_has_rates : {true, false}) {
    AppSpec more = file_has_rates ? fresh : fresh_app();
    more.sources.push_back(more.sources.front());
    more.sources.back().name = "radar";
    const auto refused =
        with_what_was_asked(more, old_app(file_has_rates ? kSources : without), "app.json", lines);
    ASSERT_FALSE(refused);
    EXPECT_NE(refused.error().what.find("'radar' is new"), std::string::npos)
        << refused.error().to_string();
  }
}

}  // namespace
}  // namespace xauto
