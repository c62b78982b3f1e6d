// SPDX-License-Identifier: Apache-2.0
#include "model/loss.h"

#include <gtest/gtest.h>

#include "model/json.h"
#include "model/periodic.h"
#include "model/profile.h"
#include "model/tables.h"

#include "tests/unit/tables_of.h"

namespace xauto {
namespace {

/// camera -> see.a -> see.b -> act; see.b -> show.draw -> show.log, both optional.
AppSpec app_of() {
  AppSpec app;
  app.name = "car";
  app.one_at_a_time = true;
  app.deadline_us = 1000;
  app.sources = {{"camera", kNoRate}};
  app.xnodes = {{"see.a", "see", {{"cpu", 100}, {"gpu", 40}}, {0}},
                {"see.b", "see", {{"gpu", 300}}},
                {"act", "act", {{"cpu", 50}}},
                {"show.draw", "show", {{"cpu", 200}, {"gpu", 100}}},
                {"log", "log", {{"cpu", 70}}}};
  app.xnodes[1].variants = {{"small", 60, {{"gpu", 120}, {"cpu", 500}}},
                            {"tiny", 25, {{"gpu", 50}}}};
  app.xnodes[1].real_on = {"gpu"};
  app.xnodes[3].variants = {{"lines", 90, {{"cpu", 20}}}};
  app.modules = {{"show", 1, true}, {"log", 1, true}};
  app.edges = {{0, 1}, {1, 2}, {1, 3}, {3, 4}};
  complete_modules(app);
  complete_chains(app);
  give_deadlines(app);
  return app;
}

Platform platform_of() {
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu"}, {"gpu0", "gpu"}};
  return platform;
}

/// Of tables.json for that app: everything at the start, less in the second table.
Tables tables_of(const AppSpec& app) {
  Tables tables;
  tables.app = app.name;
  tables.app_hash = app.hash();
  tables.platform = "two";
  tables.scenarios = {{"as it is"}, {"slow", {{"gpu", 300}}}};
  tables.scenarios[1].degraded = true;
  tables.scenarios[1].variant_wcet_us = {{"see.b", {{"small", {{"gpu", 333}}}}}};
  tables.tables = {test::table_of(app, "all", {0, 1, 0, 1, 0}, {100, 400, 450, 500, 570}),
                   test::table_of(app, "less", {0, 1, 0, -1, -1}, {100, 433, 483, 434, 435},
                                  {{-1, 0, -1, -1, -1}, {"log", "show"}})};
  tables.tables[1].keys.order = {{0, 2}};
  test::serve(tables, app, 0, 500);
  test::serve(tables, app, 1, 400);
  return tables;
}

TEST(Loss, WhatIsLeftHasTheVariantsTimesAndNoModuleThatIsOff) {
  const AppSpec app = app_of();
  ASSERT_TRUE(validate(app)) << validate(app).error().to_string();
  const Loss loss{{-1, 1, -1, -1, -1}, {"log"}};
  ASSERT_TRUE(validate(loss, app, "/t"));
  EXPECT_EQ(kept(app, loss), (std::vector<int>{0, 1, 2, 3}));
  const AppSpec all = app_with(app, loss), left = release_of(app, loss);
  ASSERT_EQ(all.xnodes.size(), 5u);
  EXPECT_EQ(all.xnodes[4].wcet_on(off_xpu("log")), 1) << "so that its component stays what it is";
  EXPECT_EQ(all.chains.size(), 2u) << "to act and to show; that to log is off";
  ASSERT_TRUE(validate_graph(left)) << validate_graph(left).error().to_string();
  ASSERT_EQ(left.xnodes.size(), 4u);
  EXPECT_TRUE(left.chains.empty());
  EXPECT_EQ(left.xnodes[0], app.xnodes[0]);
  EXPECT_EQ(left.xnodes[1].wcet_us, app.xnodes[1].variants[1].wcet_us);
  EXPECT_EQ(left.xnodes[3].name, "show.draw");
  EXPECT_EQ(left.edges, (std::vector<std::pair<int, int>>{{0, 1}, {1, 2}, {1, 3}}));
  EXPECT_EQ(left.deadline_us, app.deadline_us);
  EXPECT_EQ(loss_pct(loss, app), 75 + 100);
  EXPECT_EQ(words_of(loss, app), "log off, see.b tiny");
}

TEST(Loss, OfNothingIsNothing) {
  const AppSpec app = app_of();
  for (const Loss& none : {Loss(), Loss{std::vector<int>(5, -1), {}}}) {
    EXPECT_TRUE(none.none());
    EXPECT_EQ(loss_pct(none, app), 0);
    EXPECT_EQ(words_of(none, app), "");
    EXPECT_EQ(app_with(app, none).edges, app.edges);
  }
}

TEST(Loss, AVariantOfAModuleThatIsOffCostsNothingMore) {
  EXPECT_EQ(loss_pct({{-1, -1, -1, 0, -1}, {"log", "show"}}, app_of()), 200);
}

TEST(Loss, IsRefusedWhereItWouldStarveOrIsNotThere) {
  const AppSpec app = app_of();
  const auto error = [&](const Loss& loss) {
    const Status status = validate(loss, app, "/t");
    return status ? std::string() : status.error().to_string();
  };
  EXPECT_EQ(error({{-1, 2, -1, -1, -1}, {}}),
            "/t/variants/see.b: XNode 'see.b' has no such variant");
  EXPECT_EQ(error({{-1}, {}}), "/t/variants: does not say the variant of every XNode");
  EXPECT_EQ(error({{}, {"act"}}), "/t/off/0: module 'act' is not optional");
  EXPECT_EQ(error({{}, {"nobody"}}), "/t/off/0: module 'nobody' is not optional");
  EXPECT_EQ(error({{}, {"log", "log"}}), "/t/off/1: are not in alphabetical order, each once");
  EXPECT_EQ(error({{}, {"show"}}),
            "/t/off: module 'show' is off, and module 'log', which waits for it, is not");
  AppSpec all = app;
  all.modules = {{"act", 1, true}, {"log", 1, true}, {"see", 1, true}, {"show", 1, true}};
  ASSERT_FALSE(validate(all)) << "nothing would be left";
  EXPECT_EQ(validate(all).error().where, "/modules");
  all.one_at_a_time = false;  // with rates they may be, and each table keeps a chain
  all.sources[0].period = {10'000};
  ASSERT_TRUE(validate(all)) << validate(all).error().to_string();
  const Status nothing = validate(Loss{{}, {"act", "log", "see", "show"}}, all, "/t");
  ASSERT_FALSE(nothing) << "nothing would be left";
  EXPECT_EQ(nothing.error().to_string(), "/t/off: leaves no chain without a module that is off");
}

TEST(Loss, NobodyWhoIsNeededWaitsForAnOptionalModule) {
  AppSpec app = app_of();
  app.edges.emplace_back(3, 2);
  const Status status = validate(app);
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().where, "/edges/4");
  EXPECT_EQ(status.error().what,
            "module 'act' waits for module 'show', which is optional, and is not optional itself");
  app.modules[1].optional = true;
  EXPECT_TRUE(validate(app));
}

TEST(Loss, IsWrittenAsItWasRead) {
  const AppSpec app = app_of();
  const auto app_again = parse_app(to_json(app), "app.json");
  ASSERT_TRUE(app_again) << app_again.error().to_string();
  EXPECT_EQ(*app_again, app);
  const Platform platform = platform_of();
  const Tables tables = tables_of(app);
  ASSERT_TRUE(validate(tables, app, platform))
      << validate(tables, app, platform).error().to_string();
  const auto again = parse_tables(to_json(tables, app, platform), "tables.json", app, platform);
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, tables);
}

TEST(Loss, BelongsToTheHashOfAnApp) {
  const AppSpec app = app_of();
  AppSpec other = app;
  other.xnodes[1].variants[0].wcet_us["gpu"] = 121;
  EXPECT_NE(other.hash(), app.hash());
  other = app;
  other.modules[2].optional = false;
  EXPECT_NE(other.hash(), app.hash());
  std::swap((other = app).modules[0], other.modules[1]);
  EXPECT_EQ(other.hash(), app.hash()) << "the order of modules means nothing";
}

TEST(Loss, ScenariosScaleVariantsToo) {
  const AppSpec app = app_of();
  const Tables tables = tables_of(app);
  const AppSpec slow = app_under(app, tables.scenarios[1]);
  EXPECT_EQ(slow.xnodes[1].wcet_on("gpu"), 900);
  EXPECT_EQ(slow.xnodes[1].variants[0].wcet_us.at("gpu"), 333) << "what is stated";
  EXPECT_EQ(slow.xnodes[1].variants[0].wcet_us.at("cpu"), 500);
  EXPECT_EQ(slow.xnodes[1].variants[1].wcet_us.at("gpu"), 150) << "what is scaled";
  Scenario fast{"fast"};
  fast.variant_wcet_us = {{"see.b", {{"small", {{"gpu", 400}}}}}};
  EXPECT_FALSE(covers(tables.scenarios[1], slow, fast, app_under(app, fast)))
      << "only a variant is longer";
  const AppSpec both = app_under(app, across(app, tables.scenarios[1], fast));
  EXPECT_EQ(both.xnodes[1].variants[0].wcet_us.at("gpu"), 400);
  EXPECT_EQ(both.xnodes[1].variants[1].wcet_us.at("gpu"), 150);
}

/// see on both types, its variant on the GPU alone; log is optional.
Profile profile_of(std::int64_t times) {
  Profile profile;
  profile.app = "car";
  profile.margin_pct = 10;
  const auto samples = [&](std::int64_t us) {
    Samples s{5, us * times, us * times, us * times, us * times};
    s.emulated = true;
    return s;
  };
  profile.sources = {{"camera", {33'333}}};
  profile.xnodes = {{"see.b", "see", {{"cpu0", samples(500)}, {"gpu0", samples(300)}}, {0}},
                    {"log", "log", {{"cpu0", samples(70)}}}};
  profile.xnodes[0].variants = {{"small", 60, {{"gpu0", samples(120)}}}};
  profile.xnodes[0].variants[0].beside = {{"cpu", {{"gpu0", samples(130)}}}};
  profile.edges = {{0, 1}};
  profile.optional = {"log"};
  return profile;
}

TEST(Loss, ComesFromProfiles) {
  const Profile once = profile_of(1);
  ASSERT_TRUE(validate(once)) << validate(once).error().to_string();
  const auto read = parse_profile(to_json(once), "profile.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, once);
  const auto app = to_app(once, platform_of(), WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(app) << app.error().to_string();
  ASSERT_EQ(app->xnodes[0].variants.size(), 1u);
  EXPECT_EQ(app->xnodes[0].variants[0].quality_pct, 60);
  EXPECT_EQ(app->xnodes[0].variants[0].wcet_us, (decltype(VariantSpec::wcet_us){{"gpu", 143}}))
      << "beside a load it took longest, and a tenth more";
  EXPECT_EQ(app->modules, (std::vector<ModuleSpec>{{"see", 1, false}, {"log", 1, true}}));

  const std::vector<NamedProfile> both{{"full", once}, {"half", profile_of(2)}};
  const auto scenarios = scenarios_of(both, platform_of(), WcetFrom::kMaxPlusMargin);
  ASSERT_TRUE(scenarios) << scenarios.error().to_string();
  ASSERT_TRUE(validate(*scenarios, *app, platform_of()));
  EXPECT_EQ(app_under(*app, scenarios->list[0]).xnodes, app->xnodes);
  EXPECT_EQ(app_under(*app, scenarios->list[1]).xnodes[0].variants[0].wcet_us.at("gpu"), 286);
  std::vector<NamedProfile> other = both;
  other[1].profile.xnodes[0].variants.clear();
  EXPECT_FALSE(scenarios_of(other, platform_of(), WcetFrom::kMaxPlusMargin))
      << "what it lacks would count as the app has it";
}

TEST(Loss, ProfilesThatMakeNoSenseAreRefused) {
  const auto where = [](const auto& spoil) {
    Profile profile = profile_of(1);
    spoil(profile);
    const Status status = validate(profile);
    return status ? std::string() : status.error().where;
  };
  EXPECT_EQ(where([](Profile&) {}), "");
  EXPECT_EQ(where([](Profile& p) { p.optional = {"log", "log"}; }), "/optional/1");
  EXPECT_EQ(where([](Profile& p) { p.optional = {"nobody"}; }), "/optional/0");
  EXPECT_EQ(where([](Profile& p) { p.xnodes[0].variants[0].quality_pct = 0; }),
            "/xnodes/0/variants/0/quality_pct");
  EXPECT_EQ(where([](Profile& p) {
              p.xnodes[0].variants.push_back({"small", 50});
            }),
            "/xnodes/0/variants/1/name");
  EXPECT_EQ(where([](Profile& p) { p.xnodes[0].variants[0].on["gpu0"].min_us = 900; }),
            "/xnodes/0/variants/0/on/gpu0");
}

TEST(Loss, ATableIsAPolicyOfWhatIsLeft) {
  const AppSpec app = app_of();
  const Tables tables = tables_of(app);
  const Policy less = keys_under(tables, 1, app, platform_of(), tables.scenarios[1]);
  EXPECT_EQ(less.placements.size(), 5u);
  EXPECT_EQ(less.placements[3].xpu, 3) << "on an XPU of its own, after log's";
  EXPECT_EQ(less.order, (std::vector<std::pair<int, int>>{{0, 2}}));
  const PriorityPlan whole = whole_policy(tables, 1, app, platform_of());
  ASSERT_EQ(whole.placements.size(), 5u);
  EXPECT_EQ(whole.placements[3].xpu, 1) << "off: where the first scenario's table has it";
  EXPECT_EQ(whole.placements[1].priority, 4);
}

TEST(Loss, InstancesAreMadeByXNodeVariantAndXpu) {
  const AppSpec app = app_of();
  Tables tables = tables_of(app);
  EXPECT_EQ(instances(tables), 6u) << "five, and one of them as its variant, too";
  EXPECT_EQ(moves(tables.tables[0], tables.tables[1]), 1u) << "what is off moves nowhere";
  tables.tables[1].keys.placements[0].xpu = 1;
  EXPECT_EQ(instances(tables), 7u);
  EXPECT_EQ(moves(tables.tables[0], tables.tables[1]), 2u);
}

TEST(Loss, ATableWithOneIsRefusedWhereItIsNotAllowed) {
  const AppSpec app = app_of();
  const auto error = [&](const auto& spoil) {
    Tables tables = tables_of(app);
    spoil(tables);
    const Status status = validate(tables, app, platform_of());
    return status ? std::string() : status.error().to_string();
  };
  EXPECT_EQ(error([](Tables&) {}), "");
  EXPECT_EQ(error([](Tables& t) { t.scenarios[1].degraded = false; }),
            "/serves/1/table: table 'less' loses something (log off, show off, see.b small), and "
            "scenario 'slow' is not degraded");
  EXPECT_EQ(error([](Tables& t) { t.scenarios[0].degraded = true; }),
            "/scenarios/0/degraded: a run begins with it, so it cannot be degraded\n"
            "  hint: put a scenario before it in which nothing is lost");
  EXPECT_EQ(error([](Tables& t) { t.tables[1].keys.placements[3].xpu = 0; }),
            "/tables/1/xnodes: XNode 'show.draw' is placed, and its module is off");
  EXPECT_EQ(error([](Tables& t) { t.tables[1].keys.placements[2].xpu = -1; }),
            "/tables/1/xnodes: XNode 'act' is not placed");
  EXPECT_EQ(error([](Tables& t) {
              t.tables[1].keys.order = {{2, 4}};
            }),
            "/tables/1/order/0: 'act' before 'log': they are on different XPUs\n"
            "  hint: run-time order is between XNodes of one XPU")
      << "what is off is alone on its own";
  EXPECT_NE(error([](Tables& t) {
              t.tables[1].loss.variant[1] = 1;
              t.tables[1].keys.placements[1].xpu = 0;
            }),
            "")
      << "that variant has no implementation there";
}

}  // namespace
}  // namespace xauto
