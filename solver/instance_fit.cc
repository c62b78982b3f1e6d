// SPDX-License-Identifier: Apache-2.0
// See instance_fit.h.
#include "solver/instance_fit.h"

#include <algorithm>

#include "base/index.h"

namespace xauto::solver {

InstanceFit::InstanceFit(const Problem& problem) : problem_(problem) {}

bool InstanceFit::possible(const Windows& windows, std::int64_t steps) {
  windows_ = &windows;
  xpu_.assign(at(problem_.num_xnodes), -1);
  for (type_ = 0; type_ < problem_.num_types; ++type_) {
    const auto& xpus = problem_.type_xpus[at(type_)];
    items_.clear();
    here_.assign(xpus.size(), {});
    for (int i = 0; i < problem_.num_xnodes; ++i) {
      if (windows.types[at(i)] != TypeSet{1} << type_) continue;
      if (windows.place[at(i)] >= 0)
        here_[at(windows.place[at(i)])].push_back(i);
      else
        items_.push_back(i);
    }
    for (auto& here : here_) {
      std::stable_sort(here.begin(), here.end(),
                       [&](int i, int j) { return windows.d[at(i)] < windows.d[at(j)]; });
      if (!fits(here)) return false;
    }
    std::stable_sort(items_.begin(), items_.end(),
                     [&](int i, int j) { return windows.r[at(i)] < windows.r[at(j)]; });
    steps_ = steps;
    if (!place(0)) return false;
    if (steps_ < 0) continue;
    for (std::size_t k = 0; k < here_.size(); ++k)
      for (const int i : here_[k]) xpu_[at(i)] = xpus[k];
  }
  return true;
}

bool InstanceFit::place(std::size_t next) {
  if (next == items_.size()) return true;
  const int i = items_[next];
  for (auto& here : here_) {
    if (--steps_ < 0) return true;
    const bool empty = here.empty();
    const auto position =
        std::upper_bound(here.begin(), here.end(), windows_->d[at(i)],
                         [&](Time end, int other) { return end < windows_->d[at(other)]; });
    const auto offset = position - here.begin();
    here.insert(position, i);
    if (fits(here) && place(next + 1)) return true;
    here.erase(here.begin() + offset);
    if (empty) break;  // the other empty ones are alike
  }
  return false;
}

bool InstanceFit::fits(const std::vector<int>& here) const {
  for (const int first : here) {
    const Time a = windows_->r[at(first)];
    Time work = 0;
    for (const int i : here) {
      if (windows_->r[at(i)] < a) continue;
      work += problem_.wcet(i, type_) + windows_->paid[at(i)];
      if (work > windows_->d[at(i)] - a) return false;
    }
  }
  return true;
}

}  // namespace xauto::solver
