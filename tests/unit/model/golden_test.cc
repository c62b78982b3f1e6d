// SPDX-License-Identifier: Apache-2.0
// Every format against the files under tests/golden: what we write stays byte for byte what it was,
// and every malformed file is refused with the message that stands beside it.
#include <gtest/gtest.h>

#include "model/json.h"

#include "../golden_cases.h"
#include "tests/unit/tables_of.h"

namespace xauto {
namespace {

using test::golden;
using test::slurp;

AppSpec golden_app() {
  return parse_app(slurp(golden() / "app.json"), "app.json").value();
}
Platform golden_platform() {
  return parse_platform(slurp(golden() / "platform.json"), "platform.json").value();
}

TEST(Golden, AppIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "app.json");
  const auto app = parse_app(text, "app.json");
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_EQ(app->xnodes.size(), 4u);
  EXPECT_EQ(app->xnodes[1].wcet_on("dla"), 11000);
  EXPECT_TRUE(app->one_at_a_time);
  EXPECT_EQ(app->sources, (std::vector<SourceSpec>{{"camera", kNoRate}, {"lidar/größe", kNoRate}}));
  EXPECT_EQ(app->deadline_us, 100000);
  EXPECT_EQ(app->chains[1].deadline_us, 100000) << "which has none of its own";
  EXPECT_EQ(to_json(*app), text);
}

AppSpec app_with_rates() {
  return parse_app(slurp(golden() / "app-rates.json"), "app-rates.json").value();
}

TEST(Golden, AppWithRatesIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "app-rates.json");
  const auto app = parse_app(text, "app-rates.json");
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_FALSE(app->one_at_a_time);
  EXPECT_EQ(app->clocks, (std::vector<ClockSpec>{{"main", 5}, {"lidar", 100}}));
  EXPECT_EQ(app->sources[0], (SourceSpec{"camera", {100000, 3}, 0, 500, 0}));
  EXPECT_EQ(app->sources[2].period, (Period{100100, 3}));
  EXPECT_EQ(app->modules[1], (ModuleSpec{"LA", 1, true}));
  EXPECT_EQ(app->xnodes[1].variants[0].quality_pct, 80);
  EXPECT_EQ(app->transfers[2], (TransferSpec{0, "gpu", "gpu", 40}));
  EXPECT_EQ(app->samples[2], std::pair(2, 0));
  EXPECT_EQ(app->chains[0], (ChainSpec{"brake", 0, 4, 80000, 1}));
  EXPECT_EQ(to_json(*app), text);
}

TEST(Golden, PolicyOfKeysIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "policy-keys.json");
  const AppSpec app = app_with_rates();
  const Platform platform = golden_platform();
  const auto policy = parse_policy(text, "policy-keys.json", app, platform);
  ASSERT_TRUE(policy) << policy.error().to_string();
  EXPECT_EQ(policy->placements[0].hold_us, std::vector<std::int64_t>{1500});
  EXPECT_EQ(policy->placements[4].key_us.size(), 5u);
  EXPECT_TRUE(policy->placements[1].start_us.empty());
  EXPECT_TRUE(policy->placements[3].reads_all && !policy->placements[4].reads_all);
  EXPECT_EQ(policy->chains[1], (ChainClaim{"steer", 25501, 25501, true}));
  EXPECT_EQ(to_json(*policy, app, platform), text);
}

TEST(Golden, APolicyThatIsNotCertifiedHasNoChainsAndNoRoomForWcets) {
  const AppSpec app = app_with_rates();
  const Platform platform = golden_platform();
  auto policy =
      parse_policy(slurp(golden() / "policy-keys.json"), "policy-keys.json", app, platform);
  ASSERT_TRUE(policy) << policy.error().to_string();
  policy->certified = false;
  EXPECT_FALSE(validate(*policy, app, platform)) << "it claims something";
  policy->chains.clear();
  Placement& mpc = policy->placements[4];
  mpc = {mpc.xpu, {1}};
  ASSERT_TRUE(validate(*policy, app, platform));
  const auto read =
      parse_policy(to_json(*policy, app, platform), "policy-keys.json", app, platform);
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*read, *policy);
  policy->placements[1].key_us = {100};  // before fcd.pre's
  EXPECT_FALSE(validate(*policy, app, platform)) << "keys still do not fall along edges";
}

