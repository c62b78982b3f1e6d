// SPDX-License-Identifier: Apache-2.0
// Worst cases of chains, from the windows. Used by check.cc.
#pragma once

#include <xauto/result.h>

#include "solver/keys/check.h"
#include "solver/keys/check_world.h"

namespace xauto::solver::keys::checking {

/// What follows for chain `index`; an error where nothing leads from its source to its XNode.
/// `urgent`: for a release that its source marks so.
[[nodiscard]] Result<ChainProof> derive_chain(const World& w, std::size_t index, bool urgent);

}  // namespace xauto::solver::keys::checking
