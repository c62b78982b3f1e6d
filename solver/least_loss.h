// SPDX-License-Identifier: Apache-2.0
// The least loss (model/loss.h) with which an app can do what it could not do without one: which
// variants, which optional modules off.
//
// Each XNode with variants and each optional module is an item with levels: level 0 loses nothing,
// and each further level loses more and takes less. Asked is the cheapest choice of levels that
// `suffices`. It is found between two sides (implicit hitting sets; Moreno-Centeno and Karp, 2013,
// Operations Research 61(2)):
//
//   from above  all levels at their highest, then one item after the other as low as it may be
//   from below  each choice that does not suffice, with all the more that does not suffice either, is a
//               cut: some item is above its level there. The cheapest choice that keeps all cuts (an ILP
//               of a binary per level) is a lower bound, and the answer once it suffices.
//
// Where more loss never hurts (`suffices` is monotone in the levels), the answer is then the least one.
#pragma once

#include <functional>

#include "model/loss.h"
#include "model/platform.h"
#include "solver/until.h"

namespace xauto::solver {

struct LeastLoss {
  Loss loss;
  bool suffices = false;  ///< false: not even all that there is; `loss` is that
  bool least = false;     ///< both sides met, before it was over
};

/// `suffices` is asked of each loss once at most, and gives its answer soon after `until` is over.
[[nodiscard]] LeastLoss least_loss(const AppSpec& app, const Platform& platform,
                                   const std::function<bool(const Loss&)>& suffices,
                                   const Until& until = {});

}  // namespace xauto::solver
