// SPDX-License-Identifier: Apache-2.0
#include "session/policy_rows.h"

#include <cstdint>

namespace xauto::runtime {

std::vector<PolicyRow> policy_rows(const Session& session, std::size_t table) {
  const bool placed = session.scheduling != Scheduling::kRos2;
  const bool scheduled = session.scheduling == Scheduling::kXAuto;
  std::vector<PolicyRow> rows(session.app.xnodes.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    PolicyRow& row = rows[i];
    row.table = static_cast<std::uint32_t>(table);
    row.xnode = session.app.xnodes[i].name;
    row.by = "nobody";
    if (!placed) continue;
    const Placement* keys = session.keys ? &session.keys_of(table).placements[i] : nullptr;
    if (keys != nullptr && keys->xpu < 0) {
      row.by = "off";
      continue;
    }
    const PriorityPlacement& at = session.of_table(table).placements[i];
    row.xpu_index = static_cast<std::uint32_t>(at.xpu);
    row.xpu = session.platform.xpus[static_cast<std::size_t>(at.xpu)].id;
    if (!scheduled) continue;
    row.by = keys != nullptr ? "key_us" : "priority";
    row.keys = keys != nullptr ? static_cast<std::uint32_t>(keys->key_us.size()) : 0;
    row.value = keys != nullptr ? keys->key_us.front() : at.priority;
  }
  return rows;
}

std::size_t first_table(const Session& session) {
  return session.tables ? static_cast<std::size_t>(session.tables->serves.front().table) : 0;
}

}  // namespace xauto::runtime
