// SPDX-License-Identifier: Apache-2.0
#include "xauto/worst_case.h"

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "model/claims.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

std::string refused(const PolicyRun& run) {
  return "`xauto check` refuses the policy: " + run.untrue;
}

}  // namespace

bool claims_nothing(const PolicyRun& run) {
  return run.keys && !run.keys->certified;
}

std::vector<ChainClaim> claimed_chains(const PolicyRun& run) {
  if (run.keys) return run.keys->chains;
  std::vector<ChainClaim> claims;
  if (!run.tables) return claims;
  const std::vector<std::int64_t> largest_us = largest_claims(*run.tables);
  for (std::size_t c = 0; c < largest_us.size(); ++c)
    claims.push_back({run.tables->tables.front().keys.chains[c].name, largest_us[c], 0, false});
  return claims;
}

std::optional<KeyClaims> key_claims_of(const RunFlags& flags, const PolicyRun& run) {
  const std::vector<ChainClaim> claimed = claimed_chains(run);
  if (run.scheduling != runtime::Scheduling::kXAuto || claims_nothing(run) ||
      (!run.keys && claimed.empty()))
    return std::nullopt;
  KeyClaims claims;
  claims.scope = scope_of(flags.app.one_at_a_time);
  claims.broken = run.report.unkept;
  if (!run.untrue.empty()) claims.broken.push_back(refused(run));
  claims.broken.insert(claims.broken.end(), run.report.broken.begin(), run.report.broken.end());
  std::uint64_t lost = 0;
  for (const runtime::ModuleReport& m : run.report.modules) lost += m.failed + m.dropped;
  if (lost > 0) claims.broken.push_back(fmt::format("{} activations were lost", lost));
  if (std::string met =
          runtime::words_of_overlaps(run.report.overlapping_releases, run.report.num_releases);
      !met.empty())
    claims.broken.push_back(std::move(met));
  if (std::string over = runtime::words_of_overruns(run.report); !over.empty())
    claims.broken.push_back(std::move(over));
  for (std::string& line : runtime::words_of_unended(run.report))
    claims.broken.push_back(std::move(line));
  for (std::string& line : runtime::words_of_deaths(run.report))
    claims.broken.push_back(std::move(line));
  std::size_t unmeasured = 0;
  std::int64_t exceeded_by_us = 0;
  const std::size_t count = std::min(claimed.size(), run.report.routes.size());
  for (std::size_t i = 0; i < count; ++i) {
    const runtime::Distribution& us = run.report.routes[i].latency_us;
    ChainClaimed chain{claimed[i], us.max(), us.count(), false};
    const std::int64_t worst_us = chain.claim.worst_case_us;
    const std::int64_t allowed_us =
        flags.emulates() ? worst_us + worst_us * kEmulatorPct / 100 : worst_us;
    // By tables each release was held against its own.
    chain.exceeded = run.tables ? run.report.routes[i].over_claim > 0
                                : chain.count > 0 && chain.max_us > allowed_us;
    const runtime::Distribution& urgent = run.report.routes[i].urgent_us;
    if (chain.claim.urgent_worst_case_us && urgent.count() > 0) {
      const std::int64_t urgent_us = *chain.claim.urgent_worst_case_us;
      chain.exceeded = chain.exceeded || urgent.max() > urgent_us + (allowed_us - worst_us);
    }
    claims.exceeded = claims.exceeded || chain.exceeded;
    if (chain.exceeded) exceeded_by_us = std::max(exceeded_by_us, chain.max_us - worst_us);
    // In lockstep there are results without a time; that is told by what is not kept.
    unmeasured += chain.count == 0 && run.report.routes[i].not_measured == 0 ? 1 : 0;
    claims.chains.push_back(std::move(chain));
  }
  if (count < claimed.size())
    claims.broken.push_back(
        fmt::format("{} of {} chains are not measured", claimed.size() - count, claimed.size()));
  if (unmeasured > 0)
    claims.broken.push_back(fmt::format("{} of {} chains had no result", unmeasured, count));
  claims.taken = taken_from(run.report, exceeded_by_us);
  return claims;
}

std::optional<runtime::TableClaims> table_claims_of(const RunFlags& flags, const PolicyRun& run) {
  if (!run.tables) return std::nullopt;
  return runtime::table_claims_of(run.report, flags.app.one_at_a_time);
}

std::string to_string(const runtime::TableClaims& claims, const std::vector<std::string>& taken,
                      Layout layout) {
  std::string text = fmt::format("worst cases of {}: {}", claims.scope,
                                 verdict(!claims.exceeded.empty(), claims.broken, taken, layout));
  constexpr std::size_t kShown = 3;
  const char* between = layout == Layout::kList ? "\n    " : "; ";
  for (std::size_t i = 0; i < std::min(kShown, claims.exceeded.size()); ++i)
    text += between + claims.exceeded[i];
  if (claims.exceeded.size() > kShown)
    text += fmt::format("{}{} more", between, claims.exceeded.size() - kShown);
  return text;
}

std::string to_string(const KeyClaims& claims, Layout layout) {
  return fmt::format("worst cases of {}: {}", claims.scope,
                     verdict(claims.exceeded, claims.broken, claims.taken, layout));
}

}  // namespace xauto::cli
