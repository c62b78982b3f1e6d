// SPDX-License-Identifier: Apache-2.0
// The rule: which of the jobs that want one XPU goes first, and which may go at all. Pure, and the
// only place that says so, with uapi/xauto/rule.h: the comparison itself, which the sched_ext
// scheduler shares. Those who ask: a worker's START and FINISH (worker_side.h), the
// coordinator (arbiter.h), the lane of jobs on one execution thread (runtime/worker.cc), and the
// explorers of the tests, which so try this very code.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include <uapi/xauto/rule.h>

namespace xauto::coord {

/// Pairs (u, v) of a policy's order constraints, indices into the app's xnodes.
using OrderPairs = std::vector<std::pair<std::uint32_t, std::uint32_t>>;

/// A job's urgency; the smaller is the more urgent. Of a policy of keys: an instant of
/// CLOCK_MONOTONIC in ns, by which the job is done. A priority is a key that does not depend on the
/// release.
using Key = std::int64_t;
constexpr Key key_of_priority(std::int64_t priority) {
  return -priority;  // policies bound it, so that this is no overflow
}
/// A client's word may be any number.
constexpr std::int64_t priority_of_key(Key key) {
  return key == std::numeric_limits<Key>::min() ? std::numeric_limits<std::int64_t>::max() : -key;
}

/// What a job is judged by.
struct Claim {
  Key key = 0;
  std::uint64_t since_ns = 0;  ///< when it asked for the XPU
  int slot = 0;                ///< makes the order total; nobody's choice

  bool operator==(const Claim&) const = default;
};

/// A total order: smaller key, then who asked first.
constexpr bool more_urgent(const Claim& a, const Claim& b) {
  return XAUTO_RULE_BEFORE(a, b);
}

/// Whether a job that comes takes the XPU from the one that has it: being as urgent is no reason.
constexpr bool takes(const Claim& comes, const Claim& has) {
  return XAUTO_RULE_TAKES(comes, has);
}

/// The most urgent of the claims shown to it.
class Next {
 public:
  constexpr void consider(const Claim& claim) {
    if (any_ && !more_urgent(claim, best_)) {
      more_ = true;
      return;
    }
    more_ = any_;
    any_ = true;
    best_ = claim;
  }
  /// Its slot; -1: there was none.
  [[nodiscard]] constexpr int slot() const { return any_ ? best_.slot : -1; }
  /// There was more than one.
  [[nodiscard]] constexpr bool more() const { return more_; }

 private:
  Claim best_;
  bool any_ = false, more_ = false;
};

/// Order constraints of one XPU: v#k is not started before u#k has finished.
class Order {
 public:
  Order() = default;
  explicit Order(const OrderPairs& pairs) {
    for (const auto& [u, v] : pairs) {
      const std::size_t size = std::size_t{u > v ? u : v} + 1;
      if (before_.size() < size) {
        before_.resize(size);
        tracked_.resize(size);
      }
      before_[v].push_back(u);
      if (tracked_[u] == 0) predecessors_.push_back(u);
      tracked_[u] = 1;
    }
  }
  /// `finished(u)`: how many activations of u are over, done or lost.
  template <class Finished>
  [[nodiscard]] bool eligible(std::uint32_t xnode, std::uint64_t sequence,
                              Finished finished) const {
    if (xnode >= before_.size()) return true;
    for (const std::uint32_t u : before_[xnode])
      if (finished(u) <= sequence) return false;
    return true;
  }
  /// Somebody waits for the activations of `xnode`.
  [[nodiscard]] bool tracks(std::uint32_t xnode) const {
    return xnode < tracked_.size() && tracked_[xnode] != 0;
  }
  /// All that somebody waits for.
  [[nodiscard]] const std::vector<std::uint32_t>& predecessors() const { return predecessors_; }

 private:
  std::vector<std::vector<std::uint32_t>> before_;  ///< [xnode] -> its predecessors
  std::vector<char> tracked_;                       ///< [xnode]
  std::vector<std::uint32_t> predecessors_;
};

}  // namespace xauto::coord
