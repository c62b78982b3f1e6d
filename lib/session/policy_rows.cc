// SPDX-License-Identifier: Apache-2.0
#include "session/policy_rows.h"

#include <cstdint>
#include <string>

namespace xauto::runtime {
namespace {

/// Cut, and 0 behind it.
template <std::size_t N>
void put(char (&field)[N], const std::string& text) {
  field[text.copy(field, N - 1)] = '\0';
}

}  // namespace

std::vector<xauto_bpf_policy> policy_rows(const Session& session, std::size_t table) {
  const bool placed = session.scheduling != Scheduling::kRos2;
  const bool scheduled = session.scheduling == Scheduling::kXAuto;
  std::vector<xauto_bpf_policy> rows(session.app.xnodes.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    xauto_bpf_policy& row = rows[i];
    row.table = static_cast<__u32>(table);
    put(row.xnode, session.app.xnodes[i].name);
    put(row.by, "nobody");
    if (!placed) continue;
    const Placement* keys = session.keys ? &session.keys_of(table).placements[i] : nullptr;
    if (keys != nullptr && keys->xpu < 0) {
      put(row.by, "off");
      continue;
    }
    const PriorityPlacement& at = session.of_table(table).placements[i];
    row.xpu_index = static_cast<__u32>(at.xpu);
    put(row.xpu, session.platform.xpus[static_cast<std::size_t>(at.xpu)].id);
    if (!scheduled) continue;
    put(row.by, keys != nullptr ? "key_us" : "priority");
    row.keys = keys != nullptr ? static_cast<__u32>(keys->key_us.size()) : 0;
    row.value = keys != nullptr ? keys->key_us.front() : at.priority;
  }
  return rows;
}

std::size_t first_table(const Session& session) {
  return session.tables ? static_cast<std::size_t>(session.tables->serves.front().table) : 0;
}

}  // namespace xauto::runtime