TEST(Golden, AHintMayBeOfAnEarlierApp) {
  const std::string text = slurp(golden() / "policy-keys.json");
  AppSpec app = app_with_rates();
  Platform platform = golden_platform();
  const auto before = parse_policy(text, "policy-keys.json", app, platform);
  ASSERT_TRUE(before);
  const int gone = before->placements[0].xpu;
  platform.xpus[static_cast<std::size_t>(gone)].id = "other";
  app.xnodes[1].name = "renamed";
  const auto hint = parse_key_hint(text, "policy-keys.json", app, platform);
  ASSERT_TRUE(hint) << hint.error().to_string();
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const bool known = i != 1 && before->placements[i].xpu != gone;
    EXPECT_EQ(hint->placements[i].xpu, known ? before->placements[i].xpu : -1) << i;
    EXPECT_EQ(hint->placements[i].key_us.empty(), !known) << i;
  }
  EXPECT_FALSE(parse_policy(text, "policy-keys.json", app, platform));
  app.name = "another";
  EXPECT_FALSE(parse_key_hint(text, "policy-keys.json", app, platform));
  EXPECT_FALSE(parse_key_hint("{}", "policy-keys.json", app, platform));
}

TEST(Golden, PlatformIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "platform.json");
  const auto platform = parse_platform(text, "platform.json");
  ASSERT_TRUE(platform) << platform.error().to_string();
  EXPECT_EQ(platform->xpus[3].effective_switch_us(), 40);
  EXPECT_EQ(platform->xpus[2].effective_switch_us(), 275);
  EXPECT_EQ(to_json(*platform), text);
}

TEST(Golden, PolicyOfPrioritiesIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "policy.json");
  const AppSpec app = golden_app();
  const Platform platform = golden_platform();
  const auto policy = parse_policy(text, "policy.json", app, platform);
  ASSERT_TRUE(policy) << policy.error().to_string();
  EXPECT_EQ(policy->placements[0].xpu, 2);
  EXPECT_EQ(policy->order, (std::vector<std::pair<int, int>>{{3, 2}}));
  EXPECT_TRUE(policy->by_priority());
  EXPECT_FALSE(policy->certified);
  EXPECT_EQ(policy->placements[1].priority, 3);
  EXPECT_EQ(to_json(*policy, app, platform), text);
}

TEST(Golden, ProfileIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "profile.json");
  const auto profile = parse_profile(text, "profile.json");
  ASSERT_TRUE(profile) << profile.error().to_string();
  EXPECT_EQ(profile->xnodes[0].on.at("gpu0").max_us, 750);
  EXPECT_EQ(to_json(*profile), text);
  const std::string more = slurp(golden() / "profile-contended.json");
  const auto contended = parse_profile(more, "profile-contended.json");
  ASSERT_TRUE(contended) << contended.error().to_string();
  EXPECT_EQ(contended->xnodes[0].beside.at("cpu").at("gpu0").max_us, 7000);
  EXPECT_TRUE(contended->xnodes[0].on.at("gpu0").others.at("dla0").used);
  EXPECT_TRUE(contended->conditions.readings[0].changed());
  EXPECT_EQ(to_json(*contended), more);
  const std::string pushed = slurp(golden() / "profile-sources.json");
  const auto with_pushed = parse_profile(pushed, "profile-sources.json");
  ASSERT_TRUE(with_pushed) << with_pushed.error().to_string();
  EXPECT_EQ(
      with_pushed->sources,
      (std::vector<SourceSpec>{{"camera", {33333}}, {"lidar/größe", {100000}, 0, 0, 0, true}}));
  EXPECT_EQ(to_json(*with_pushed), pushed);
}

