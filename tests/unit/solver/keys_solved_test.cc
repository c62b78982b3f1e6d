// SPDX-License-Identifier: Apache-2.0
// What the solver claims of the cases is what the check derives, with code of its own. The tiny apps
// of tests/unit/solver have seldom a full XPU; here what a charge forgets decides somewhere: a solver
// that forgets what preemption costs, or blocking between clocks, fails here.
#include <gtest/gtest.h>

#include "solver/keys/check.h"
#include "solver/keys/solve.h"

#include "bench/keys/generate.h"

namespace xauto::bench {
namespace {

TEST(KeysSolved, TheCheckDerivesWhatTheSolverClaims) {
  int policies = 0, gated = 0;
  for (const RatedCase& made : standard_set()) {
    // Patterns of thousands of jobs, or without end, and large apps take long.
    if (made.kind == Kind::kAutomotive || made.kind == Kind::kPublic || made.kind == Kind::kLong ||
        made.app.xnodes.size() > 45)
      continue;
    SCOPED_TRACE(made.name);
    solver::keys::Options options;
    options.time_limit_s = 60;
    options.max_evaluations = 30;
    const auto answer = solver::keys::solve(made.app, made.platform, options);
    ASSERT_TRUE(answer) << answer.error().to_string();
    if (answer->outcome != solver::keys::Outcome::kPolicy) continue;
    ++policies;
    for (const Xpu& xpu : made.platform.xpus) gated += xpu.preemptive ? 0 : 1;
    const auto derived = solver::keys::check(made.app, made.platform, answer->policy);
    EXPECT_TRUE(derived) << (derived ? "" : derived.error().to_string());
  }
  EXPECT_GT(policies, 15);
  EXPECT_GT(gated, 5);
}

}  // namespace
}  // namespace xauto::bench
