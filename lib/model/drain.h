// SPDX-License-Identifier: Apache-2.0
// A change of tables of which nothing is claimed drains: for a while nothing is released, so that the
// next table's releases meet no job of the one before (docs/keys.md, "A change that drains").
#pragma once

#include <cstdint>

#include "model/tables.h"

namespace xauto {

/// All jobs with nominal releases before an instant S have ended so long after it, if until `notice_us`
/// before the release before S none was longer than `keys` allows, and then none longer than `app` has it.
[[nodiscard]] std::int64_t drain_us(const AppSpec& app, const Platform& platform,
                                    const Policy& keys, std::int64_t notice_us);

/// Of a change between two tables that claims nothing of some chain, and whose jobs need no XPU that
/// is lost; 0: it does not drain.
[[nodiscard]] std::int64_t drain_us(const Tables& tables, int from, int to, const AppSpec& app,
                                    const Platform& platform);

}  // namespace xauto
