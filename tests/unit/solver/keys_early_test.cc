// SPDX-License-Identifier: Apache-2.0
// Early start, played against random policies by the attack, which has the rule by itself.
#include <map>

#include <gtest/gtest.h>

#include "../cases.h"
#include "attack/attack.h"
#include "attack/producer.h"

namespace xauto::solver::keys::test {
namespace {

attack::Wanted several(std::uint64_t seed) {
  attack::Wanted w;
  w.clocks = 1 + static_cast<int>(seed % 3);
  w.ppm = seed % 2 == 0 ? 0 : 1000;
  w.jitter_us = seed % 7 > 3 ? 60 : 0;
  w.thirds = seed % 6 == 5;
  return w;
}

/// Early start leaves every certificate as it is, by the rule; not by what looks like it.
TEST(KeysEarly, NobodyStartsTooEarlyByTheRule) {
  using attack::Early;
  const std::pair<Early, const char*> wrong[] = {{Early::kFromItsHold, "hold for planned start"},
                                                 {Early::kOfTheReleased, "released jobs alone"},
                                                 {Early::kByTheSequence, "the plan's sequence"},
                                                 {Early::kWithoutSamples, "without samples"}};
  int made = 0;
  std::map<Early, int> broken;
  for (std::uint64_t seed = 1; seed <= 120; ++seed) {
    attack::Wanted w = several(seed);
    w.holds = true;
    w.order = seed % 5 == 0;
    w.preemptive = seed % 3 == 0;
    w.preempt_us = 40;
    w.load = 0.75;
    w.components = 3;
    auto c = attack::valid(seed, w);
    if (!c) continue;
    attack::tighten(*c, seed, seed % 2 == 0);
    ++made;
    for (const Early early : {Early::kByTheRule, Early::kNever}) {
      const auto found = attack::attack(c->app, c->platform, c->policy, {20'000, seed, early});
      EXPECT_FALSE(found.broken()) << seed << ": " << found.late << found.chain;
    }
    for (const auto& [early, name] : wrong)
      broken[early] +=
          attack::attack(c->app, c->platform, c->policy, {20'000, seed, early}).broken() ? 1 : 0;
  }
  EXPECT_GE(made, 90);
  for (const auto& [early, name] : wrong) {
    std::printf("%s: %d of %d broken\n", name, broken[early], made);
    EXPECT_GE(broken[early], 1) << name;
  }
}

/// Readers of other clocks wait for keys, and for no more.
TEST(KeysEarly, NobodyReadsTooEarlyOfAnotherClock) {
  using attack::Early;
  const auto last = static_cast<std::uint64_t>(xauto::test::cases(120, 1200));
  int made = 0, without_samples = 0;
  for (std::uint64_t seed = 1; seed <= last; ++seed) {
    attack::Wanted w = several(seed);
    w.clocks = 2 + static_cast<int>(seed % 2);
    constexpr std::int64_t kPpm[] = {0, 1000, 20'000, 100};
    w.ppm = kPpm[seed % 4];
    w.holds = true;
    w.order = seed % 5 == 0;
    w.preemptive = seed % 3 != 0;
    w.preempt_us = seed % 2 == 0 ? 0 : 40;
    w.load = seed % 2 == 0 ? 0.45 : 0.75;
    w.components = 3 + static_cast<int>(seed % 2);
    auto c = attack::valid(seed, w);
    if (!c || c->app.samples.empty()) continue;
    attack::tighten(*c, seed, seed % 3 == 0);
    ++made;
    const auto broken = [&](Early early, std::int64_t jobs) {
      const auto found = attack::attack(c->app, c->platform, c->policy, {jobs, seed, early});
      EXPECT_FALSE(early == Early::kByTheRule && found.broken())
          << seed << ": " << found.late << found.chain;
      return found.broken();
    };
    (void)broken(Early::kByTheRule, 40'000);
    without_samples += broken(Early::kWithoutSamples, 20'000) ? 1 : 0;
  }
  std::printf("without samples: %d of %d broken\n", without_samples, made);
  EXPECT_GE(made, 80);
  EXPECT_GE(without_samples, 1);
}

}  // namespace
}  // namespace xauto::solver::keys::test