// The hash goes into files that outlive a release: it may not change by accident.
TEST(Golden, HashOfTheGoldenAppIsWhatItWas) {
  EXPECT_EQ(golden_app().hash(), "3918ec83469abcc9");
  EXPECT_EQ(app_with_rates().hash(), "12a0b998ab1575b3");
}

template <class Parse>
void every_case(const std::string& format, std::size_t at_least, Parse parse) {
  const auto cases = test::malformed(format);
  EXPECT_GE(cases.size(), at_least);
  for (const auto& path : cases) {
    const auto result = parse(slurp(path), path.filename().string());
    if (result)
      ADD_FAILURE() << path << " is accepted";
    else
      test::expect_message(path, result.error());
  }
}

TEST(Golden, EveryMalformedAppIsRefusedWithItsMessage) {
  every_case("app", 100, [](const std::string& text, const std::string& name) {
    return parse_app(text, name);
  });
}

TEST(Golden, EveryMalformedPlatformIsRefusedWithItsMessage) {
  every_case("platform", 15, [](const std::string& text, const std::string& name) {
    return parse_platform(text, name);
  });
}

TEST(Golden, EveryMalformedProfileIsRefusedWithItsMessage) {
  every_case("profile", 10, [](const std::string& text, const std::string& name) {
    return parse_profile(text, name);
  });
}

TEST(Golden, EveryMalformedPolicyOfPrioritiesIsRefusedWithItsMessage) {
  const AppSpec app = golden_app();
  const Platform platform = golden_platform();
  every_case("policy", 20, [&](const std::string& text, const std::string& name) {
    return parse_policy(text, name, app, platform);
  });
}

TEST(Golden, ScenariosAndTablesAreWrittenAsTheyWereRead) {
  const AppSpec app = golden_app();
  const Platform platform = golden_platform();
  const std::string text = slurp(golden() / "scenarios.json");
  const auto scenarios = parse_scenarios(text, "scenarios.json", app, platform);
  ASSERT_TRUE(scenarios) << scenarios.error().to_string();
  EXPECT_EQ(to_json(*scenarios), text);
  const AppSpec slow = app_under(app, scenarios->list[1]);
  EXPECT_EQ(slow.xnodes[0].wcet_us,
            (decltype(slow.xnodes[0].wcet_us){{"cpu", 3000}, {"gpu", 1400}}))
      << "what is stated instead of what scaling gives";
  EXPECT_EQ(slow.xnodes[1].wcet_on("gpu"), 11690);
  EXPECT_EQ(app_under(app, {"x", {{"cpu", 101}}}).xnodes[2].wcet_on("cpu"), 1515);
  EXPECT_EQ(app_under(app, {"x", {{"cpu", 133}}}).xnodes[3].wcet_on("cpu"), 3325);
  EXPECT_EQ(app_under(app, {"x", {{"cpu", 1}}}).xnodes[2].wcet_on("cpu"), 15);
  EXPECT_EQ(platform_under(platform, scenarios->list[2]).xpus.size(), 3u);

  const std::string written = slurp(golden() / "tables.json");
  const auto tables = parse_tables(written, "tables.json", app, platform);
  ASSERT_TRUE(tables) << tables.error().to_string();
  EXPECT_EQ(to_json(*tables, app, platform), written);
  EXPECT_EQ(tables->scenarios, scenarios->list);
  EXPECT_EQ(tables->serves[0], (Served{0, {13400, 2500}, {9400, 2500}, 13400, 9400}));
  EXPECT_EQ(tables->serves[1], (Served{0, {13900, 2500}, {9900, 2500}, 13900, 13900}))
      << "more is proven of the release than of its chains";
  EXPECT_EQ(tables->serves[2], (Served{1, {13750, 17500}, {10150, 3750}, 17500, 10150}));
  EXPECT_DOUBLE_EQ(tables->worst_regret(), 17500.0 / 10150);
  EXPECT_EQ(handover_of(*tables, 0, 1)->worst_case_us[0], std::nullopt);
  EXPECT_EQ(handover_of(*tables, 1, 0)->worst_case_us[1], 22190);
  const Scenario both = across(app, tables->scenarios[1], tables->scenarios[2]);
  EXPECT_EQ(app_under(app, both).xnodes[0].wcet_us,
            (decltype(slow.xnodes[0].wcet_us){{"cpu", 4500}, {"gpu", 1400}}));
  EXPECT_EQ(both.lost, std::vector<std::string>{"dla0"});
}

