// SPDX-License-Identifier: Apache-2.0
// What the solver's own certificate accepts, by itself. Policies of the search hold what a
// non-preemptive XPU must not take early, so that most charges of the certificate never decide there.
// Keys and holds of others have to be judged right, too: a hint's, a caller's.
#include <gtest/gtest.h>

#include "attack/attack.h"
#include "attack/producer.h"
#include "keys_certified.h"

namespace xauto::solver::keys::test {
namespace {

using attack::Case;

attack::Wanted mixture(std::uint64_t seed) {
  attack::Wanted w;
  w.clocks = seed % 3 == 0 ? 2 : 1;
  w.ppm = seed % 2 == 0 ? 20'000 : 0;  // far worse than any: a few activations are enough
  w.components = 2 + static_cast<int>(seed / 3 % 3);
  w.load = seed % 5 == 0 ? 0.85 : 0.6;
  w.preemptive = seed / 4 % 2 == 0;
  w.preempt_us = seed / 8 % 2 == 0 ? 10 : 0;
  w.jitter_us = seed % 7 > 3 ? 60 : 0;
  w.holds = seed % 4 > 1;
  w.order = seed % 3 == 1;
  return w;
}

TEST(KeysCertificate, NothingBreaksWhatIsJustAccepted) {
  int made = 0, touched = 0;
  for (std::uint64_t seed = 1; seed <= 90; ++seed) {
    auto c = attack::valid(seed, mixture(seed));
    if (!c || !certified(*c)) continue;
    attack::tighten(*c, seed, seed % 3 == 0, certified);
    ++made;
    const auto found = attack::attack(c->app, c->platform, c->policy, {20'000, seed});
    EXPECT_TRUE(found.late.empty()) << seed << ": " << found.late;
    touched += found.closest_us > -0.001 ? 1 : 0;
  }
  EXPECT_GE(made, 45);
  EXPECT_GE(touched, made / 3);  // the attack reaches keys: it would see a microsecond more
}

/// Pairs make keys possible that are not without them: whoever forgets them breaks those.
TEST(KeysCertificate, PairsAreCountedOn) {
  int made = 0, refused = 0, broken = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    attack::Wanted w = mixture(seed);
    w.order = true;
    w.preemptive = seed % 4 == 0;
    w.load = 0.8;
    auto c = attack::valid(seed, w);
    if (!c || c->policy.order.empty() || !certified(*c)) continue;
    attack::tighten(*c, seed, seed % 3 == 0, certified);
    ++made;
    EXPECT_FALSE(attack::attack(c->app, c->platform, c->policy, {20'000, seed}).broken()) << seed;
    c->policy.order.clear();
    const bool accepted = certified(*c);
    refused += accepted ? 0 : 1;
    const bool breaks =
        !attack::attack(c->app, c->platform, c->policy, {20'000, seed}).late.empty();
    EXPECT_FALSE(accepted && breaks) << seed;
    broken += breaks ? 1 : 0;
  }
  std::printf("%d made, %d refused without order, %d broken\n", made, refused, broken);
  EXPECT_GE(made, 20);
  EXPECT_GE(refused, made / 4);
  EXPECT_GE(broken, 4);
}

}  // namespace
}  // namespace xauto::solver::keys::test
