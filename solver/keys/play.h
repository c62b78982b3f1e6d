// SPDX-License-Identifier: Apache-2.0
// Plays a policy of keys in virtual time: on every XPU the ready job with the smallest key, over
// releases that overlap, drift and sample each other. The same seed plays the same run. It shows
// what happens; what cannot happen, check.h proves.
//
//   An XNode's activations run in order. It is ready when its predecessors of the same activation
//   have ended (transfers included), its sources' messages are there, its hold is over, and, if it
//   enters its module, activation n - max_in_flight has left. Key and hold of an urgent release are
//   earlier. What starts while another job has started and not ended pays preempt_us once, if that was
//   suspended for it or the XPU has levels. Once as many have started as an XPU has levels, the running one
//   runs to its end. Everything that ends at one instant ends before any XPU decides.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto::solver::keys {

struct PlayOptions {
  std::int64_t seconds = 10;
  bool random_times = false;  ///< up to the WCET; otherwise each job takes it
  bool jitter = false;        ///< random, up to each source's; otherwise none
  bool phases =
      false;  ///< between clocks random, and they drift as far as they may; otherwise none
  std::uint64_t seed = 1;
  /// [xnode] Whoever has less goes first, whatever the keys say; of equal ones whoever was ready
  /// first. To play other rules beside keys. Empty: keys.
  std::vector<std::int64_t> rank = {};
  bool urgent = false;  ///< every other release that may be, at random; otherwise none
  /// [xnode] of whose app, where it is several (model/together.h): on an XPU that two of them have, and where preemption
  /// costs, nobody starts early. Empty: of one.
  std::vector<int> app_of = {};
  /// [xnode] execution times of its activations in us, from the first on again after the last, at most the WCET. Empty, or
  /// of an XNode empty: as `random_times` says.
  std::vector<std::vector<std::int64_t>> times_us = {};
};

struct PlayedXNode {
  std::int64_t jobs = 0;  ///< that have ended
  std::int64_t late = 0;  ///< of these, after their keys
  double closest_us = 0;  ///< largest end - key: below 0 where none was late
  std::int64_t suspended = 0;
};

struct PlayedChain {
  std::string name;
  std::int64_t releases = 0;                    ///< whose latency was seen
  double longest_us = 0;                        ///< reduced reaction time
  double median_us = 0, p99_us = 0;             ///< of the same; 0: none was seen
  std::optional<std::int64_t> claimed_us = {};  ///< none: the policy is not certified
  std::int64_t urgent = 0;                      ///< of `releases`
  double longest_urgent_us = 0;
  std::optional<std::int64_t> claimed_urgent_us = {};  ///< none also where no release may be

  [[nodiscard]] bool exceeded() const {
    return (claimed_us && longest_us > static_cast<double>(*claimed_us)) ||
           (claimed_urgent_us && longest_urgent_us > static_cast<double>(*claimed_urgent_us));
  }
};

struct PlayReport {
  std::vector<PlayedXNode> xnodes;
  std::vector<PlayedChain> chains;
  std::vector<double> busy;  ///< [xpu] part of the time
  std::int64_t jobs = 0, late = 0, suspended = 0;
  std::int64_t unfinished = 0;  ///< when it ended
  std::string first_late;       ///< in words, empty if none was
  bool backlog = false;         ///< it grew until the play was given up
};

[[nodiscard]] Result<PlayReport> play(const AppSpec& app, const Platform& platform,
                                      const Policy& policy, const PlayOptions& options);

}  // namespace xauto::solver::keys
