// SPDX-License-Identifier: Apache-2.0
#include "processes/jobs_above.h"

#include <algorithm>
#include <array>

namespace xauto {
namespace {

struct Part {
  int level;
  std::int64_t begin, end, longest;  ///< end below 0: it runs
};

/// Times that do not meet, in order.
class Covered {
 public:
  /// When a job that has begun then has had `own_ns` beside what is covered.
  [[nodiscard]] std::int64_t until(std::int64_t begin, std::int64_t own_ns) const {
    for (std::size_t i = 0; i < n_; ++i) {
      if (parts_[i].end <= begin) continue;
      const std::int64_t gap = std::max<std::int64_t>(0, parts_[i].begin - begin);
      if (gap >= own_ns) break;
      own_ns -= gap;
      begin = parts_[i].end;
    }
    return begin + own_ns;
  }
  void add(std::int64_t begin, std::int64_t end) {
    if (begin >= end) return;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < n_; ++i) {
      if (parts_[i].end < begin || parts_[i].begin > end) {
        parts_[kept++] = parts_[i];
        continue;
      }
      begin = std::min(begin, parts_[i].begin);
      end = std::max(end, parts_[i].end);
    }
    n_ = kept;
    while (kept > 0 && parts_[kept - 1].begin > begin) {
      parts_[kept] = parts_[kept - 1];
      --kept;
    }
    parts_[kept] = {begin, end};
    ++n_;
  }
  [[nodiscard]] std::int64_t ns() const {
    std::int64_t sum = 0;
    for (std::size_t i = 0; i < n_; ++i) sum += parts_[i].end - parts_[i].begin;
    return sum;
  }

 private:
  struct Time {
    std::int64_t begin, end;
  };
  std::array<Time, JobsAbove::kKept> parts_;
  std::size_t n_ = 0;
};

}  // namespace

std::uint64_t JobsAbove::begin(int level, std::int64_t now_ns, std::int64_t longest_ns) {
  const std::uint64_t job = begun_.fetch_add(1) + 1;
  Time& time = kept_[job % kKept];
  time.job.store(0);
  time.level.store(level);
  time.begin_ns.store(now_ns);
  time.longest_ns.store(longest_ns);
  time.end_ns.store(kRuns);
  time.job.store(job);
  return job;
}

void JobsAbove::end(std::uint64_t job, std::int64_t now_ns) {
  Time& time = kept_[job % kKept];
  if (time.job.load() == job) time.end_ns.store(now_ns);
}

std::int64_t JobsAbove::ns(int level, std::int64_t since_ns, std::int64_t until_ns) const {
  std::array<Part, kKept> parts;
  std::size_t n = 0;
  for (const Time& time : kept_) {
    const std::uint64_t job = time.job.load();
    const Part part{time.level.load(), time.begin_ns.load(), time.end_ns.load(),
                    time.longest_ns.load()};
    if (job == 0 || time.job.load() != job || part.level <= level) continue;
    if (part.begin < until_ns && (part.end == kRuns || part.end > since_ns)) parts[n++] = part;
  }
  // The highest first: what those above one that runs had is known when it comes.
  std::sort(parts.begin(), parts.begin() + static_cast<std::ptrdiff_t>(n),
            [](const Part& a, const Part& b) { return a.level > b.level; });
  Covered covered;
  for (std::size_t i = 0; i < n; ++i) {
    const auto [of, begin, end, longest] = parts[i];
    const std::int64_t last = end == kRuns ? covered.until(begin, longest) : end;
    covered.add(std::max(begin, since_ns), std::min(last, until_ns));
  }
  return covered.ns();
}

}  // namespace xauto
