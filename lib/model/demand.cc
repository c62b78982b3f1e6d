// SPDX-License-Identifier: Apache-2.0
#include "model/demand.h"

#include <set>

#include "base/index.h"
#include "model/components.h"
#include "model/refusal.h"

namespace xauto {
namespace {

Status validate_job(const DemandJob& job, const DemandSequence& sequence,
                    const std::string& where) {
  XAUTO_TRY(in_range(job.release, 0, sequence.period - 1, "a release within the period",
                     where + "/release"));
  XAUTO_TRY(in_range(job.key, 1, kMaxDemandTicks, "a key", where + "/key"));
  XAUTO_TRY(in_range(job.ready, 0, job.key - 1, "a time before the key", where + "/ready"));
  XAUTO_TRY(in_range(job.start, sequence.once ? -kMaxDemandTicks : 0, job.ready,
                     "a time by when it is ready", where + "/start"));
  return in_range(job.work, 1, kMaxDemandTicks, "work", where + "/work");
}

Status validate_sequence(const DemandSequence& sequence, const std::string& where) {
  XAUTO_TRY(in_range(sequence.period, 1, 2 * kMaxDemandTicks, "a period", where + "/period"));
  XAUTO_TRY(in_range(sequence.ppm, 0, kMaxPpm, "a tolerance in ppm", where + "/ppm"));
  XAUTO_TRY(in_range(sequence.slip, 0, kMaxDemandTicks, "a time", where + "/slip"));
  if (sequence.slip > 0 && !sequence.once)
    return invalid("only what is there once slips", where + "/slip");
  if (sequence.jobs.empty() || sequence.jobs.size() > kMaxDemandJobs)
    return invalid(std::to_string(sequence.jobs.size()) + " jobs; 1 to " +
                       std::to_string(kMaxDemandJobs) + " are possible",
                   where + "/jobs");
  for (std::size_t k = 0; k < sequence.jobs.size(); ++k)
    XAUTO_TRY(validate_job(sequence.jobs[k], sequence, where + nth("jobs", k)));
  return {};
}

}  // namespace

double utilisation(const DemandOnXpu& on) {
  double sum = 0;
  for (const DemandSequence& sequence : on.sequences) {
    double work = 0;
    for (const DemandJob& job : sequence.jobs) work += static_cast<double>(job.work);
    const double shortest =
        static_cast<double>(sequence.period) * (1 - static_cast<double>(sequence.ppm) * 1e-6);
    if (!sequence.once) sum += work / shortest;
  }
  return sum;
}

Status has_demand(const AppSpec& app) {
  if (!app.one_at_a_time) return {};
  return fail(ErrorCode::kInvalid,
              "its sources have no rate: it takes all of its XPUs that it gets, and nothing can be "
              "claimed beside it",
              "app " + quoted(app.name), "state how often its sources release at most: rate_hz");
}

Status validate(const Demand& demand) {
  XAUTO_TRY(in_range(demand.ticks_per_us, 1, kMaxTicksPerUs, "ticks", "/ticks_per_us"));
  std::set<std::string_view> ids;
  for (std::size_t m = 0; m < demand.xpus.size(); ++m) {
    const DemandOnXpu& on = demand.xpus[m];
    const std::string where = nth("xpus", m);
    if (!ids.insert(on.xpu.id).second)
      return invalid("XPU " + quoted(on.xpu.id) + " is there twice", where + "/id");
    if (on.sequences.empty() || on.sequences.size() > kMaxDemandSequences)
      return invalid(std::to_string(on.sequences.size()) + " sequences; 1 to " +
                         std::to_string(kMaxDemandSequences) + " are possible",
                     where + "/sequences");
    for (std::size_t k = 0; k < on.sequences.size(); ++k)
      XAUTO_TRY(validate_sequence(on.sequences[k], where + nth("sequences", k)));
  }
  return {};
}

Status validate_on(const Demand& demand, const Platform& platform) {
  for (std::size_t m = 0; m < demand.xpus.size(); ++m) {
    const Xpu& theirs = demand.xpus[m].xpu;
    const int here = platform.find(theirs.id);
    if (here < 0)
      return invalid("XPU " + quoted(theirs.id) + " is not in platform " + quoted(platform.name),
                     nth("xpus", m) + "/id", "both need one platform.json");
    const Xpu& ours = platform.xpus[at(here)];
    if (ours.preemptive != theirs.preemptive || ours.preempt_us != theirs.preempt_us ||
        ours.levels != theirs.levels)
      return invalid("XPU " + quoted(theirs.id) + " preempts otherwise than in platform " +
                         quoted(platform.name),
                     nth("xpus", m), "both need one platform.json");
  }
  return {};
}

}  // namespace xauto