TEST(Golden, ProfilesOfOneAppBecomeItsScenarios) {
  const Platform platform = golden_platform();
  const Profile slow =
      parse_profile(slurp(golden() / "profile-sources.json"), "profile-sources.json").value();
  Profile fast = slow;
  for (XNodeProfile& x : fast.xnodes)
    for (auto& [xpu, s] : x.on) s = {s.count, 1, 2, 3, 50};
  const auto merge = [&](const Profile& a, const Profile& b) {
    return scenarios_of({{"slow", a}, {"fast", b}}, platform, WcetFrom::kMaxPlusMargin);
  };
  const auto scenarios = merge(slow, fast);
  ASSERT_TRUE(scenarios) << scenarios.error().to_string();
  ASSERT_EQ(scenarios->list.size(), 2u);
  const AppSpec app = to_app(slow, platform, WcetFrom::kMaxPlusMargin).value();
  EXPECT_TRUE(validate(*scenarios, app, platform));
  EXPECT_EQ(app_under(app, scenarios->list[0]).xnodes, app.xnodes) << "its own";
  for (const XNodeSpec& x : app_under(app, scenarios->list[1]).xnodes)
    for (const auto& [type, us] : x.wcet_us)
      EXPECT_EQ(us, (50 * (100 + slow.margin_pct) + 99) / 100) << x.name << type;
  Profile other = fast;
  other.app = "another";
  EXPECT_FALSE(merge(slow, other));
  other = fast;
  other.incomplete = "interrupted";
  EXPECT_FALSE(merge(slow, other));
  other = fast;
  for (XNodeProfile& x : other.xnodes)
    if (x.on.size() > 1) {
      x.on.erase(x.on.begin());
      const auto refused = merge(slow, other);
      ASSERT_FALSE(refused) << "what it lacks would count as the app has it";
      EXPECT_EQ(refused.error().where, "fast");
      break;
    }
  other = fast;
  other.xnodes[0].name = "renamed";
  EXPECT_FALSE(merge(slow, other));
}

TEST(Golden, EveryMalformedSetOfScenariosOrTablesIsRefusedWithItsMessage) {
  const AppSpec app = golden_app();
  const Platform platform = golden_platform();
  every_case("scenarios", 14, [&](const std::string& text, const std::string& name) {
    return parse_scenarios(text, name, app, platform);
  });
  every_case("tables", 17, [&](const std::string& text, const std::string& name) {
    return parse_tables(text, name, app, platform);
  });
}

TEST(Golden, AnEmulationScriptIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "emulation.json");
  const auto script = parse_emulation_script(text, "emulation.json", golden_platform());
  ASSERT_TRUE(script) << script.error().to_string();
  EXPECT_EQ(to_json(*script), text);
  EXPECT_EQ(script->steps[1].stop, std::vector<std::string>{"dla0"});
  EXPECT_EQ(script->steps[1].contention_pct.at("gpu"), 20);
}

TEST(Golden, EveryMalformedEmulationScriptIsRefusedWithItsMessage) {
  const Platform platform = golden_platform();
  every_case("emulation", 16, [&](const std::string& text, const std::string& name) {
    return parse_emulation_script(text, name, platform);
  });
}

