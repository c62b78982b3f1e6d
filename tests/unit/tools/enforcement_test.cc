// SPDX-License-Identifier: Apache-2.0
// docs/keys.md, "Enforcement", played: who is admitted beside runs that are not trusted ends by its keys, whatever they do.
// The admission is the service's (launch/regulated.h, check_together) and the keys are the coordinator's (coord/regulator.h);
// the XPU here is a player of its own: earliest key first, in whole microseconds, each preemption paid by who preempts. Those
// who are not trusted ask at any time, again as soon as they like, and never end by themselves.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "coord/regulator.h"
#include "launch/regulated.h"
#include "model/demand.h"
#include "solver/keys/check.h"

#include "../cases.h"

namespace xauto {
namespace {

using coord::Regulator;
using coord::SporadicTask;

struct Trusted {
  std::int64_t period, ready, key, wcet;  // us
};
struct Setting {
  std::int64_t cost = 0;
  std::vector<Trusted> trusted;
  std::vector<SporadicTask> tasks;  // ns
};
/// Break it.
enum class Fault : std::uint8_t { kNone, kNoCut, kOwnKeys, kNotCharged };

/// Whose common multiple is near: the admission looks up to there.
constexpr std::int64_t kPeriods[] = {2'000, 4'000, 5'000, 10'000, 20'000};  // us

Setting any(std::mt19937& random) {
  const auto in = [&](std::int64_t low, std::int64_t high) {
    return std::uniform_int_distribution<std::int64_t>(low, high)(random);
  };
  Setting s{.cost = in(0, 1) * in(1, 400), .trusted = {}, .tasks = {}};
  for (std::int64_t n = in(1, 3); n > 0; --n) {
    const std::int64_t period = kPeriods[in(0, 4)], wcet = in(200, period / 4),
                       ready = in(0, period / 4);
    s.trusted.push_back({period, ready, ready + in(wcet + 1, period), wcet});
  }
  for (std::int64_t n = in(1, 2); n > 0; --n) {
    const std::int64_t period = kPeriods[in(0, 4)], budget = in(200, period / 4),
                       window = in(budget, period);
    s.tasks.push_back({.xnode = static_cast<std::uint32_t>(s.tasks.size()),
                       .period_ns = period * 1000,
                       .window_ns = window * 1000,
                       .longest_ns = (window + in(0, 1) * in(0, 2000)) * 1000,
                       .budget_ns = budget * 1000});
  }
  return s;
}

bool admitted(const Setting& s, Fault fault) {
  launch::Join join{.num_xnodes = static_cast<std::uint32_t>(s.tasks.size()), .num_xpus = 1};
  std::snprintf(join.xpus[0].hardware, sizeof join.xpus[0].hardware, "core0");
  join.xpus[0].preempt_us = s.cost;
  std::vector<launch::LeaseTask> tasks;
  for (const SporadicTask& task : s.tasks) tasks.push_back({.task = task});
  auto theirs = launch::demand_of_tasks(join, tasks);
  EXPECT_TRUE(theirs) << theirs.error().to_string();
  DemandOnXpu on = theirs->xpus.front();
  on.sequences.clear();
  for (const Trusted& t : s.trusted)
    on.sequences.push_back(
        {.period = t.period, .jobs = {{.ready = t.ready, .key = t.key, .work = t.wcet}}});
  Demand ours{.ticks_per_us = 1, .xpus = {on}};
  if (fault != Fault::kNotCharged) launch::charge_all(ours, {"core0"});
  if (fault == Fault::kNotCharged)  // nor what a cut takes
    for (DemandSequence& sequence : theirs->xpus.front().sequences)
      sequence.jobs.front().work =
          std::max<std::int64_t>(1, sequence.jobs.front().work - (100 + s.cost) * 1000);
  return solver::keys::check_together({ours, *theirs}).has_value();
}

struct Playing {
  std::int64_t key, work;
  bool trusted, started = false;
  std::size_t whose;
};

/// How late the latest job of who is trusted ends, us.
std::int64_t play(const Setting& s, Fault fault, std::mt19937& random) {
  const auto in = [&](std::int64_t low, std::int64_t high) {
    return std::uniform_int_distribution<std::int64_t>(low, high)(random);
  };
  const bool greedy = in(0, 1) == 0;
  const std::int64_t end = 200'000;
  std::vector<std::int64_t> released(s.trusted.size()), asks(s.tasks.size());
  std::vector<std::vector<std::pair<std::int64_t, std::int64_t>>> arrivals(
      s.trusted.size());  // at, key
  for (std::size_t i = 0; i < s.trusted.size(); ++i) {
    const Trusted& t = s.trusted[i];
    for (std::int64_t r = in(0, t.period - 1); r < end; r += t.period)
      arrivals[i].emplace_back(r + (in(0, 1) == 0 ? t.ready : in(0, t.ready)), r + t.key);
  }
  std::vector<Regulator> regulators(s.tasks.begin(), s.tasks.end());
  struct Turn {
    std::int64_t key, not_before;
  };
  std::vector<std::optional<Turn>> turns(s.tasks.size());
  for (std::int64_t& at : asks) at = in(0, 5000);
  std::vector<Playing> ready;
  std::int64_t now = 0, late = INT64_MIN;
  while (now < end) {
    for (std::size_t i = 0; i < s.trusted.size(); ++i)
      for (auto& next = released[i]; next < static_cast<std::int64_t>(arrivals[i].size()) &&
                                     arrivals[i][static_cast<std::size_t>(next)].first <= now;
           ++next)
        ready.push_back({arrivals[i][static_cast<std::size_t>(next)].second, s.trusted[i].wcet,
                         true, false, i});
    for (std::size_t i = 0; i < s.tasks.size(); ++i) {
      if (!turns[i] && asks[i] <= now) {
        if (fault == Fault::kOwnKeys)
          turns[i] = Turn{now + s.tasks[i].window_ns / 1000, now};
        else if (const auto window = regulators[i].ask(now * 1000))
          turns[i] = Turn{window->key / 1000, window->not_before_ns / 1000};
      }
      if (turns[i] && turns[i]->not_before <= now) {
        const std::int64_t budget = fault == Fault::kNoCut
                                        ? 50'000
                                        : s.tasks[i].budget_ns / 1000 + (greedy ? 100 : in(0, 100));
        ready.push_back({turns[i]->key, budget, false, false, i});
        const std::int64_t pause = greedy ? 0 : in(0, 30'000);
        asks[i] = now + pause + (fault == Fault::kOwnKeys ? budget : 0);
        turns[i].reset();
      }
    }
    // When somebody comes next.
    std::int64_t next = end;
    for (std::size_t i = 0; i < s.trusted.size(); ++i)
      if (released[i] < static_cast<std::int64_t>(arrivals[i].size()))
        next = std::min(next, arrivals[i][static_cast<std::size_t>(released[i])].first);
    for (std::size_t i = 0; i < s.tasks.size(); ++i)
      next = std::min(next, std::max(now + 1, turns[i] ? turns[i]->not_before : asks[i]));
    if (ready.empty()) {
      now = next;
      continue;
    }
    const auto first = std::ranges::min_element(ready, {}, &Playing::key);
    // Who is not trusted has his budget by the clock: what his preempting takes is in it.
    if (!std::exchange(first->started, true) && first->trusted &&
        std::ranges::any_of(ready, [&](const Playing& p) { return p.started && &p != &*first; }))
      first->work += s.cost;
    const std::int64_t until = std::min(next, now + first->work);
    first->work -= until - now;
    now = until;
    if (first->work > 0) continue;
    if (first->trusted) late = std::max(late, now - first->key);
    ready.erase(first);
  }
  return late;
}

int num_settings() {
  const char* const asked = std::getenv("XAUTO_SETTINGS");
  if (asked != nullptr) return std::atoi(asked);
  return test::cases(5'000, 1'000'000);
}

TEST(Enforcement, WhoIsAdmittedEndsByItsKeysWhateverOthersDo) {
  std::mt19937 random(1);
  int accepted = 0, refused = 0, refused_late = 0;
  for (int n = 0; n < num_settings(); ++n) {
    const Setting s = any(random);
    if (!admitted(s, Fault::kNone)) {
      ++refused;
      for (int k = 0; k < 3; ++k)
        if (play(s, Fault::kNone, random) > 0) {
          ++refused_late;
          break;
        }
      continue;
    }
    ++accepted;
    ASSERT_LE(play(s, Fault::kNone, random), 0) << "setting " << n;
  }
  std::printf("%d admitted, none late; %d refused, %d of them late\n", accepted, refused,
              refused_late);
  EXPECT_GT(accepted, num_settings() / 10);
  EXPECT_GT(refused_late, 0);
}

TEST(Enforcement, EachPartOfItIsNeeded) {
  for (const Fault fault : {Fault::kNoCut, Fault::kOwnKeys, Fault::kNotCharged}) {
    std::mt19937 random(2);
    bool late = false;
    for (int n = 0; n < 20'000 && !late; ++n) {
      const Setting s = any(random);
      late = admitted(s, fault) && play(s, fault, random) > 0;
    }
    EXPECT_TRUE(late) << static_cast<int>(fault);
  }
}

}  // namespace
}  // namespace xauto
