// SPDX-License-Identifier: Apache-2.0
#include "xauto/verdict.h"

#include <algorithm>

#include "model/claims.h"

namespace xauto::cli {

std::vector<std::string> taken_from(const runtime::RunReport& report, std::int64_t exceeded_by_us) {
  std::vector<runtime::TakenReport> list = report.taken;
  std::stable_sort(list.begin(), list.end(),
                   [](const auto& a, const auto& b) { return a.us > b.us; });
  constexpr std::size_t kShown = 5;
  std::vector<std::string> lines;
  for (const runtime::TakenReport& one : list)
    if (one.us >= std::min(kEmulatorUs, exceeded_by_us) && lines.size() < kShown)
      lines.push_back(one.what);
  if (lines.empty() && !report.not_watched.empty())
    lines.push_back("whether threads got their CPUs at once is not watched here (" +
                    report.not_watched + ")");
  return lines;
}

std::string verdict(bool exceeded, const std::vector<std::string>& broken,
                    const std::vector<std::string>& taken, Layout layout) {
  if (broken.empty() && !exceeded) return "kept, as far as it is watched";
  if (broken.empty() && taken.empty())
    return "exceeded, though nothing that is watched was broken; if `xauto check` agrees to the "
           "policy, please report this run";
  std::string text = !broken.empty() && !exceeded ? "not claimed here:"
                     : !broken.empty()            ? "exceeded, and not claimed here:"
                                       : "exceeded; the app broke nothing that is watched, but:";
  const std::vector<std::string>& why = broken.empty() ? taken : broken;
  const bool list = layout == Layout::kList && why.size() > 1;
  for (std::size_t i = 0; i < why.size(); ++i)
    text += (list ? "\n    - " : i == 0 ? " " : "; ") + why[i];
  return text;
}

}  // namespace xauto::cli
