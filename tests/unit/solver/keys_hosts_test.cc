// SPDX-License-Identifier: Apache-2.0
// Apps over several computers: theorem 18 played against hosts with wrong clocks, and what the check refuses.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "model/hosts.h"
#include "model/json.h"
#include "solver/keys/check.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"

#include "hosts_naive.h"
#include "keys_random.h"

namespace xauto::solver::keys {
namespace {

using solver::test::Dice;

constexpr std::int64_t kBaseUs = 700;

Platform two_hosts(std::int64_t rate_ppm = 0, std::int64_t mbit_s = 0) {
  Platform platform;
  platform.name = "two";
  platform.hosts = {{"front", rate_ppm}, {"rear", rate_ppm}};
  platform.links = {{0, 1, kBaseUs, mbit_s}, {1, 0, kBaseUs, mbit_s}};
  for (int h = 0; h < 2; ++h) {
    platform.xpus.push_back({"cpu" + std::to_string(h), "cpu"});
    platform.xpus.back().host = h;
    platform.xpus.push_back({"gpu" + std::to_string(h), "gpu"});
    platform.xpus.back().host = h;
  }
  return platform;
}

/// A camera of 30 ms through two modules, and a control loop of 10 ms that samples the second.
AppSpec camera_and_control() {
  const char* text = R"({"schema": "xauto.app", "version": 3, "name": "pair",
    "sources": [{"name": "camera", "period_us": 30000}, {"name": "tick", "period_us": 10000}],
    "modules": [{"name": "see", "host": "front"}, {"name": "know", "host": "rear"},
                {"name": "act", "host": "front"}],
    "xnodes": [
      {"name": "see.infer", "module": "see", "source": "camera", "message_bytes": 12500,
       "wcet_us": {"gpu": 4000}},
      {"name": "know.track", "module": "know", "message_bytes": 2500, "wcet_us": {"cpu": 2000}},
      {"name": "act.plan", "module": "act", "source": "tick", "wcet_us": {"cpu": 1000}}],
    "edges": [["see.infer", "know.track"]], "samples": [["know.track", "act.plan"]],
    "chains": [{"name": "track", "from": "camera", "to": "know.track"},
               {"name": "react", "from": "camera", "to": "act.plan"}]})";
  auto app = parse_app(text, "pair");
  EXPECT_TRUE(app) << app.error().to_string();
  return *app;
}

Answer solved(const AppSpec& app, const Platform& platform, std::int64_t evaluations = 4000) {
  auto answer = solve(app, platform, brief(evaluations));
  EXPECT_TRUE(answer) << answer.error().to_string();
  return answer ? *answer : Answer{};
}

TEST(KeysHosts, AMessageTakesTheLinkAndAllThatCrossesIt) {
  const AppSpec app = camera_and_control();
  const Platform platform = two_hosts(0, 100);
  const Answer answer = solved(app, platform);
  ASSERT_EQ(answer.outcome, Outcome::kPolicy);
  // 12 500 bytes at 100 Mbit/s are 1000 us, 2 500 bytes 200 us. Each way has one message.
  EXPECT_EQ(answer.policy.crossings, (std::vector<xauto::Crossing>{{0, 1, 1700}, {1, 0, 900}}));
  EXPECT_EQ(answer.policy.chains[0].worst_case_us, 4000 + 1700 + 2000);
  // Behind the sample: just missed by a tick, the next one is 10 ms later; from there 1 ms.
  EXPECT_LE(answer.policy.chains[1].worst_case_us, 7700 + 900 + 10'000 + 1000);
  EXPECT_GE(answer.policy.chains[1].worst_case_us, 7700 + 900 + 1000);
  const auto checked = check(app, platform, answer.policy);
  EXPECT_TRUE(checked) << checked.error().to_string();
  const Answer without = solved(app, two_hosts());
  EXPECT_EQ(without.policy.chains[0].worst_case_us, 4000 + kBaseUs + 2000);
}

TEST(KeysHosts, TheFileKeepsCrossings) {
  const AppSpec app = camera_and_control();
  const Platform platform = two_hosts(20, 100);
  const Answer answer = solved(app, platform);
  const auto again = parse_platform(to_json(platform), "again");
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, platform);
  const auto policy = parse_policy(to_json(answer.policy, app, platform), "p", app, platform);
  ASSERT_TRUE(policy) << policy.error().to_string();
  EXPECT_EQ(*policy, answer.policy);
  const auto app_again = parse_app(to_json(app), "again");
  ASSERT_TRUE(app_again) << app_again.error().to_string();
  EXPECT_EQ(app_again->hash(), app.hash());
}

