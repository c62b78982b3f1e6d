// SPDX-License-Identifier: Apache-2.0
#include "processes/jobs_above.h"

#include <algorithm>
#include <array>
#include <utility>

namespace xauto {

std::uint64_t JobsAbove::begin(int level, std::int64_t now_ns, std::int64_t longest_ns) {
  const std::uint64_t job = begun_.fetch_add(1) + 1;
  Time& time = kept_[job % kKept];
  time.job.store(0);
  time.level.store(level);
  time.begin_ns.store(now_ns);
  time.end_ns.store(now_ns + longest_ns);
  time.job.store(job);
  return job;
}

void JobsAbove::end(std::uint64_t job, std::int64_t now_ns) {
  Time& time = kept_[job % kKept];
  if (time.job.load() == job) time.end_ns.store(now_ns);
}

std::int64_t JobsAbove::ns(int level, std::int64_t since_ns, std::int64_t until_ns) const {
  std::array<std::pair<std::int64_t, std::int64_t>, kKept> parts;
  std::size_t n = 0;
  for (const Time& time : kept_) {
    const std::uint64_t job = time.job.load();
    const std::int64_t begin = std::max(time.begin_ns.load(), since_ns);
    const std::int64_t end = std::min(time.end_ns.load(), until_ns);
    const bool above = time.level.load() > level;
    if (job == 0 || time.job.load() != job || !above || begin >= end) continue;
    parts[n++] = {begin, end};
  }
  std::sort(parts.begin(), parts.begin() + static_cast<std::ptrdiff_t>(n));
  std::int64_t sum = 0, covered_until = since_ns;
  for (std::size_t i = 0; i < n; ++i) {
    const auto [begin, end] = parts[i];
    sum += std::max<std::int64_t>(0, end - std::max(begin, covered_until));
    covered_until = std::max(covered_until, end);
  }
  return sum;
}

}  // namespace xauto
