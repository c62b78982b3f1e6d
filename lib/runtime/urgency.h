// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 4: what an XNode's job is judged by, and before which instant it does not
// start. Out of the policy, looked up once.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "coord/rule.h"

namespace xauto::runtime {

class Urgency {
 public:
  /// The same for each job.
  [[nodiscard]] static Urgency of_priority(std::int64_t priority) {
    Urgency urgency;
    urgency.constant_ = coord::key_of_priority(priority);
    return urgency;
  }
  /// By the release: entry n mod size of each array belongs to activation n, and counts from its
  /// nominal release. `hold_us` may be empty: nobody is held. In an urgent release both are earlier by
  /// `urgent_by_us`, a hold not before that release.
  [[nodiscard]] static Urgency of_keys(const std::vector<std::int64_t>& key_us,
                                       const std::vector<std::int64_t>& hold_us,
                                       std::int64_t urgent_by_us = 0) {
    Urgency urgency;
    urgency.urgent_by_ns_ = urgent_by_us * 1000;
    urgency.by_release_ = true;
    for (const std::int64_t us : key_us) urgency.key_ns_.push_back(us * 1000);
    for (const std::int64_t us : hold_us) {
      urgency.hold_ns_.push_back(us * 1000);
      urgency.urgent_hold_ns_.push_back(std::max<std::int64_t>(0, us - urgent_by_us) * 1000);
    }
    return urgency;
  }
  /// Planned starts take the place of holds (model/early_start.h). Empty: its jobs, or the urgent ones, have none.
  void plan_starts(const std::vector<std::int64_t>& ordinary_us,
                   const std::vector<std::int64_t>& urgent_us) {
    hold_ns_.clear();
    urgent_hold_ns_.clear();
    for (const std::int64_t us : ordinary_us) hold_ns_.push_back(us * 1000);
    for (const std::int64_t us : urgent_us) urgent_hold_ns_.push_back(us * 1000);
  }

  /// Of activation `n`, whose nominal release is at `nominal_ns` of CLOCK_MONOTONIC.
  [[nodiscard]] coord::Key key(std::int64_t nominal_ns, std::uint64_t n,
                               bool urgent = false) const {
    if (!by_release_) return constant_;
    return nominal_ns + key_ns_[static_cast<std::size_t>(n % key_ns_.size())] -
           (urgent ? urgent_by_ns_ : 0);
  }
  /// How much of it comes from the release: the rest is the same for each job.
  [[nodiscard]] coord::Key of_release(std::int64_t nominal_ns, std::uint64_t n, bool urgent) const {
    return by_release_ ? key(nominal_ns, n, urgent) : 0;
  }
  [[nodiscard]] bool by_release() const { return by_release_; }
  /// That rest.
  [[nodiscard]] coord::Key constant() const { return by_release_ ? 0 : constant_; }
  /// As people ask for it instead (processes/prio.h).
  [[nodiscard]] coord::Key asked(std::int64_t nominal_ns, std::int64_t value) const {
    return by_release_ ? nominal_ns + value * 1000 : coord::key_of_priority(value);
  }
  /// Some of its jobs are not to start as soon as they could.
  [[nodiscard]] bool holds() const { return !hold_ns_.empty(); }
  /// Where `holds()`: the instant before which activation `n` does not start.
  [[nodiscard]] std::int64_t hold(std::int64_t nominal_ns, std::uint64_t n,
                                  bool urgent = false) const {
    const std::vector<std::int64_t>& holds_ns = urgent ? urgent_hold_ns_ : hold_ns_;
    return nominal_ns +
           (holds_ns.empty() ? 0 : holds_ns[static_cast<std::size_t>(n % holds_ns.size())]);
  }

 private:
  bool by_release_ = false;
  coord::Key constant_ = 0;  ///< not by release
  std::int64_t urgent_by_ns_ = 0;
  std::vector<std::int64_t> key_ns_, hold_ns_, urgent_hold_ns_;
};

}  // namespace xauto::runtime
