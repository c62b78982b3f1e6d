// SPDX-License-Identifier: Apache-2.0
#include "xauto/worst_case.h"

#include <algorithm>

#include <fmt/format.h>

#include "model/claims.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

/// Jobs in the trace that ran for longer than their WCET, in words; empty: none. On real CPUs the
/// kernel preempts unseen, so nothing is said of them.
std::string overruns(const RunFlags& flags, const PolicyRun& run) {
  if (!run.story) return {};
  std::vector<bool> seen;
  for (std::size_t x = 0; x < flags.spec.xpus.size(); ++x)
    seen.push_back(!flags.kernel_schedules(x));
  const story::Overruns over = overruns_of(flags.app, flags.spec, *run.story, seen);
  if (over.count == 0) return {};
  return fmt::format(
      "{} of {} jobs outran their WCET, {} by {}", over.count, run.story->jobs.size(),
      flags.app.xnodes[static_cast<std::size_t>(over.worst)].name, ms(over.worst_us));
}

}  // namespace

std::optional<WorstCase> worst_case_of(const RunFlags& flags, const PolicyRun& run) {
  if (run.scheduling != runtime::Scheduling::kXAuto || !run.policy || !run.policy->worst_case_us)
    return std::nullopt;
  WorstCase worst;
  worst.us = *run.policy->worst_case_us;
  worst.exceeded = run.latency.max_us > worst.us;
  worst.broken = run.report.unkept;
  if (run.latency.count == 0) worst.broken.emplace_back("no release was measured");
  if (run.report.overlapping_releases > 0)
    worst.broken.push_back(fmt::format("{} of {} releases came while an earlier one was in flight",
                                       run.report.overlapping_releases, run.report.num_releases));
  if (std::string over = overruns(flags, run); !over.empty())
    worst.broken.push_back(std::move(over));
  if (!run.report.lost_coordinators.empty() || !run.report.died.empty())
    worst.broken.emplace_back("processes of the run died");
  return worst;
}

std::string to_string(const WorstCase& worst) {
  std::string text = fmt::format("worst case {}, of {}: ", ms(worst.us), kWorstCaseScope);
  if (worst.broken.empty())
    return text + (worst.exceeded ? "exceeded, though nothing that is watched was broken; please "
                                    "report this run"
                                  : "kept, as far as it is watched");
  text += worst.exceeded ? "exceeded, and not claimed here: " : "not claimed here: ";
  for (std::size_t i = 0; i < worst.broken.size(); ++i)
    text += (i == 0 ? "" : "; ") + worst.broken[i];
  return text;
}

}  // namespace xauto::cli
