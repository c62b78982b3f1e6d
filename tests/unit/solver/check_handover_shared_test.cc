// SPDX-License-Identifier: Apache-2.0
// Changes where clocks share XPUs: what the checker derives, attacked by plays (handover_naive.h).
#include <algorithm>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/components.h"
#include "solver/steady/check_handover.h"
#include "solver/steady/solve.h"

#include "handover_naive.h"
#include "steady_random.h"

namespace xauto::solver::steady {
namespace {

/// What q has that p has not.
enum class Changes : std::uint8_t {
  kOneWay,  ///< all jobs take more under one of both tables
  kMixed,   ///< those of one clock do so under p, and those of the other one under q
};

struct SharedCase {
  AppSpec from_app, to_app, both;
  Platform platform;
  std::int64_t notice_us = 0;
  KeyPolicy from, to;
};

/// With keys that leave some slack: those for jobs that take 10 % more, preempting included.
std::optional<KeyPolicy> slack_policy(
    const AppSpec& meant_for, Platform platform, std::uint64_t seed,
    const std::vector<std::pair<std::string, std::string>>& not_on) {
  AppSpec app = meant_for;
  std::int64_t cost = 0;
  for (Xpu& xpu : platform.xpus) cost = std::max(cost, std::exchange(xpu.preempt_us, 0));
  for (XNodeSpec& xnode : app.xnodes)
    for (auto& [type, us] : xnode.wcet_us) us = (us + cost) * 11 / 10 + 2;
  Options options;
  options.wishes.forbids = not_on;
  options.max_evaluations = 300;
  options.seed = seed;
  auto answer = solve(app, platform, options);
  if (!answer || answer->outcome != Outcome::kPolicy) return std::nullopt;
  answer->policy.app_hash = meant_for.hash();
  return answer->policy;
}

/// [xnode]
std::vector<int> clocks_of(const AppSpec& app) {
  const Components found = *find_components(app);
  std::vector<int> clocks;
  for (const int component : found.of) clocks.push_back(found.components[at(component)].clock);
  return clocks;
}

/// All XPUs preempt, or none does.
std::optional<SharedCase> shared_case(std::uint64_t seed, int ppm,
                                      Changes changes = Changes::kOneWay, bool preempt = true) {
  constexpr std::int64_t kFactor = 1000;
  solver::test::Dice dice(seed);
  SteadyShape shape;
  shape.clocks = 2;
  shape.ppm = ppm;
  shape.max_components = 3;
  shape.least_period = 12;
  SharedCase made;
  made.platform = random_steady_platform(dice);
  made.from_app = random_steady_app(dice, shape);
  for (Xpu& xpu : made.platform.xpus) {
    xpu.preemptive = preempt;
    if (!preempt) xpu.preempt_us = 0;
  }
  stretch(made.from_app, made.platform, kFactor);
  if (seed % 4 != 0) made.notice_us = 2 * kFactor;
  if (seed % 3 == 1)
    for (ModuleSpec& module : made.from_app.modules) module.max_in_flight = 2;
  made.to_app = made.both = made.from_app;
  const std::vector<int> clocks = clocks_of(made.from_app);
  for (std::size_t i = 0; i < made.to_app.xnodes.size(); ++i)
    for (auto& [type, us] : made.to_app.xnodes[i].wcet_us) {
      const int clock = changes == Changes::kMixed ? clocks[i] : 0;
      const int sign = (seed + at(clock)) % 2 == 0 ? -1 : 1;
      us = std::max(kFactor / 4, us + sign * kFactor * dice.roll(0, 3) / 2);
      std::int64_t& larger = made.both.xnodes[i].wcet_us.at(type);
      larger = std::max(larger, us);
    }
  std::vector<std::pair<std::string, std::string>> not_on;
  const auto from = slack_policy(made.from_app, made.platform, seed, not_on);
  if (!from) return std::nullopt;
  const bool moves = seed % (changes == Changes::kMixed ? 3 : 5) == 0;
  for (std::size_t i = 0; !moves && i < made.from_app.xnodes.size(); ++i)
    for (std::size_t m = 0; m < made.platform.xpus.size(); ++m)
      if (m != at(from->placements[i].xpu))
        not_on.emplace_back(made.from_app.xnodes[i].name, made.platform.xpus[m].id);
  const auto to = slack_policy(made.to_app, made.platform, seed + 1, not_on);
  if (!to) return std::nullopt;
  made.from = *from;
  made.to = *to;
  return made;
}

bool clocks_meet(const SharedCase& of) {
  const std::vector<int> clock_of = clocks_of(of.from_app);
  std::vector<std::set<int>> clocks(of.platform.xpus.size());
  for (std::size_t i = 0; i < of.from_app.xnodes.size(); ++i)
    for (const KeyPolicy* policy : {&of.from, &of.to})
      clocks[at(policy->placements[i].xpu)].insert(clock_of[i]);
  return std::ranges::any_of(clocks, [](const auto& all) { return all.size() > 1; });
}

/// On an XPU one clock gains work, and another one loses some.
bool is_mixed(const SharedCase& of) {
  const std::vector<int> clock_of = clocks_of(of.from_app);
  const Components found = *find_components(of.from_app);
  for (std::size_t m = 0; m < of.platform.xpus.size(); ++m) {
    const Xpu& xpu = of.platform.xpus[m];
    std::vector<double> gains(of.from_app.clocks.size());  // of a microsecond
    for (const bool of_q : {false, true})
      for (std::size_t i = 0; i < clock_of.size(); ++i) {
        if (at((of_q ? of.to : of.from).placements[i].xpu) != m) continue;
        const AppSpec& app = of_q ? of.to_app : of.from_app;
        const Period& period = found.components[at(found.of[i])].period;
        const double work = static_cast<double>(*app.xnodes[i].wcet_on(xpu.type) + xpu.preempt_us) *
                            static_cast<double>(period.den) / static_cast<double>(period.num);
        gains[at(clock_of[i])] += of_q ? work : -work;
      }
    constexpr double kNothing = 1e-9;
    const auto [least, most] = std::ranges::minmax(gains);
    if (least < -kNothing && most > kNothing) return true;
  }
  return false;
}

Result<HandoverProof> derived_for(const SharedCase& of) {
  return derive_handover(
      {of.from_app, of.to_app, of.both, of.platform, of.from, of.to, of.notice_us}, 1'000'000);
}

struct Attacked {
  int claimed = 0;
  int broken = 0;  ///< a play is longer than the worst cases of both tables
};

/// No play is longer than its bound, and none settles later.
void attack(const SharedCase& two, std::uint64_t seed, Attacked& so_far) {
  const auto proof = derived_for(two);
  ASSERT_TRUE(proof) << proof.error().to_string();
  if (!proof->why_not.empty()) return;
  ++so_far.claimed;
  const NaiveTables naive{two.from_app, two.to_app, two.both, two.platform, two.from, two.to};
  const HandoverAttack attack{two.notice_us, 150, seed};
  HandoverClimb climb(naive, proof->worst_case_us, attack);
  const HandoverFound found = climb.run();
  EXPECT_FALSE(found.deadlock || found.illegal) << "seed " << seed;
  EXPECT_LE(found.worst, 1) << "seed " << seed;
  EXPECT_LE(found.settles_us, static_cast<double>(proof->settles_us)) << "seed " << seed;
  std::vector<std::optional<std::int64_t>> steady;
  for (std::size_t c = 0; c < proof->worst_case_us.size(); ++c)
    steady.emplace_back(std::max(two.from.chains[c].worst_case_us, two.to.chains[c].worst_case_us));
  HandoverClimb weaker(naive, steady, attack);
  so_far.broken += weaker.run().worst > 1;
}

TEST(CheckHandoverShared, NoPlayIsLonger) {
  for (const int ppm : {0, 100, 20'000}) {
    Attacked attacked;
    for (std::uint64_t seed = 1; seed <= 200; ++seed) {
      const auto two = shared_case(seed, ppm);
      if (two && clocks_meet(*two)) attack(*two, seed, attacked);
    }
    EXPECT_GE(attacked.claimed, 30) << ppm;
    EXPECT_GE(attacked.broken, 2) << "neither table alone bounds a change; " << ppm;
  }
}

TEST(CheckHandoverShared, NoPlayIsLongerWhereOneClockGainsAndAnotherOneLoses) {
  for (const int ppm : {0, 100, 20'000}) {
    Attacked attacked;
    for (std::uint64_t seed = 1; seed <= 300; ++seed) {
      const auto two = shared_case(seed, ppm, Changes::kMixed);
      if (two && is_mixed(*two)) attack(*two, seed, attacked);
    }
    EXPECT_GE(attacked.claimed, 50) << ppm;
    EXPECT_GE(attacked.broken, 5) << "neither table alone bounds a change; " << ppm;
  }
}

TEST(CheckHandoverShared, NoPlayIsLongerWhereXpusDoNotPreempt) {
  int broken = 0;
  for (const int ppm : {0, 100, 20'000}) {
    Attacked attacked;
    for (std::uint64_t seed = 1; seed <= 300; ++seed) {
      const auto two = shared_case(seed, ppm, Changes::kOneWay, false);
      if (two && clocks_meet(*two)) attack(*two, seed, attacked);
    }
    EXPECT_GE(attacked.claimed, 15) << ppm;
    broken += attacked.broken;
  }
  EXPECT_GE(broken, 2) << "neither table alone bounds a change";
}

TEST(CheckHandoverShared, FromATableToItselfNothingIsLonger) {
  int same = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    auto two = shared_case(seed, 0);
    if (!two || !clocks_meet(*two)) continue;
    two->to_app = two->both = two->from_app;
    two->to = two->from;
    const auto proof = derived_for(*two);
    ASSERT_TRUE(proof) << proof.error().to_string();
    for (std::size_t c = 0; c < proof->worst_case_us.size(); ++c, ++same)
      EXPECT_EQ(proof->worst_case_us[c], two->from.chains[c].worst_case_us) << "seed " << seed;
  }
  EXPECT_GE(same, 60);
}

}  // namespace
}  // namespace xauto::solver::steady
