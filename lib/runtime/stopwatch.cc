// SPDX-License-Identifier: Apache-2.0
#include "runtime/stopwatch.h"

#include <algorithm>

namespace xauto::runtime {

void Stopwatch::begin(std::int64_t now_ns, std::uint64_t sequence) {
  since_.store(now_ns);
  sequence_.store(sequence);
  away_ns_.store(0);
  job_.fetch_add(1);
}

std::int64_t Stopwatch::end(std::int64_t now_ns) {
  const std::int64_t took_ns = took(now_ns);
  job_.fetch_add(1);
  return took_ns;
}

void Stopwatch::back(std::int64_t now_ns) {
  const std::int64_t since = away_since_.exchange(0);
  if (since != 0) away_ns_.fetch_add(now_ns - std::max(since, since_.load()));
}

std::int64_t Stopwatch::took(std::int64_t now_ns) const {
  const std::int64_t since = since_.load();
  const std::int64_t away_since = away_since_.load();
  const std::int64_t end = away_since == 0 ? now_ns : std::max(since, away_since);
  return std::max<std::int64_t>(0, end - since - away_ns_.load());
}

std::optional<Stopwatch::Look> Stopwatch::look(std::int64_t now_ns) const {
  const std::uint64_t job = job_.load();
  if (job % 2 == 0) return std::nullopt;
  const Look seen{job, sequence_.load(), took(now_ns)};
  if (job_.load() != job) return std::nullopt;  // it has just ended
  return seen;
}

}  // namespace xauto::runtime
