// SPDX-License-Identifier: Apache-2.0
#include "session/limits.h"

#include <algorithm>

namespace xauto::runtime {

Limits Limits::of(const Deployment& deployment, const std::string& module, const std::string& xnode,
                  std::int64_t wcet_us) {
  const ModuleDeployment said = deployment.of(module);
  // In double: a percentage of the longest possible time does not fit otherwise.
  const auto share = [&](std::int64_t pct) {
    constexpr double kMax = 9e18;
    return static_cast<std::int64_t>(
        std::min(kMax, static_cast<double>(wcet_us) * static_cast<double>(pct) * 10));
  };
  Limits limits;
  if (const auto own = deployment.budgets_us.find(xnode); own != deployment.budgets_us.end())
    limits.budget_ns = own->second * 1000;
  else if (said.budget_pct)
    limits.budget_ns = share(*said.budget_pct);
  if (said.hang_us)
    limits.hang_ns = *said.hang_us * 1000;
  else if (said.hang_pct)
    limits.hang_ns = share(*said.hang_pct);
  limits.on_hang = said.on_hang.value_or(OnHang::kLog);
  return limits;
}

}  // namespace xauto::runtime
