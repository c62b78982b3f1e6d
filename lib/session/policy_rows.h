// SPDX-License-Identifier: Apache-2.0
// What a run has deployed, as its BPF map shows it (xpu/policy_view.h).
#pragma once

#include <cstddef>
#include <vector>

#include "model/policy_row.h"
#include "session/session.h"

namespace xauto::runtime {

/// One per XNode, in the app's order: what `table` says of it. Of ROS 2's way there are no XPUs.
[[nodiscard]] std::vector<PolicyRow> policy_rows(const Session& session, std::size_t table);
/// The table that a run begins with.
[[nodiscard]] std::size_t first_table(const Session& session);

}  // namespace xauto::runtime
