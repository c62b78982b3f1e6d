// SPDX-License-Identifier: Apache-2.0
#include "xpu/policy_view.h"

namespace xauto::xpu {
namespace {

/// Cut, and 0 behind it.
template <std::size_t N>
void put_text(char (&field)[N], const std::string& text) {
  field[text.copy(field, N - 1)] = '\0';
}

std::vector<xauto_bpf_policy> all_shown(const std::vector<PolicyRow>& rows) {
  std::vector<xauto_bpf_policy> all;
  all.reserve(rows.size());
  for (const PolicyRow& row : rows) all.push_back(shown(row));
  return all;
}

}  // namespace

xauto_bpf_policy shown(const PolicyRow& row) {
  xauto_bpf_policy shown{};
  put_text(shown.xnode, row.xnode);
  put_text(shown.xpu, row.xpu);
  put_text(shown.by, row.by);
  shown.keys = row.keys;
  shown.value = row.value;
  shown.xpu_index = row.xpu_index;
  shown.table = row.table;
  return shown;
}

Result<PolicyView> PolicyView::create(const std::vector<PolicyRow>& rows) {
  XAUTO_ASSIGN(kernel::PolicyMap map, kernel::PolicyMap::create(all_shown(rows)));
  return PolicyView(std::move(map));
}

Result<PolicyView> PolicyView::open(const std::string& run) {
  XAUTO_ASSIGN(kernel::PolicyMap map, kernel::PolicyMap::open(run));
  return PolicyView(std::move(map));
}

Status PolicyView::put(const std::vector<PolicyRow>& rows) {
  return map_.put(all_shown(rows));
}

}  // namespace xauto::xpu
