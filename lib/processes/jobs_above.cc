// SPDX-License-Identifier: Apache-2.0
#include "processes/jobs_above.h"

#include <algorithm>

namespace xauto {
namespace {

constexpr int kLooks = 100;  ///< whoever writes may have died

}  // namespace

std::int64_t JobsAbove::Seen::own_ns(std::int64_t above_ns, std::int64_t now_ns) const {
  return std::max<std::int64_t>(0, now_ns - begin_ns - (above_ns - before_ns));
}

JobsAbove::Seen JobsAbove::look(const Level& level) {
  Seen seen{};
  for (int i = 0; i < kLooks; ++i) {
    const std::uint32_t version = level.version.load();
    seen = {level.runs.load() != 0, level.begin_ns.load(), level.longest_ns.load(),
            level.before_ns.load(), level.had_ns.load()};
    if (version % 2 == 0 && level.version.load() == version) break;
  }
  return seen;
}

std::int64_t JobsAbove::had_above(int level, std::int64_t now_ns) const {
  std::int64_t sum = 0;
  for (int above = high_.load() - 1; above > level; --above) {
    const Seen seen = look(levels_[above]);
    const std::int64_t own = seen.runs ? std::min(seen.longest_ns, seen.own_ns(sum, now_ns)) : 0;
    sum += seen.had_ns + own;
  }
  return sum;
}

JobsAbove::Begun JobsAbove::begin(int level, std::int64_t now_ns, std::int64_t longest_ns) {
  const Begun job{std::clamp(level, 0, kLevels - 1), had_above(level, now_ns)};
  int high = high_.load();
  while (high <= job.level && !high_.compare_exchange_weak(high, job.level + 1)) {
  }
  Level& of = levels_[job.level];
  const Seen lost = look(of);
  of.version.fetch_or(1);
  if (lost.runs)  // its process has died
    of.had_ns.fetch_add(std::min(lost.longest_ns, lost.own_ns(job.before_ns, now_ns)));
  of.begin_ns.store(now_ns);
  of.longest_ns.store(longest_ns);
  of.before_ns.store(job.before_ns);
  of.runs.store(1);
  of.version.fetch_add(1);
  return job;
}

void JobsAbove::end(const Begun& job, std::int64_t now_ns) {
  const std::int64_t above_ns = had_above(job.level, now_ns);
  Level& of = levels_[job.level];
  const Seen seen = look(of);
  if (!seen.runs) return;
  of.version.fetch_or(1);
  of.had_ns.fetch_add(seen.own_ns(above_ns, now_ns));
  of.runs.store(0);
  of.version.fetch_add(1);
}

}  // namespace xauto
