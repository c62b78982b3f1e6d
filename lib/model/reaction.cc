// SPDX-License-Identifier: Apache-2.0
#include "model/reaction.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "base/index.h"

namespace xauto {
namespace {

/// What each job knows of one source: its newest release, or -1.
class Knowledge {
 public:
  Knowledge(const AppSpec& app, const std::vector<RanJob>& jobs) : jobs_(jobs) {
    by_end_.resize(app.xnodes.size());
    read_.resize(app.xnodes.size());
    for (std::size_t j = 0; j < jobs.size(); ++j) by_end_[at(jobs[j].xnode)].push_back(j);
    for (auto& list : by_end_)
      std::ranges::stable_sort(list, {}, [&](std::size_t j) { return jobs[j].end_ns; });
    for (const auto& [u, v] : app.samples) read_[at(v)].push_back(u);
  }

  /// [job]
  std::vector<std::int64_t> of(int source) const {
    std::vector<std::int64_t> known(jobs_.size(), -1);
    // Of each XNode the jobs that have ended, and the newest release that any of them knew.
    std::vector<std::pair<std::size_t, std::int64_t>> ended(by_end_.size(), {0, -1});
    for (std::size_t j = 0; j < jobs_.size(); ++j) {
      const RanJob& job = jobs_[j];
      if (job.source == source) known[j] = job.release;
      if (job.from >= 0 && static_cast<std::size_t>(job.from) < j)
        known[j] = std::max(known[j], known[static_cast<std::size_t>(job.from)]);
      for (const int u : read_[at(job.xnode)]) {
        auto& [next, newest] = ended[at(u)];
        const std::vector<std::size_t>& list = by_end_[at(u)];
        while (next < list.size() && jobs_[list[next]].end_ns <= job.start_ns)
          newest = std::max(newest, known[list[next++]]);
        known[j] = std::max(known[j], newest);
      }
    }
    return known;
  }

  [[nodiscard]] const std::vector<std::size_t>& by_end(int xnode) const {
    return by_end_[at(xnode)];
  }

 private:
  const std::vector<RanJob>& jobs_;
  std::vector<std::vector<std::size_t>> by_end_;  ///< [xnode]
  std::vector<std::vector<int>> read_;            ///< [xnode] whom it samples
};

}  // namespace

std::vector<std::vector<std::int64_t>> reaction_times(
    const AppSpec& app, const std::vector<RanJob>& jobs,
    const std::vector<std::vector<std::int64_t>>& releases) {
  const Knowledge knowledge(app, jobs);
  std::vector<std::vector<std::int64_t>> times(app.chains.size());
  std::vector<std::size_t> order(app.chains.size());
  std::iota(order.begin(), order.end(), 0);
  std::ranges::stable_sort(order, {}, [&](std::size_t c) { return app.chains[c].from; });
  int source = -1;
  std::vector<std::int64_t> known;
  for (const std::size_t c : order) {
    const ChainSpec& chain = app.chains[c];
    if (std::exchange(source, chain.from) != chain.from || known.empty())
      known = knowledge.of(source);
    std::int64_t next = -1;  // release that nobody at the end has known
    for (const std::size_t j : knowledge.by_end(chain.to)) {
      if (known[j] < 0) continue;
      if (next < 0) next = known[j];
      const auto& nominal = releases[at(source)];
      for (; next <= known[j] && static_cast<std::size_t>(next) < nominal.size(); ++next)
        times[c].push_back(jobs[j].end_ns - nominal[static_cast<std::size_t>(next)]);
    }
  }
  return times;
}

}  // namespace xauto
