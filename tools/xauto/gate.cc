// SPDX-License-Identifier: Apache-2.0
#include "xauto/gate.h"

#include <algorithm>

#include <fmt/format.h>

namespace xauto::cli {
namespace {

bool asks(const RunFlags& flags, const std::string& word) {
  return std::find(flags.fail_on.begin(), flags.fail_on.end(), word) != flags.fail_on.end();
}

/// Results of chains that missed their deadline, or became too old.
GateCount misses(const runtime::RunReport& report) {
  GateCount gate{"miss", 0, {}};
  std::string chains;
  for (const runtime::ChainAccount& route : report.account.chains) {
    const std::uint64_t late = route.deadline_misses + route.age_misses;
    gate.count += late;
    if (late > 0)
      chains += fmt::format("{}{} of chain '{}'", chains.empty() ? ": " : ", ", late, route.name);
  }
  gate.what =
      fmt::format("{} results missed their deadline, or became too old{}", gate.count, chains);
  return gate;
}

}  // namespace

std::uint64_t lost_results(const runtime::RunReport& report) {
  if (report.num_releases > 0) return report.lost_releases;
  std::uint64_t count = 0;  // several rates: of each module whose results the app is there for
  for (const runtime::ModuleReport& module : report.modules)
    if (module.sink) count += module.failed + module.dropped + module.unended;
  return count;
}

Status check_gate(const RunFlags& flags, const PolicyRun& run) {
  const Deployment& deployment = flags.deployment;
  const bool deadline =
      std::any_of(flags.app.chains.begin(), flags.app.chains.end(),
                  [](const ChainSpec& c) { return c.deadline_us.has_value(); }) ||
      std::any_of(deployment.chains.begin(), deployment.chains.end(), [](const ChainDeployment& c) {
        return c.deadline_us.has_value() || c.max_age_us.has_value();
      });
  if (asks(flags, "miss") && !deadline)
    return fail(ErrorCode::kInvalid, "nothing has a deadline that could be missed",
                "--fail-on miss",
                "give the app, or a chain of it, `deadline_us`, or a chain of the "
                "deployment `deadline_us` or `max_age_us`");
  const auto limited = [](const ModuleDeployment& m) {
    return m.hang_us.has_value() || m.hang_pct.has_value();
  };
  if (asks(flags, "hang") && !limited(deployment.defaults) &&
      std::none_of(deployment.modules.begin(), deployment.modules.end(),
                   [&](const auto& m) { return limited(m.second); }))
    return fail(ErrorCode::kInvalid, "no XNode has a limit past which it hangs", "--fail-on hang",
                "give `hang_us` or `hang_pct` in the deployment");
  if (asks(flags, "claim") && run.scheduling == runtime::Scheduling::kXAuto && run.uncertified())
    return fail(ErrorCode::kInvalid, runtime::kNotCertified, "--fail-on claim",
                "leave it out, or run a certified policy");
  const bool claimed = run.keys || run.tables;
  if (asks(flags, "claim") && (run.scheduling != runtime::Scheduling::kXAuto || !claimed))
    return fail(ErrorCode::kInvalid, "the run claims no worst case", "--fail-on claim",
                "run a policy of `xauto solve`, with --scheduling xauto");
  return {};
}

std::vector<GateCount> gate_of(const RunFlags& flags, const PolicyRun& run) {
  std::vector<GateCount> counts;
  for (const std::string& word : kGateWords) {
    if (!asks(flags, word)) continue;
    GateCount gate{word, 0, {}};
    if (word == "miss") {
      gate = misses(run.report);
    } else if (word == "lost") {
      gate.count = lost_results(run.report);
      gate.what = fmt::format("{} activations were lost", gate.count);
    } else if (word == "hang") {
      for (const runtime::XNodeReport& x : run.report.xnodes) gate.count += x.hangs;
      gate.what = fmt::format("{} jobs ran past their hang limit", gate.count);
    } else if (word == "claim") {
      // Whatever else was broken.
      gate.count = static_cast<std::uint64_t>(
          std::ranges::count_if(run.report.account.chains, &runtime::ChainAccount::exceeded));
      gate.what = fmt::format("{} worst cases were exceeded", gate.count);
    } else {
      gate.count = run.outcome.deaths;
      gate.what = fmt::format("{} processes died, or were started again", gate.count);
    }
    counts.push_back(std::move(gate));
  }
  return counts;
}

}  // namespace xauto::cli
