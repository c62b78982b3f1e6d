// SPDX-License-Identifier: Apache-2.0
#include "parts/crossing_reader.h"

#include <algorithm>

namespace xauto::parts {

std::int64_t CrossingReader::Rule::by_ns(std::uint64_t number, bool urgent) const {
  const std::int64_t key = key_us[number % key_us.size()];
  const std::int64_t moved = std::max<std::int64_t>(0, key - (urgent ? urgent_by_us : 0));
  return releases.due_ns(number) + 1000 * (moved + key * more_pct / 100 + more_us + x_us);
}

bool CrossingReader::arrive(std::uint64_t first, const detail::Envelope& message,
                            std::int64_t nominal_ns, std::int64_t now_ns) {
  advance(now_ns);
  const std::uint64_t number = message.sequence;
  if (number >= next_ + kMostWaiting || nominal_ns != rule_.releases.due_ns(number)) {
    ++count_.refused;
    return false;
  }
  if (number < first_ || nominal_ns >= end_ns_) return false;  // from before we read, or after
  const std::int64_t late_ns = now_ns - rule_.by_ns(number, message.urgent);
  if (number < next_) {
    count_late(number, late_ns);
    return false;
  }
  const auto [at, fresh] = waiting_.try_emplace(number, message);
  if (!fresh) {
    ++count_.twice;
    return false;
  }
  for (std::uint64_t k = std::max(first, next_); k < number; ++k)
    waiting_.try_emplace(k, detail::Envelope{nullptr, message.origin_ns, k});
  // An urgent one whose own X is over, and that of an ordinary one is not.
  const bool in_time = late_ns <= 0;
  if (!in_time) {
    at->second = {nullptr, 0, number};
    lose(number);
    count_late(number, late_ns);
  } else if (message.message != nullptr) {
    count_.longest_ns = std::max(count_.longest_ns, late_ns + rule_.x_us * 1000);
  }
  advance(now_ns);
  return in_time;
}

/// What is complete, or lost, by now.
void CrossingReader::advance(std::int64_t now_ns) {
  while (!over()) {
    if (const auto at = waiting_.find(next_); at != waiting_.end()) {
      if (now_ns < rule_.releases.due_ns(next_)) return;
      count_.none += at->second.message == nullptr && last_lost_ != next_ + 1 ? 1 : 0;
      ready_.push_back(std::move(at->second));
      waiting_.erase(at);
    } else if (now_ns > rule_.by_ns(next_)) {
      ready_.push_back({nullptr, 0, next_});
      lose(next_);
    } else {
      return;
    }
    ++count_.expected;
    ++next_;
  }
}

void CrossingReader::lose(std::uint64_t number) {
  ++count_.lost;
  last_lost_ = number + 1;
  missing_[number % missing_.size()] = number + 1;
}

/// Something of a release that is settled.
void CrossingReader::count_late(std::uint64_t number, std::int64_t late_ns) {
  std::uint64_t& missing = missing_[number % missing_.size()];
  if (missing != number + 1) {
    ++count_.twice;
    return;
  }
  missing = 0;
  ++count_.late;
  count_.latest_ns = std::max(count_.latest_ns, late_ns);
}

void CrossingReader::pass(std::int64_t now_ns, const Deliver& deliver) {
  advance(now_ns);
  for (const detail::Envelope& envelope : ready_) deliver(envelope);
  ready_.clear();
}

std::int64_t CrossingReader::next_ns() const {
  if (over()) return INT64_MAX;
  return waiting_.contains(next_) ? rule_.releases.due_ns(next_) : rule_.by_ns(next_) + 1;
}

}  // namespace xauto::parts
