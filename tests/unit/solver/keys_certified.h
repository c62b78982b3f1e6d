// SPDX-License-Identifier: Apache-2.0
// What the solver's own certificate says of a policy whose keys and holds are somebody else's.
#pragma once

#include <vector>

#include "solver/keys/certificate.h"

#include "attack/attack.h"

namespace xauto::solver::keys::test {

inline bool certified_beside(const attack::Case& c, const Beside& beside) {
  const auto p = Problem::create(c.app, c.platform, {}, c.policy.order, beside);
  if (!p) return false;
  std::vector<int> xpu;
  for (int i = 0; i < p->num_xnodes; ++i) {
    const Placement& placement = c.policy.placements[at(i)];
    xpu.push_back(placement.xpu);
    const std::size_t keys = placement.key_us.size(), holds = placement.hold_us.size();
    const std::size_t jobs = at(p->jobs[at(i)]);
    if (jobs % keys != 0 || (holds > 0 && jobs % holds != 0)) return false;
  }
  Windows w = keys_and_holds(*p, c.policy);
  return certify(*p, xpu, w);
}

inline bool certified(const attack::Case& c) {
  return certified_beside(c, {});
}

}  // namespace xauto::solver::keys::test
