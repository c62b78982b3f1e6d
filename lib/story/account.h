// SPDX-License-Identifier: Apache-2.0
// Why one release took as long as it did: the chain that set its latency, and of every microsecond
// of it where it went. Between a trace that was read back and what tells it (`xauto explain`,
// `xauto report`). Pure.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "story/trace_reader.h"

namespace xauto::story {

/// Who had the XPU (or the module) meanwhile, and for how much of the time.
struct Blocker {
  std::string who;  ///< an XNode; of another release: "NAME of release N"
  std::int64_t us = 0;
};

/// One XNode of the chain. The five parts are what passed from the end of the step before (or the
/// release) to the end of this one, without gap or overlap.
struct ChainStep {
  std::string xnode, xpu;
  std::int64_t begin_us = 0, end_us = 0;  ///< on the XPU, since the release
  std::int64_t handover_us = 0;           ///< until it was ready
  std::int64_t sensor_us = 0;  ///< several rates, of the handover: until the last message it takes
                               ///< was released
  std::int64_t waited_us = 0;  ///< ready, not on the XPU yet
  std::int64_t held_us = 0;    ///< so long of that, from the first on, by its policy
  std::int64_t ran_us = 0;
  std::int64_t switched_us = 0;   ///< being taken off and put back
  std::int64_t suspended_us = 0;  ///< off the XPU besides
  std::int64_t planned_us = -1;   ///< its time on the XPU in the plan; -1: unknown
  std::int64_t planned_end_us = -1;
  std::vector<Blocker> busy_with;  ///< during the handover: its own module's other releases
  std::vector<Blocker> waited_for, preempted_by;
  std::vector<Blocker> beside;  ///< while it ran, where nobody sees to it that one runs at a time
  [[nodiscard]] std::int64_t took_us() const {
    return handover_us + waited_us + ran_us + switched_us + suspended_us;
  }
};

struct Account {
  std::string chain;  ///< several rates: the module whose result it is; empty: the whole app's
  std::int64_t release = 0, latency_us = 0;
  std::int64_t rank = 1, of = 1;  ///< 1: the longest
  std::int64_t median_us = 0;     ///< of all releases
  std::int64_t planned_us = -1;   ///< end of the plan; -1: unknown
  std::vector<ChainStep> steps;   ///< in the order of time
  std::int64_t publish_us =
      0;  ///< after the last step; all steps and this are the latency, exactly
};

/// The release of the greatest latency, the first of several; of the median (of an even number the
/// lower) one. null: none was completed.
[[nodiscard]] const TraceRelease* worst_of(const std::vector<TraceRelease>& releases);
[[nodiscard]] const TraceRelease* median_of(const std::vector<TraceRelease>& releases);

/// Backwards from the last output, always to the XNode that handed over last. Errors: no such
/// release (kNotFound); it was dropped, its latency is not in the trace, or no arrow leads to its
/// output (kInfeasible).
[[nodiscard]] Result<Account> account_of(const ReadTrace& trace, std::int64_t release);
/// The same of a result of one chain, with several rates.
[[nodiscard]] Result<Account> account_of(const ReadTrace& trace, const TraceChain& chain,
                                         const TraceRelease& result);

/// Waits and overheads below this are not told.
inline constexpr std::int64_t kWorthSayingUs = 50;

/// What a step waited for, in words; parts below `least_us` are left out. Empty: nothing to say.
[[nodiscard]] std::string reasons_of(const ChainStep& step, std::int64_t least_us);

/// "waited 3.100 ms for a (3.000)", and for how long of it nobody had the XPU.
[[nodiscard]] std::string waited_text(std::int64_t us, const std::vector<Blocker>& waited_for);

/// The whole account for people.
[[nodiscard]] std::string account_text(const Account& account);

/// "26.104"
[[nodiscard]] std::string in_ms(std::int64_t us);

}  // namespace xauto::story