TEST(Golden, ADemandIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "demand.json");
  const auto demand = parse_demand(text, "demand.json");
  ASSERT_TRUE(demand) << demand.error().to_string();
  EXPECT_EQ(to_json(*demand), text);
  EXPECT_EQ(demand->xpus[0].sequences[1].jobs[0], (DemandJob{0, 900, -600, 15600, 12825, true}));
  EXPECT_TRUE(validate_on(*demand, golden_platform()));
  Platform other = golden_platform();
  other.xpus.back().preemptive = true;
  EXPECT_FALSE(validate_on(*demand, other)) << "it was planned for an XPU that does not preempt";
  other.xpus.pop_back();
  EXPECT_FALSE(validate_on(*demand, other));
}

TEST(Golden, EveryMalformedDemandIsRefusedWithItsMessage) {
  every_case("demand", 13, [&](const std::string& text, const std::string& name) {
    return parse_demand(text, name);
  });
}

TEST(Golden, EveryMalformedPolicyOfKeysIsRefusedWithItsMessage) {
  const AppSpec app = app_with_rates();
  const Platform platform = golden_platform();
  every_case("policy-keys", 35, [&](const std::string& text, const std::string& name) {
    return parse_policy(text, name, app, platform);
  });
}

TEST(Golden, TablesOfKeysAreWrittenAsTheyWereRead) {
  const AppSpec app = app_with_rates();
  const Platform platform = golden_platform();
  const std::string text = slurp(golden() / "tables-keys.json");
  const auto tables = parse_tables(text, "tables-keys.json", app, platform);
  ASSERT_TRUE(tables) << tables.error().to_string();
  EXPECT_EQ(to_json(*tables, app, platform), text);
  // Of the one chain that has a deadline.
  EXPECT_EQ(tables->serves[2], (Served{1, {37500, 25501}, {11370, 25501}, 37500, 11370}));
  EXPECT_DOUBLE_EQ(tables->worst_regret(), 34500.0 / 9000);
  const Scenario all = envelope(*tables, 1, app);
  EXPECT_EQ(app_under(app, all).xnodes[1].wcet_on("gpu"), 9100) << "the longest that it serves";
  EXPECT_EQ(keys_under(*tables, 1, app, platform, all).app_hash, app_under(app, all).hash());
  const PriorityPlan near = whole_policy(*tables, 0, app, platform);
  EXPECT_GT(near.placements[4].priority, near.placements[2].priority) << "its key is smaller";
  EXPECT_EQ(tables->handovers[0].worst_case_us,
            (std::vector<std::optional<std::int64_t>>{51000, std::nullopt}));
  // What is off is on no XPU, and its chain is not there.
  EXPECT_EQ(words_of(tables->tables[2].loss, app), "LA off, fcd.infer half");
  EXPECT_EQ(tables->tables[2].xpu(3), -1);
  EXPECT_EQ(tables->tables[2].keys.chains[1].worst_case_us, kNotThere);
  EXPECT_EQ(tables->serves[3], (Served{2, {37500, kNotThere}, {13000, kNotThere}, 37500, 13000}));
  EXPECT_EQ(tables->handovers[1].worst_case_us,
            (std::vector<std::optional<std::int64_t>>{52000, kNotThere}));
  EXPECT_TRUE(tables->handovers[1].claims_all());
  const Scenario hot = envelope(*tables, 2, app);
  const AppSpec left = app_under(app, hot, tables->tables[2].loss);
  EXPECT_EQ(left.xnodes[1].wcet_on("gpu"), 8000);
  EXPECT_EQ(left.xnodes[3].wcet_us.size(), 1u);
  EXPECT_EQ(left.xnodes[3].wcet_on(off_xpu("LA")), 1);
  EXPECT_EQ(left.chains.size(), 1u);
  EXPECT_EQ(keys_under(*tables, 2, app, platform, hot).placements[3].xpu,
            static_cast<int>(platform.xpus.size()));
}

TEST(Golden, EveryMalformedFileOfTablesOfKeysIsRefusedWithItsMessage) {
  const AppSpec app = app_with_rates();
  const Platform platform = golden_platform();
  every_case("tables-keys", 26, [&](const std::string& text, const std::string& name) {
    return parse_tables(text, name, app, platform);
  });
}

}  // namespace
}  // namespace xauto
