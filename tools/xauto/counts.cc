// SPDX-License-Identifier: Apache-2.0
#include "xauto/counts.h"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>

#include "base/clock.h"
#include "base/quantile.h"
#include "model/tables.h"
#include "processes/board_account.h"
#include "session/changes.h"
#include "session/distribution.h"

namespace xauto::cli {
namespace {

FlowCounts flow_of(const runtime::FlowLine& line, runtime::ChainAccount chain) {
  FlowCounts flow{std::move(chain)};
  flow.last_ns = line.last_ns.load();
  flow.in_time_ns = line.in_time_ns.load();
  flow.period_us = line.period_us;
  flow.limit_us = line.limit_us();
  flow.allowed_us = line.allowed_us;
  flow.last_origin_ns = line.last_origin_ns.load();
  flow.oldest_us = line.max_age_us.load();
  flow.last_us = line.last_us.load();
  flow.gone = line.gone.load() != 0;
  flow.gone_or_back_ns = line.gone_or_back_ns.load();
  return flow;
}

/// All chains as one.
runtime::Distribution together(const std::vector<FlowCounts>& chains) {
  runtime::Distribution sum;
  for (const FlowCounts& chain : chains) sum.merge(chain.latency_us);
  return sum;
}

/// What came since.
runtime::Distribution since(const runtime::Distribution& now, const runtime::Distribution& before) {
  std::map<std::uint32_t, std::uint64_t> buckets = now.buckets();
  for (const auto& [bucket, times] : before.buckets())
    if (const auto at = buckets.find(bucket); at != buckets.end())
      at->second -= std::min(at->second, times);
  std::erase_if(buckets, [](const auto& one) { return one.second == 0; });
  const std::int64_t max_us =
      buckets.empty() ? 0 : runtime::Distribution::end_of(buckets.rbegin()->first);
  runtime::Distribution news;
  static_cast<void>(runtime::Distribution::restore({}, buckets, 0, max_us, news));
  return news;
}

FlowNumbers numbers_between(const runtime::Distribution& now, const runtime::Distribution& before,
                            std::int64_t now_ns, std::int64_t before_ns) {
  FlowNumbers n;
  const runtime::Distribution news = since(now, before);
  n.results = news.count();
  if (now_ns > before_ns)
    n.rate_hz = static_cast<double>(n.results) * 1e9 / static_cast<double>(now_ns - before_ns);
  if (n.results == 0) return n;
  n.p50_us = news.quantile(0.5);
  if (n.results >= kLeastOfP99) n.p99_us = news.quantile(0.99);
  n.max_us = news.max();
  return n;
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
    if (line.host[0] != 0) continue;
    counts.modules.push_back({runtime::line_name(line.name), line.activations.load(),
                              line.failed.load(), line.dropped.load(), line.deaths.load(),
                              line.off.load(), line.skipped.load()});
  }
  counts.account = runtime::account_of(board);
  counts.whole = flow_of(board.flow(0), runtime::chain_of(board.flow(0)));
  std::vector<runtime::ChainAccount> chains = std::exchange(counts.account.chains, {});
  for (std::uint32_t f = 1; f < shape.flows; ++f) {
    const std::uint32_t module = board.flow(f).module;
    const runtime::ModuleLine* end =
        module < shape.modules ? &board.module(static_cast<int>(module)) : nullptr;
    if (end != nullptr && end->host[0] != 0) {
      counts.elsewhere.push_back({std::move(chains[f - 1].name), runtime::line_name(end->host)});
      continue;
    }
    counts.account.chains.push_back(std::move(chains[f - 1]));
    counts.chains.push_back(flow_of(board.flow(f), counts.account.chains.back()));
    if (end != nullptr) counts.chains.back().off = end->off.load();
  }
  for (std::uint32_t x = 0; x < shape.xpus; ++x) {
    const runtime::XpuLine& line = board.xpu(x);
    if (line.name[0] == 0) continue;
    counts.xpus.push_back(
        {runtime::line_name(line.name), line.suspensions.load(), line.busy_ns.load()});
  }
  for (std::uint32_t c = 0; c < shape.crossings; ++c) {
    const runtime::CrossingLine& line = board.crossing(c);
    counts.crossings.push_back({runtime::line_name(line.xnode), runtime::line_name(line.from),
                                runtime::line_name(line.to), line.x_us,
                                line.longest_ns.load() / 1000, line.messages.load(),
                                line.lost.load(), line.late.load()});
  }
  std::ranges::stable_sort(counts.crossings, {},
                           [](const CrossingCounts& c) { return std::pair(c.from, c.to); });
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
                                   counts.account.verdict() == runtime::Verdict::kKept ? "" : "*") +
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

FlowNumbers numbers_of(const FlowCounts& now, const FlowCounts& before, std::int64_t now_ns,
                       std::int64_t before_ns) {
  FlowNumbers n = numbers_between(now.latency_us, before.latency_us, now_ns, before_ns);
  if (now.last_origin_ns > 0) n.age_us = (now_ns - now.last_origin_ns) / 1000;
  return n;
}

std::string progress_words(const Counts& now, const Counts& before) {
  const auto all_of = [](const Counts& counts, bool several) {
    return several ? together(counts.chains) : counts.whole.latency_us;
  };
  const bool several = !now.single_rate();
  const runtime::Distribution all = all_of(now, several);
  if (all.count() == 0) return "no result yet";
  const FlowNumbers n = numbers_between(all, all_of(before, several), now.at_ns, before.at_ns);
  return fmt::format("{:.1f}/s, p50 {:.2f} ms", n.rate_hz,
                     static_cast<double>(all.quantile(0.5)) / 1000);
}

double progress_of(const Counts& now, std::uint64_t activations) {
  if (activations == 0 || !now.single_rate()) return -1;
  return static_cast<double>(now.whole.results() + now.whole.lost) /
         static_cast<double>(activations);
}

}  // namespace xauto::cli