TEST(KeysHosts, WhatIsFalseIsALie) {
  const AppSpec app = camera_and_control();
  const Platform platform = two_hosts(0, 100);
  const Policy good = solved(app, platform).policy;
  const auto lies = [&](const Policy& bad, const AppSpec& of, const Platform& on) {
    const auto checked = check(of, on, bad);
    return checked ? std::string() : checked.error().what;
  };
  EXPECT_EQ(lies(good, app, platform), "");
  Policy bad = good;
  --bad.crossings[0].x_us;
  EXPECT_NE(lies(bad, app, platform).find("the link takes 1700"), std::string::npos);
  bad = good;
  bad.crossings.pop_back();
  EXPECT_EQ(lies(bad, app, platform), "is not there");
  bad = good;
  bad.placements[1].xpu = 0;  // its module is pinned to the other host
  EXPECT_NE(lies(bad, app, platform).find("is not on host 'rear'"), std::string::npos);
  bad = good;
  bad.chains[1].worst_case_us -= 100;  // a sample between hosts takes time
  EXPECT_NE(lies(bad, app, platform).find("worst_case_us is"), std::string::npos);
  bad = good;
  for (std::int64_t& key : bad.placements[1].key_us) key = 4000 + 1699 + 2000;
  EXPECT_NE(lies(bad, app, platform), "");
  Platform slow = platform;  // a slow clock reads more time than a job takes
  slow.hosts[1].rate_ppm = 10'000;
  EXPECT_NE(lies(good, app, slow), "");
  Platform apart = platform;
  apart.links.pop_back();
  EXPECT_NE(lies(good, app, apart).find("no link from 'rear' to 'front'"), std::string::npos);
  AppSpec much = app;
  much.xnodes[0].message_bytes = 400'000;
  Policy of_much = good;
  of_much.app_hash = much.hash();
  of_much.crossings[0].x_us = 100'000;
  EXPECT_NE(lies(of_much, much, platform).find("meets itself"), std::string::npos);
}

TEST(KeysHosts, WhatCannotBePlannedIsRefused) {
  const AppSpec app = camera_and_control();
  const auto says = [&](const AppSpec& of, const Platform& on, const Options& options) {
    const auto answer = solve(of, on, options);
    return answer ? std::string() : answer.error().what;
  };
  Platform one = two_hosts();
  one.hosts.clear();
  one.links.clear();
  for (Xpu& xpu : one.xpus) xpu.host = 0;
  Options options = brief(200);
  Platform apart = two_hosts();
  apart.links.clear();
  EXPECT_NE(says(app, apart, options).find("no link leads there"), std::string::npos);
  Options reserved = options;
  reserved.beside.reserve_pct = 10;
  EXPECT_NE(says(app, two_hosts(), reserved).find("several hosts"), std::string::npos);
  EXPECT_NE(validate_pins(app, one).error().what.find("has no hosts"), std::string::npos);
}

/// Modules as random as keys_random.h's, on hosts that are as random.
Platform random_hosts(Dice& dice, int ppm) {
  Platform platform = two_hosts(ppm, 0);
  for (Xpu& xpu : platform.xpus) {
    if (xpu.type != "gpu") continue;
    xpu.preemptive = dice.chance(60);
    xpu.preempt_us = xpu.preemptive ? dice.roll(0, 200) : 0;
  }
  for (HostLink& link : platform.links) link.base_us = dice.roll(100, 1500);
  return platform;
}

