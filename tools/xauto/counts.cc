// SPDX-License-Identifier: Apache-2.0
#include "xauto/counts.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "base/clock.h"
#include "model/tables.h"
#include "session/distribution.h"
#include "session/table_claims.h"

namespace xauto::cli {
namespace {

FlowCounts flow_of(const runtime::FlowLine& line) {
  FlowCounts flow;
  flow.name = runtime::line_name(line.name);
  flow.results = line.results.load();
  flow.lost = line.lost.load();
  flow.late = line.late.load();
  flow.old = line.old.load();
  flow.over = line.over.load();
  flow.sum_us = line.sum_us.load();
  flow.last_ns = line.last_ns.load();
  flow.in_time_ns = line.in_time_ns.load();
  flow.period_us = line.period_us;
  flow.deadline_us = line.deadline_us;
  flow.age_limit_us = line.age_limit_us;
  flow.limit_us = line.limit_us();
  flow.last_origin_ns = line.last_origin_ns.load();
  flow.max_age_us = line.max_age_us.load();
  flow.last_us = line.last_us.load();
  flow.longest_us = line.longest_us.load();
  flow.worst_case_us = line.worst_case_us;
  flow.lower_bound_us = line.lower_bound_us;
  flow.allowed_us = line.allowed_us;
  flow.urgent_worst_case_us = line.urgent_worst_case_us;
  flow.urgent_allowed_us = line.urgent_allowed_us;
  flow.longest_urgent_us = line.longest_urgent_us.load();
  flow.gone = line.gone.load() != 0;
  flow.gone_or_back_ns = line.gone_or_back_ns.load();
  for (std::uint32_t b = 0; b < runtime::FlowLine::kBuckets; ++b)
    if (const std::uint32_t count = line.latency_us[b].load(std::memory_order_relaxed); count > 0) {
      flow.latency_us.resize(b + 1);
      flow.latency_us[b] = count;
    }
  return flow;
}

/// All chains as one.
FlowCounts together(const std::vector<FlowCounts>& chains) {
  FlowCounts sum;
  for (const FlowCounts& chain : chains) {
    sum.results += chain.results;
    if (chain.latency_us.size() > sum.latency_us.size())
      sum.latency_us.resize(chain.latency_us.size());
    for (std::size_t b = 0; b < chain.latency_us.size(); ++b)
      sum.latency_us[b] += chain.latency_us[b];
  }
  return sum;
}

ClaimCounts claims_of(const runtime::Board& board, const Counts& counts) {
  ClaimCounts claims;
  const bool tables = !counts.scenarios.empty();
  for (const FlowCounts& chain : counts.chains) {
    claims.claimed = claims.claimed || chain.worst_case_us > 0;
    claims.exceeded = claims.exceeded || chain.exceeds();
  }
  claims.claimed = claims.claimed || counts.whole.worst_case_us > 0;
  const auto spanned = board.header().spanned.read();
  claims.exceeded = claims.exceeded || counts.whole.exceeds() || (spanned && spanned->exceeds());

  const auto broken = [&](std::string line) {
    if (claims.claimed) claims.broken.push_back(std::move(line));
  };
  if (std::string unkept = board.unkept(); !unkept.empty()) broken(std::move(unkept));
  if (std::string line = board.contexts().not_complete(); !line.empty()) broken(std::move(line));
  for (std::uint32_t x = 0; x < board.shape().xpus; ++x)
    if (std::string slow = board.xpu(x).slow_suspensions(); !slow.empty()) broken(std::move(slow));
  std::uint64_t failed_suspends = 0, failed_resumes = 0;
  for (std::uint32_t n = 0; n < board.shape().nodes; ++n) {
    const runtime::XNodeLine& line = board.xnode(n);
    const std::uint32_t on = line.failed_on.load();
    const runtime::FailedPreemptionReport failed{
        runtime::line_name(line.name),
        on < board.shape().xpus ? runtime::line_name(board.xpu(on).name) : "",
        line.failed_suspends.load(), line.failed_resumes.load()};
    failed_suspends += failed.suspends;
    failed_resumes += failed.resumes;
    for (std::string& text : runtime::words_of(failed)) broken(std::move(text));
  }
  claims.violations.push_back({"failed_suspension", failed_suspends, claims.claimed});
  claims.violations.push_back({"failed_resumption", failed_resumes, claims.claimed});
  const auto count = [&](const char* kind, std::uint64_t n, bool breaks, const std::string& line) {
    claims.violations.push_back({kind, n, breaks && claims.claimed});
    if (n > 0 && breaks) broken(line);
  };
  board.contexts().each([&](const char* kind, std::uint32_t n, const char* what) {
    count(kind, n, true, fmt::format("{} {}", n, what));
  });
  const runtime::BoardHeader& header = board.header();
  const std::uint64_t late = board.late(), early = header.early.load();
  count("release_off_grid", late, true,
        fmt::format("{} releases were not where app.json's period and jitter have them, by up to "
                    "{} us{}",
                    late, (board.latest_ns() + 999) / 1000,
                    early > 0 ? fmt::format("; {} of them came too soon", early) : ""));
  const std::uint64_t overlapping = header.overlapping.load();
  count("release_overlap", overlapping, true,
        runtime::words_of_overlaps(overlapping, counts.released));
  const std::uint64_t jobs_outside = header.outside_jobs.load(),
                      clocks_outside = header.outside_clocks.load();
  count("job_outside_scenarios", jobs_outside, true,
        fmt::format("jobs were outside of every scenario, {} times", jobs_outside));
  count("clock_outside_scenarios", clocks_outside, true,
        fmt::format("the machine's clocks and modes were those of no scenario, {} times",
                    clocks_outside));
  const std::uint64_t unproven = header.unproven_switches.load(),
                      unsettled = header.unsettled.load();
  count("change_without_claim", unproven, true, runtime::words_of_unproven(unproven));
  count("change_too_soon", unsettled, true, runtime::words_of_unsettled(unsettled));
  std::uint64_t jobs = 0, overruns = 0, over_wcet = 0, hangs = 0, unended = 0, lost = 0;
  std::uint64_t deaths = header.daemon_deaths.load();
  for (std::uint32_t n = 0; n < board.shape().nodes; ++n) {
    jobs += board.xnode(n).jobs.load();
    overruns += board.xnode(n).overruns.load();
    over_wcet += board.xnode(n).over_wcet.load();
    hangs += board.xnode(n).hangs.load();
    unended += board.xnode(n).unended.load();
  }
  if (claims.claimed || tables)  // where nothing is claimed nobody looks
    claims.violations.push_back({"wcet_overrun", over_wcet + unended, claims.claimed});
  if (over_wcet > 0)
    broken(fmt::format("{} of {} jobs outran {}", over_wcet, jobs,
                       tables ? "the WCET of their scenario" : "their WCET"));
  for (std::uint32_t n = 0; n < board.shape().nodes; ++n) {
    const runtime::XNodeLine& line = board.xnode(n);
    const std::string name = runtime::line_name(line.name), of = runtime::line_name(line.module);
    if (std::string moved = line.words_of_moved(); !moved.empty()) broken(std::move(moved));
    if (const std::uint32_t jobs_left = line.unended.load(); jobs_left > 0)
      broken(runtime::words_of_unended(name, of, jobs_left, line.unended_ns.load() / 1000,
                                       line.unended_wcet_ns.load() / 1000));
    // By tables its XPU counts as lost, and they say what is claimed then.
    if (const std::uint64_t hung = line.hangs.load(); hung > 0 && !tables)
      broken(runtime::words_of_hangs(name, of, hung));
  }
  count("budget_overrun", overruns, false, {});
  claims.violations.push_back({"hang", hangs, claims.claimed && !tables});
  for (const ModuleCounts& module : counts.modules) {
    lost += module.failed + module.dropped;
    deaths += module.deaths;
  }
  count("lost_activation", lost, true, fmt::format("{} activations were lost", lost));
  count("process_death", deaths, true, "processes of the run died");
  return claims;
}

}  // namespace

ScenarioCounts scenario_of(const runtime::Board& board, std::uint32_t index) {
  const runtime::ScenarioLine& line = board.scenario(index);
  ScenarioCounts counts;
  counts.name = runtime::line_name(line.name);
  counts.table = runtime::line_name(line.table);
  counts.releases = line.releases.load();
  return counts;
}

namespace {

/// The app may write there what it likes.
std::optional<SpannedCounts> spanned_of(const runtime::Board& board) {
  const auto spanned = board.header().spanned.read();
  const runtime::BoardShape& shape = board.shape();
  if (!spanned || spanned->from >= shape.scenarios || spanned->to >= shape.scenarios ||
      spanned->flow >= shape.flows)
    return {};
  return SpannedCounts{
      runtime::line_name(board.scenario(spanned->from).name),
      runtime::line_name(board.scenario(spanned->to).name),
      spanned->flow == 0 ? "" : runtime::line_name(board.flow(spanned->flow).name),
      spanned->us,
      spanned->worst_case_us,
  };
}

}  // namespace

Counts counts_of(const runtime::Board& board) {
  Counts counts;
  counts.at_ns = now_ns();
  counts.released = board.released();
  const runtime::BoardShape& shape = board.shape();
  for (std::uint32_t m = 0; m < shape.modules; ++m) {
    const runtime::ModuleLine& line = board.module(static_cast<int>(m));
    counts.modules.push_back({runtime::line_name(line.name), line.activations.load(),
                              line.failed.load(), line.dropped.load(), line.deaths.load(),
                              line.off.load(), line.skipped.load()});
  }
  counts.whole = flow_of(board.flow(0));
  for (std::uint32_t f = 1; f < shape.flows; ++f) {
    counts.chains.push_back(flow_of(board.flow(f)));
    if (const std::uint32_t module = board.flow(f).module; module < shape.modules) {
      counts.chains.back().lost = counts.modules[module].failed + counts.modules[module].dropped;
      counts.chains.back().off = counts.modules[module].off;
    }
  }
  for (std::uint32_t x = 0; x < shape.xpus; ++x) {
    const runtime::XpuLine& line = board.xpu(x);
    counts.xpus.push_back(
        {runtime::line_name(line.name), line.suspensions.load(), line.busy_ns.load()});
  }
  for (std::uint32_t s = 0; s < shape.scenarios; ++s)
    counts.scenarios.push_back(scenario_of(board, s));
  if (shape.scenarios > 0) {
    const runtime::BoardHeader& header = board.header();
    const std::uint32_t scenario = header.scenario.load(), asked = header.asked.load();
    counts.scenario = scenario_of(board, scenario < shape.scenarios ? scenario : 0);
    counts.scenario->why = to_string(static_cast<Why>(std::min(header.why.load(), 255u)));
    counts.scenario->switches = header.switches.load();
    if (asked > 0 && asked <= shape.scenarios)
      counts.scenario->asked = runtime::line_name(board.scenario(asked - 1).name);
    counts.spanned = spanned_of(board);
  }
  counts.claims = claims_of(board, counts);
  return counts;
}

std::string scenario_text(const Counts& counts) {
  if (!counts.scenario) return {};
  const ScenarioCounts& s = *counts.scenario;
  return fmt::format("\n  scenario '{}' ({}), table '{}'; {} change{} of the table{}\n", s.name,
                     s.why, s.table, s.switches, s.switches == 1 ? "" : "s",
                     s.asked.empty() ? "" : ", asked for is '" + s.asked + "'") +
         spanned_text(counts);
}

std::string spanned_text(const Counts& counts) {
  if (!counts.spanned) return {};
  const SpannedCounts& s = *counts.spanned;
  return "  " +
         runtime::words_of_nearest(s.chain, s.us, s.worst_case_us, s.from, s.to,
                                   counts.claims.kept() ? "" : "*") +
         "\n";
}

Json spanned_json(const Counts& counts) {
  if (!counts.spanned) return {};
  const SpannedCounts& s = *counts.spanned;
  Json json = {{"from", s.from},
               {"to", s.to},
               {"us", s.us},
               {"worst_case_us", s.worst_case_us > 0 ? Json(s.worst_case_us) : Json()}};
  json["chain"] = s.chain;
  return json;
}

Json scenario_json(const Counts& counts) {
  const ScenarioCounts& s = *counts.scenario;
  return {{"name", s.name},         {"table", s.table},
          {"why", s.why},           {"asked", s.asked.empty() ? Json() : Json(s.asked)},
          {"switches", s.switches}, {"spanned", spanned_json(counts)}};
}

std::int64_t quantile_us(const std::vector<std::uint64_t>& buckets, double q) {
  std::uint64_t count = 0;
  for (const std::uint64_t b : buckets) count += b;
  if (count == 0) return -1;
  const auto rank = std::max<std::uint64_t>(
      1, static_cast<std::uint64_t>(std::ceil(q * static_cast<double>(count))));
  std::uint64_t seen = 0;
  for (std::size_t b = 0; b < buckets.size(); ++b)
    if ((seen += buckets[b]) >= rank)
      return runtime::Distribution::end_of(static_cast<std::uint32_t>(b));
  return -1;
}

FlowNumbers numbers_of(const FlowCounts& now, const FlowCounts& before, std::int64_t now_ns,
                       std::int64_t before_ns) {
  FlowNumbers n;
  n.results = now.results - std::min(now.results, before.results);
  if (now_ns > before_ns)
    n.rate_hz = static_cast<double>(n.results) * 1e9 / static_cast<double>(now_ns - before_ns);
  std::vector<std::uint64_t> buckets = now.latency_us;
  for (std::size_t b = 0; b < std::min(buckets.size(), before.latency_us.size()); ++b)
    buckets[b] -= std::min(buckets[b], before.latency_us[b]);
  n.p50_us = quantile_us(buckets, 0.5);
  n.p99_us = quantile_us(buckets, 0.99);
  n.max_us = quantile_us(buckets, 1);
  if (now.last_origin_ns > 0) n.age_us = (now_ns - now.last_origin_ns) / 1000;
  return n;
}

std::string progress_words(const Counts& now, const Counts& before) {
  const bool several = !now.single_rate();
  const FlowNumbers n =
      several ? numbers_of(together(now.chains), together(before.chains), now.at_ns, before.at_ns)
              : numbers_of(now.whole, before.whole, now.at_ns, before.at_ns);
  const std::int64_t p50 =
      quantile_us(several ? together(now.chains).latency_us : now.whole.latency_us, 0.5);
  if (p50 < 0) return "no result yet";
  return fmt::format("{:.1f}/s, p50 {:.2f} ms", n.rate_hz, static_cast<double>(p50) / 1000);
}

double progress_of(const Counts& now, std::uint64_t activations) {
  if (activations == 0 || !now.single_rate()) return -1;
  return static_cast<double>(now.whole.results + now.whole.lost) / static_cast<double>(activations);
}

}  // namespace xauto::cli
