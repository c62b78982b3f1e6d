// SPDX-License-Identifier: Apache-2.0
#include "runtime/shown_table.h"

#include <memory>

#include "base/log.h"
#include "session/policy_rows.h"
#include "xpu/policy_view.h"

namespace xauto::runtime {

std::function<void(std::size_t)> shower_of_tables(const Session& session) {
  if (!session.tables || session.cpu.policy.empty()) return [](std::size_t) {};
  auto view = xpu::PolicyView::open(session.cpu.policy);
  if (!view) {
    log::warn("the policy's BPF map will not show changes of the table: {}",
              view.error().to_string());
    return [](std::size_t) {};
  }
  return [&session, view = std::make_shared<xpu::PolicyView>(std::move(*view))](std::size_t table) {
    (void)view->put(policy_rows(session, table));  // of as many rows as it was made with
  };
}

}  // namespace xauto::runtime