struct Tally {
  int certified = 0, late = 0, longer = 0;
};

/// Links and clocks take so many times X together.
Tally played(int systems, double part_of_x, std::uint64_t seed, int clocks, int ppm) {
  Tally tally;
  for (int k = 0; k < systems; ++k) {
    Dice dice(seed + static_cast<std::uint64_t>(k));
    RatedShape shape;
    shape.clocks = clocks;
    shape.ppm = ppm;
    shape.max_nodes = 4;
    AppSpec app = random_rated_app(dice, shape);
    Platform platform = random_hosts(dice, ppm);
    {
      Platform none;  // only the app is stretched
      stretch(app, none, 1000);
    }
    for (std::size_t m = 0; m < app.modules.size(); ++m)
      if (dice.chance(70)) app.modules[m].host = platform.hosts[m % 2].name;
    const auto answer = solve(app, platform, brief(150));
    if (!answer || answer->outcome != Outcome::kPolicy || answer->policy.crossings.empty() ||
        !answer->policy.order.empty())
      continue;
    const auto checked = check(app, platform, answer->policy);
    EXPECT_TRUE(checked) << checked.error().to_string() << ", seed " << seed + k;
    if (!checked) continue;
    ++tally.certified;
    std::int64_t x = platform.links[0].base_us;
    for (const HostLink& link : platform.links) x = std::min(x, link.base_us);
    for (int time = 0; time < 3; ++time) {
      test::HostsPlay play;
      // One clock is ahead of the other by `off`; a message takes the rest of X.
      const double all = part_of_x * static_cast<double>(x), off = all * dice.roll(0, 100) / 100;
      const int ahead = dice.roll(0, 1);
      play.clocks.resize(2);
      for (test::HostClock& clock : play.clocks) clock = {0, ppm > 0 ? off / 4 : 0, ppm * 1e-6};
      play.clocks[static_cast<std::size_t>(ahead)].off = ppm > 0 ? off / 2 : off;
      play.link_us = all - off;
      play.less_percent = dice.roll(0, 100);
      play.activations = 40;
      test::HostsWorld world(app, platform, answer->policy, play, dice);
      const test::HostsPlayed result = world.run();
      const bool late = result.latest_us > 0.01;
      tally.late += late ? 1 : 0;
      for (std::size_t c = 0; c < app.chains.size(); ++c)
        if (result.chain_us[c] > static_cast<double>(answer->policy.chains[c].worst_case_us) + 0.01)
          ++tally.longer;
    }
  }
  return tally;
}

TEST(KeysHosts, NobodyIsLateWhileXHolds) {
  const char* asked = std::getenv("XAUTO_SYSTEMS");
  const int systems = asked != nullptr ? std::atoi(asked) : 40;
  for (const auto& [clocks, ppm] : {std::pair(1, 0), {2, 5000}}) {
    const Tally tally = played(systems, 1.0, 1, clocks, ppm);
    EXPECT_GT(tally.certified, systems / 5);
    EXPECT_EQ(tally.late, 0) << "of " << tally.certified;
    EXPECT_EQ(tally.longer, 0) << "of " << tally.certified;
    std::printf("%d of %d systems certified, %d plays late, %d chains longer\n", tally.certified,
                systems, tally.late, tally.longer);
  }
}

TEST(KeysHosts, AnXThatIsTooSmallIsFound) {
  const Tally tally = played(60, 1 / 0.9, 1, 1, 0);
  EXPECT_GT(tally.late + tally.longer, 0) << "of " << tally.certified;
  std::printf("%d certified, %d plays late, %d chains longer\n", tally.certified, tally.late,
              tally.longer);
}

}  // namespace
}  // namespace xauto::solver::keys
