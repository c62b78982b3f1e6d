// SPDX-License-Identifier: Apache-2.0
#include "xauto/report.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/log.h"
#include "base/quantile.h"
#include "model/hosts.h"
#include "model/json_value.h"
#include "session/account.h"
#include "session/changes.h"
#include "story/perfetto.h"
#include "story/run_trace.h"
#include "story/trace_reader.h"

#include "xauto/gate.h"

namespace xauto::cli {
namespace {

/// null where nothing was measured.
Json or_null(std::int64_t us, std::size_t count) {
  return count == 0 ? Json() : us;
}

/// Of fewer results p99 would be the longest or the second longest.
bool has_p99(const Latency& l) {
  return l.count >= kLeastOfP99;
}
Json p99_of(const Latency& l) {
  return has_p99(l) ? Json(l.p99_us) : Json();
}

/// "-" where nothing was measured.
std::string in_ms(std::int64_t us, std::size_t count) {
  return ms_in_row(count == 0 ? -1 : us);
}

std::string p99_ms(const Latency& l) {
  return has_p99(l) ? in_ms(l.p99_us, l.count) : "-";
}

/// Late results of chains. Missing: nothing has a deadline.
std::optional<std::uint64_t> deadline_misses(const PolicyRun& run) {
  std::optional<std::uint64_t> misses;
  for (const runtime::ChainAccount& r : run.report.account.chains)
    if (r.deadline_us > 0) misses = misses.value_or(0) + r.deadline_misses;
  return misses;
}

/// "-" where nothing is claimed, or stated.
std::string in_ms_if(std::int64_t us) {
  return in_ms(us, us > 0 ? 1 : 0);
}

/// The columns that a chain has wherever it is told: what was measured, claimed and stated.
std::string chain_row(const std::string& name, const runtime::ChainAccount& chain,
                      const char* mark = "") {
  const Latency l = summarise(chain.latency_us);
  const std::string worst = in_ms_if(chain.worst_case_us);
  return row_of(name, kNameColumns) +
         fmt::format("{:>7}{:>7}{:>7}{:>8}{:>9}{:>7}{:>6}\n", in_ms(l.p50_us, l.count), p99_ms(l),
                     in_ms(l.max_us, l.count), chain.worst_case_us > 0 ? mark + worst : worst,
                     chain.deadline_us > 0 ? in_ms(chain.deadline_us, 1) : "",
                     chain.deadline_us > 0 ? std::to_string(chain.deadline_misses) : "", l.count);
}

std::string chain_head(const std::string& name) {
  return row_of(name, kNameColumns) + fmt::format("{:>7}{:>7}{:>7}{:>8}{:>9}{:>7}{:>6}\n", "p50",
                                                  "p99", "max", "claimed", "deadline", "missed",
                                                  "n");
}

/// Chains, each beside what is claimed of it, and what became of the claims.
std::string chains_table(const PolicyRun& run) {
  const runtime::Account& account = run.report.account;
  std::string out = "\n" + chain_head(run.name);
  for (const runtime::ChainAccount& chain : account.chains) {
    out += chain_row(chain.name, chain);
    // By tables the worst case of the row is the largest of all: which one was exceeded is told below.
    if (chain.exceeded())
      out += "    exceeded\n";
    else if (!run.tables && chain.worst_case_us > 0 && chain.longest_us > chain.worst_case_us)
      out += "    within the emulator's part\n";
    if (chain.urgent_us.count() == 0) continue;
    const Latency u = summarise(chain.urgent_us);
    out += row_of("  urgent", kNameColumns) +
           fmt::format("{:>7}{:>7}{:>7}{:>8}{:>22}\n", in_ms(u.p50_us, u.count), p99_ms(u),
                       in_ms(u.max_us, u.count), in_ms_if(chain.urgent_worst_case_us), u.count);
  }
  if (account.verdict() != runtime::Verdict::kNothingClaimed || !account.why_nothing.empty())
    out += fmt::format("\n  {}: {}\n", run.name, account.words(runtime::Layout::kList));
  return out;
}

/// Of several runs: each chain under each policy.
std::string compared_chains(const RunFlags& flags, const std::vector<PolicyRun>& runs) {
  // A worst case that this run has refuted, or that it does not keep to, is marked.
  const auto mark = [](const PolicyRun& run) {
    return run.report.account.verdict() == runtime::Verdict::kKept ? "" : "*";
  };
  std::string out = chain_head("chain");
  for (std::size_t c = 0; c < flags.app.chains.size(); ++c) {
    out += "  " + cut(flags.app.chains[c].name, kLineColumns - 2) + "\n";
    for (const PolicyRun& run : runs)
      if (c < run.report.account.chains.size())
        out += chain_row("  " + run.name, run.report.account.chains[c], mark(run));
  }
  for (const PolicyRun& run : runs)
    if (run.report.account.claims())
      out += fmt::format("\n  {}{}{}: {}\n", mark(run), *mark(run) == '\0' ? "" : " ", run.name,
                         run.report.account.words(runtime::Layout::kList));
  out +=
      "\n  A chain's time is from a release to the end of the first job that knows it or a newer "
      "one.\n  One run each. Where \"-\" stands, nothing is claimed; * is told above.\n";
  return out;
}

/// Chains and XNodes with limits. `who` begins each line: the policy, where there are several.
std::string limits_table(const PolicyRun& run, const std::string& who) {
  std::string out;
  if (std::any_of(run.report.account.chains.begin(), run.report.account.chains.end(),
                  [](const runtime::ChainAccount& r) { return r.max_age_us > 0; })) {
    out += "\n" + row_of(who + "chain", kNameColumns) +
           fmt::format("{:>9}{:>9}{:>7}\n", "age max", "at most", "old");
    for (const runtime::ChainAccount& r : run.report.account.chains)
      out += row_of(who + r.name, kNameColumns) +
             fmt::format("{:>9}{:>9}{:>7}\n", in_ms(r.age_us.max(), r.age_us.count()),
                         r.max_age_us > 0 ? in_ms(r.max_age_us, 1) : "",
                         r.max_age_us > 0 ? std::to_string(r.age_misses) : "");
  }
  if (const runtime::EarlyStartReport& early = run.report.early_starts; early.jobs > 0)
    out += fmt::format("  {}{} jobs began before their planned start, together by {} ms\n", who,
                       early.jobs, in_ms(early.sum_us, 1));
  // Told here as well where nothing is claimed.
  for (const runtime::Assumption& one : run.report.account.assumptions)
    if (one.kind == "failed_suspension" || one.kind == "failed_resumption")
      for (const std::string& text : one.words) out += fmt::format("  {}{}\n", who, text);
  for (const runtime::XNodeReport& x : run.report.xnodes)
    if (x.overruns > 0 || x.hangs > 0)
      out += fmt::format(
          "  {}XNode {}: of {} jobs {} exceeded {} ms, {} hung; the longest took {} ms\n", who,
          x.name, x.jobs, x.overruns, in_ms(x.budget_us, 1), x.hangs, in_ms(x.longest_us, x.jobs));
  return out;
}

/// What came from other hosts, each beside its X.
std::string crossings_table(const runtime::RunReport& report) {
  if (report.crossings.empty()) return {};
  std::string out = "\n" + row_of("between hosts", kNameColumns) +
                    fmt::format("{:>9}{:>9}{:>7}{:>8}{:>8}\n", "longest", "X", "lost", "late", "n");
  for (const runtime::CrossingReport& of : report.crossings)
    out += row_of(of.xnode + " from " + of.from + " to " + of.to, kNameColumns) +
           fmt::format("{:>9}{:>9}{:>7}{:>8}{:>8}\n", in_ms(of.longest_us, of.messages),
                       in_ms(of.x_us, 1), of.lost, of.late, of.messages);
  return out + "\n  Longest: from the sender's key to when it was there, by the reader's clock.\n";
}

std::string losses_of(const PolicyRun& run) {
  std::string out;
  for (const runtime::ModuleReport& m : run.report.modules) {
    if (m.failed + m.dropped + m.unended > 0)
      out += fmt::format("  {}: XModule {}: {} activations done, {} dropped, {} failed{}\n",
                         run.name, m.name, m.activations, m.dropped, m.failed,
                         m.unended > 0 ? fmt::format(", {} did not end", m.unended) : "");
    if (m.skipped > 0)
      out += fmt::format(
          "  {}: XModule {}: {} activations done, {} skipped, as `overload: skip` or a "
          "change of tables that drained says\n",
          run.name, m.name, m.activations, m.skipped);
  }
  return out;
}

/// How far the runs of a comparison are apart, against how far each is spread.
std::string spread_of(const std::vector<PolicyRun>& runs) {
  if (runs.size() < 2) return {};
  std::string out =
      "\n  Of a whole release, within a run, in ms, from the 10th to the 90th percentile:\n";
  for (const PolicyRun& run : runs)
    out += row_of(run.name, kNameColumns) +
           fmt::format("{:>7} to {:>6}\n", in_ms(run.latency.p10_us, run.latency.count),
                       in_ms(run.latency.p90_us, run.latency.count));
  const auto holds = [](const PolicyRun& run, std::int64_t us) {
    return run.latency.p10_us <= us && us <= run.latency.p90_us;
  };
  for (std::size_t a = 0; a < runs.size(); ++a)
    for (std::size_t b = a + 1; b < runs.size(); ++b)
      if (runs[a].latency.count > 0 && runs[b].latency.count > 0 &&
          holds(runs[a], runs[b].latency.p50_us) && holds(runs[b], runs[a].latency.p50_us))
        out += fmt::format(
            "  {} and {}: the difference is noise. Each median is within the other's spread.\n",
            runs[a].name, runs[b].name);
  return out;
}

const PolicyRun* ros2_of(const std::vector<PolicyRun>& runs) {
  const auto at = std::find_if(runs.begin(), runs.end(), [](const PolicyRun& r) {
    return r.scheduling == runtime::Scheduling::kRos2;
  });
  return at == runs.end() ? nullptr : &*at;
}

/// Missing: one of the two was not measured.
std::optional<double> ratio(const Latency& a, std::int64_t Latency::*of, const Latency& b) {
  if (!has_p99(a) || !has_p99(b) || b.*of == 0) return std::nullopt;
  return static_cast<double>(a.*of) / static_cast<double>(b.*of);
}

/// "emulated XPUs", "real XPUs", or which is which.
std::string xpus_text(const RunFlags& flags) {
  const std::string said = xpu::describe(flags.spec, flags.presence);
  if (said.empty()) return "real XPUs";
  return said == "emulated" ? "emulated XPUs" : "XPUs " + said;
}

/// From the first event that is there to the last.
double traced_s(const trace::Recording& trace) {
  if (trace.events.empty()) return 0;
  return static_cast<double>(trace.events.back().ts_ns - trace.events.front().ts_ns) * 1e-9;
}

/// Why the run's exit status is 1.
std::vector<Error> complaints(const PolicyRun& run) {
  std::vector<Error> found;
  const auto add = [&](std::string what, std::string hint = {}) {
    found.push_back({ErrorCode::kUnavailable, std::move(what), "run " + run.name, std::move(hint)});
  };
  if (!run.report.complete) {
    std::string why = run.report.note;
    for (const std::string& note : run.outcome.notes) why += (why.empty() ? "" : "; ") + note;
    add("is not complete" + (why.empty() ? "" : ": " + why));
  }
  if (const std::uint64_t lost = run.report.lost_releases; lost > 0) {
    std::string modules;
    std::uint64_t failed = 0;
    for (const runtime::ModuleReport& m : run.report.modules) {
      if (m.failed + m.dropped + m.unended == 0) continue;
      modules += fmt::format("{}{}: {} failed, {} dropped{}", modules.empty() ? "" : "; ", m.name,
                             m.failed, m.dropped,
                             m.unended > 0 ? fmt::format(", {} did not end", m.unended) : "");
      failed += m.failed + m.unended;
    }
    add(fmt::format("{} of {} activations were lost (of XModule {})", lost, run.report.num_releases,
                    modules),
        failed > 0 || !run.report.died.empty()
            ? ""
            : "a message that comes while its XModule is not free is dropped; --overload queue:8 "
              "keeps it, --lockstep lets it come later");
  }
  for (const std::string& xpu : run.report.lost_coordinators)
    add("the jobs of " + xpu + " went on unscheduled, as its coordinator was gone");
  for (const std::string& gone : run.outcome.gone)
    add(gone + ", and nothing took its place", "the deployment's `restarts` has it started again");
  if (run.outcome.emulator_died) add("the emulated XPUs are gone");
  return found;
}

/// What met a change.
std::string nearest_text(const runtime::RunReport& report) {
  const runtime::SwitchReport* s = runtime::nearest(report);
  if (s == nullptr) return {};
  return "  " +
         runtime::words_of_nearest(s->chain, s->spanned_us, s->worst_case_us.value_or(0), s->from,
                                   s->to) +
         "\n";
}

/// The last changes.
std::string changes_text(const runtime::RunReport& report) {
  std::string out;
  constexpr std::size_t kShown = 5;
  const std::size_t first = report.switches.size() - std::min(kShown, report.switches.size());
  for (std::size_t i = first; i < report.switches.size(); ++i) {
    const runtime::SwitchReport& s = report.switches[i];
    out += fmt::format("  release {}: '{}', table '{}' ({}){}{}\n", s.release, s.to, s.table, s.why,
                       s.detail.empty() ? "" : ": " + s.detail,
                       s.held_us == 0 ? ""
                                      : fmt::format("; nothing was released for {} ms, while it "
                                                    "drained",
                                                    in_ms(s.held_us, 1)));
  }
  return out;
}

/// Releases of all sources, each with its own clock's. What is claimed is of chains.
std::string tables_text(const runtime::RunReport& report) {
  std::string out =
      "\n" + row_of("scenario", kNameColumns) + fmt::format("{:>10}  table\n", "releases");
  for (const runtime::ScenarioReport& s : report.scenarios)
    if (s.releases > 0)
      out += wrapped(row_of(s.name, kNameColumns) + fmt::format("{:>10}  {}", s.releases, s.table),
                     6) +
             "\n";
  return out +
         fmt::format("\n  {} change{} of the scenario\n", report.num_switches,
                     report.num_switches == 1 ? "" : "s") +
         nearest_text(report) + changes_text(report);
}

}  // namespace

bool is_healthy(const PolicyRun& run) {
  const std::vector<Error> found = complaints(run);
  for (const Error& error : found) log::error("{}", error.to_string());
  return found.empty();
}

namespace {

Json modules_json(const PolicyRun& run) {
  Json modules = Json::array();
  for (const runtime::ModuleReport& m : run.report.modules) {
    Json entry = {{"name", m.name},
                  {"activations", m.activations},
                  {"failed", m.failed},
                  {"dropped", m.dropped}};
    if (m.off > 0) entry["off"] = m.off;
    if (m.skipped > 0) entry["skipped"] = m.skipped;
    if (m.unended > 0) entry["unended"] = m.unended;
    if (m.sink) {
      const Latency latency = summarise(m.latencies_us);
      entry["p50_us"] = or_null(latency.p50_us, latency.count);
      entry["p99_us"] = p99_of(latency);
      entry["max_us"] = or_null(latency.max_us, latency.count);
    }
    modules.push_back(std::move(entry));
  }
  return modules;
}

Json chains_json(const PolicyRun& run) {
  Json chains = Json::array();
  for (const runtime::ChainAccount& chain : run.report.account.chains)
    chains.push_back(runtime::chain_json(chain));
  return chains;
}

/// Those with limits.
Json xnodes_json(const PolicyRun& run) {
  Json xnodes = Json::array();
  for (const runtime::XNodeReport& x : run.report.xnodes) {
    Json entry = {
        {"name", x.name}, {"jobs", x.jobs}, {"longest_us", or_null(x.longest_us, x.jobs)}};
    if (x.budget_us > 0) {
      entry["budget_us"] = x.budget_us;
      entry["overruns"] = x.overruns;
    }
    if (x.wcet_us > 0) entry["wcet_us"] = x.wcet_us;
    if (x.wcet_us > 0 || run.tables) entry["over_wcet"] = x.over_wcet;
    if (x.unended > 0) {
      entry["unended"] = x.unended;
      entry["unended_us"] = x.unended_us;
    }
    if (x.hang_us > 0) {
      entry["hang_us"] = x.hang_us;
      entry["hangs"] = x.hangs;
    }
    xnodes.push_back(std::move(entry));
  }
  return xnodes;
}

/// `base`: what the others are compared with; null: nothing.
Json run_json(const RunFlags& flags, const PolicyRun& run, const PolicyRun* base) {
  const std::size_t n = run.latency.count;
  const auto misses = deadline_misses(run);
  const auto& share = run.outcome.coordinators_share;
  Json j = {{"policy", run.id},
            {"name", run.name},
            {"p50_us", or_null(run.latency.p50_us, n)},
            {"p99_us", p99_of(run.latency)},
            {"max_us", or_null(run.latency.max_us, n)},
            {"mean_us", or_null(run.latency.mean_us, n)},
            {"p10_us", or_null(run.latency.p10_us, n)},
            {"p90_us", or_null(run.latency.p90_us, n)},
            {"activations", n},
            {"lost_activations", lost_results(run.report)},
            {"complete", run.report.complete},
            {"deadline_misses", misses},
            {"scheduling", runtime::to_string(run.scheduling)},
            {"trace_events_lost", run.outcome.trace.lost},
            {"trace_events_overwritten", run.outcome.trace.overwritten},
            {"trace_us", std::llround(traced_s(run.outcome.trace) * 1e6)},
            {"coordinators_cpu_pct", share ? Json(*share * 100) : Json()}};
  if (!flags.fail_on.empty()) {
    Json gate = Json::object();
    for (const GateCount& g : gate_of(flags, run)) gate[g.word] = g.count;
    j["fail_on"] = std::move(gate);
  }
  if (base != nullptr) {
    const auto times = ratio(base->latency, &Latency::p99_us, run.latency);
    j["p99_speedup_over_ros2"] = times;
  }
  if (run.policy) {
    if (run.uncertified()) j["certified"] = false;
    Json placement = Json::object();
    for (std::size_t i = 0; i < flags.app.xnodes.size(); ++i)
      placement[flags.app.xnodes[i].name] =
          flags.spec.xpus[static_cast<std::size_t>(run.policy->placements[i].xpu)].id;
    j["placement"] = std::move(placement);
  }
  j["modules"] = modules_json(run);
  j["chains"] = chains_json(run);
  j["claims"] = runtime::claims_json(run.report.account);
  if (run.tables) runtime::add_changes(run.report, j);
  j["limited_xnodes"] = xnodes_json(run);
  for (const runtime::PreemptionReport& of : run.report.preemptions)
    j["preemptions"].push_back({{"xpu", of.xpu},
                                {"suspensions", of.suspensions},
                                {"suspend_us", of.suspend_us},
                                {"resume_us", of.resume_us},
                                {"preempt_us", of.preempt_us}});
  for (const runtime::CrossingReport& of : run.report.crossings)
    j["crossings"].push_back({{"xnode", of.xnode},
                              {"from", of.from},
                              {"to", of.to},
                              {"x_us", of.x_us},
                              {"messages", of.messages},
                              {"longest_us", of.longest_us},
                              {"lost", of.lost},
                              {"late", of.late},
                              {"latest_us", of.latest_us},
                              {"twice", of.twice},
                              {"refused", of.refused},
                              {"other_runs", of.other_runs}});
  if (const runtime::EarlyStartReport& early = run.report.early_starts; early.on)
    j["early_starts"] = {{"jobs", early.jobs}, {"sum_us", early.sum_us}};
  Json notes = Json::array();
  if (!run.report.note.empty()) notes.push_back(run.report.note);
  for (const std::string& note : run.outcome.notes) notes.push_back(note);
  j["notes"] = std::move(notes);
  if (!run.outcome.real_cpus.empty()) j["real_cpus"] = run.outcome.real_cpus;
  return j;
}

}  // namespace

std::string report_json(const RunFlags& flags, const std::vector<PolicyRun>& runs) {
  Json list = Json::array(), real = Json::array();
  const PolicyRun* base = ros2_of(runs);
  for (const PolicyRun& run : runs) list.push_back(run_json(flags, run, base));
  for (std::size_t x = 0; x < flags.presence.size(); ++x)
    if (flags.presence[x] == Presence::kReal) real.push_back(flags.spec.xpus[x].id);
  return Json{{"schema", "xauto.report"},     {"version", 1},
              {"app", flags.app.name},        {"platform", flags.spec.name},
              {"emulated", flags.emulates()}, {"real_xpus", std::move(real)},
              {"runs", std::move(list)}}
             .dump(2) +
         "\n";
}

std::string report_table(const RunFlags& flags, const std::vector<PolicyRun>& runs) {
  std::string out = fmt::format("{} on {}{}, end-to-end latency in ms\n\n", flags.app.name,
                                flags.spec.name, in_parentheses(flags.spec, flags.presence));
  const bool by_chains = runs.size() > 1;
  if (by_chains)
    out += compared_chains(flags, runs);
  else
    out += row_of("policy", kNameColumns) +
           fmt::format("{:>7}{:>7}{:>7}{:>30}\n", "p50", "p99", "max", "n");
  for (const PolicyRun& run : runs) {
    if (by_chains) break;
    const Latency& l = run.latency;
    out += row_of(run.name, kNameColumns) + fmt::format("{:>7}{:>7}{:>7}{:>30}\n",
                                                        in_ms(l.p50_us, l.count), p99_ms(l),
                                                        in_ms(l.max_us, l.count), l.count);
  }
  if (runs.size() > 1 && !runs.front().report.several_rates) out += spread_of(runs);
  for (const PolicyRun& run : runs) {
    if (run.scheduling == runtime::Scheduling::kXAuto && run.outcome.coordinators_share)
      out += fmt::format("  {}: coordinators used {:.3f} % of one CPU\n", run.name,
                         *run.outcome.coordinators_share * 100);
    if (!run.outcome.real_cpus.empty())
      out += fmt::format("  {}: real CPUs: {}\n", run.name, run.outcome.real_cpus);
    for (const runtime::PreemptionReport& of : run.report.preemptions)
      out += fmt::format(
          "  {}: {}: {} suspensions, longest call {} us, longest that resumed {} us; preempt_us "
          "{}\n",
          run.name, of.xpu, of.suspensions, of.suspend_us, of.resume_us, of.preempt_us);
    if (run.tables) out += tables_text(run.report);
    if (const std::uint64_t lost = run.report.lost_releases)
      out += fmt::format("  {}: {} activations were lost\n", run.name, lost);
    out += losses_of(run);
    out += crossings_table(run.report);
    if (!by_chains) out += chains_table(run);
    if (!flags.deployment_path.empty() || run.report.several_rates)
      out += limits_table(run, runs.size() > 1 ? run.name + ": " : "");
    if (const auto misses = deadline_misses(run); misses.value_or(0) > 0)
      out += fmt::format("  {}: {} deadline misses\n", run.name, *misses);
    if (run.outcome.trace.lost > 0)
      out += fmt::format("  {}: the trace lost {} events\n", run.name, run.outcome.trace.lost);
    if (run.outcome.trace.overwritten > 0)
      out += fmt::format(
          "  {}: the trace holds the last {:.1f} s of {:.1f} s; {} older events were dropped "
          "(--trace-keep)\n",
          run.name, traced_s(run.outcome.trace), run.outcome.wall_s, run.outcome.trace.overwritten);
    if (!run.report.note.empty()) out += fmt::format("  {}: {}\n", run.name, run.report.note);
    for (const std::string& note : run.outcome.notes)
      out += fmt::format("  {}: {}\n", run.name, note);
  }
  return out;
}

namespace {

/// Of a run that is over; before, no chain has been counted.
std::vector<story::ChainCounts> counts_of(const PolicyRun& run) {
  const auto known = [](std::int64_t us) { return us > 0 ? us : -1; };
  std::vector<story::ChainCounts> list;
  for (const runtime::ChainAccount& r : run.report.account.chains) {
    const Latency l = summarise(r.latency_us);
    story::ChainCounts counts{r.name, static_cast<std::int64_t>(l.count)};
    if (l.count > 0) std::tie(counts.p50_us, counts.max_us) = std::tie(l.p50_us, l.max_us);
    if (has_p99(l)) counts.p99_us = l.p99_us;
    if (r.deadline_us > 0) {
      counts.deadline_us = r.deadline_us;
      counts.misses = static_cast<std::int64_t>(r.deadline_misses);
    }
    counts.worst_case_us = known(r.worst_case_us);
    counts.lower_bound_us = known(r.lower_bound_us);
    counts.exceeded = r.exceeded();
    counts.lost = static_cast<std::int64_t>(r.lost);
    list.push_back(std::move(counts));
  }
  return list;
}

/// What is claimed of chains; of tables the largest of all. Before the run is over, too.
std::vector<ChainClaim> claims_of(const PolicyRun& run) {
  if (run.keys) return run.keys->chains;
  std::vector<ChainClaim> claims;
  const std::vector<std::int64_t> largest_us = largest_claims(*run.tables);
  for (std::size_t c = 0; c < largest_us.size(); ++c)
    claims.push_back({run.tables->tables.front().keys.chains[c].name, largest_us[c], 0, false});
  return claims;
}

/// [module] the host, if it is another one than this part's.
std::vector<std::string> modules_elsewhere(const RunFlags& flags, const PolicyRun& run,
                                           const std::vector<story::ModuleInfo>& modules) {
  const std::vector<int> host_of = hosts_of(flags.app, flags.spec, *run.keys);
  std::vector<std::string> elsewhere(modules.size());
  for (std::size_t m = 0; m < modules.size(); ++m)
    for (std::size_t x = 0; x < flags.app.xnodes.size(); ++x)
      if (flags.app.xnodes[x].module == modules[m].name &&
          host_of[x] != flags.spec.find_host(flags.part))
        elsewhere[m] = flags.spec.hosts[static_cast<std::size_t>(host_of[x])].name;
  return elsewhere;
}

Result<std::string> perfetto(const RunFlags& flags, const PolicyRun& run, const story::Story& told,
                             std::vector<story::ModuleInfo> modules, std::string verdict) {
  story::Scene scene;
  scene.title = flags.app.name + " on " + flags.spec.name + ": " + run.name;
  scene.note = fmt::format("{}, {}", xpus_text(flags), runtime::to_string(run.scheduling));
  Rows rows = rows_of(flags.spec, run.scheduling);
  for (std::string& name : rows.names) scene.rows.push_back({std::move(name), true});
  scene.row_of = std::move(rows.of);
  // Without our coordinators jobs share an XPU, and on real CPUs the kernel preempts unseen.
  const auto& lost = run.report.lost_coordinators;
  for (std::size_t x = 0; x < flags.spec.xpus.size(); ++x)
    if (run.scheduling != runtime::Scheduling::kXAuto || flags.kernel_schedules(x) ||
        std::find(lost.begin(), lost.end(), flags.spec.xpus[x].id) != lost.end())
      scene.rows[static_cast<std::size_t>(scene.row_of[x])].exclusive = false;
  scene.modules = std::move(modules);
  if (run.policy && !run.keys)  // keys are no priorities
    for (const PriorityPlacement& p : run.policy->placements)
      scene.priorities.push_back(p.priority);
  // No window ends with a key that is no claim.
  if (run.keys && run.keys->certified && run.scheduling == runtime::Scheduling::kXAuto) {
    scene.keys = &*run.keys;
    scene.claims = claims_of(run);
  }
  if (run.tables) {
    scene.tables = &*run.tables;
    scene.claims = claims_of(run);
    for (const runtime::ScenarioReport& s : run.report.scenarios)
      scene.scenarios.push_back({s.name, s.table, s.releases});
    for (const runtime::SwitchReport& s : run.report.switches)
      scene.changes.push_back(
          {s.release, s.from, s.to, s.chain, s.spanned_us, s.worst_case_us.value_or(-1)});
  }
  scene.verdict = std::move(verdict);
  scene.counts = counts_of(run);
  if (run.tai_offset_ns == 0)
    return perfetto_trace(flags.app, scene, told, story::boottime_offset_ns());
  scene.title = "host " + flags.part + ": " + scene.title;
  scene.elsewhere = modules_elsewhere(flags, run, scene.modules);
  const int host = flags.spec.find_host(flags.part);
  for (std::size_t x = 0; x < flags.spec.xpus.size(); ++x)
    scene.rows[static_cast<std::size_t>(scene.row_of[x])].here = flags.spec.xpus[x].host == host;
  scene.group = static_cast<std::uint32_t>(host) + 1;
  return perfetto_trace(flags.app, scene, told, run.tai_offset_ns);
}

}  // namespace

Result<std::string> perfetto_of(const RunFlags& flags, const PolicyRun& run) {
  if (!run.story) return tl::unexpected<Error>(run.story.error());
  return perfetto(flags, run, *run.story, modules_of(run.report),
                  run.report.account.words(runtime::Layout::kList));
}

Result<std::string> perfetto_of(const RunFlags& flags, const PolicyRun& run,
                                const launch::Incident& incident) {
  std::vector<story::ModuleInfo> modules = story::modules_of(flags.app, incident.modules);
  XAUTO_ASSIGN(const story::Story told, story_of(flags.app, flags.spec, modules, incident.trace));
  return perfetto(flags, run, told, std::move(modules),
                  "the run goes on: whether its claims hold is not known yet");
}

std::string words_of(const RunFlags& flags, const launch::Incident& incident) {
  const trace::Event& e = incident.event;
  const std::vector<story::ModuleInfo> modules = story::modules_of(flags.app, incident.modules);
  if (incident.hang)
    return fmt::format("{} ran past its hang limit of {} ms in activation {}",
                       e.xnode < flags.app.xnodes.size() ? flags.app.xnodes[e.xnode].name : "a job",
                       e.arg, e.seq);
  return fmt::format("release {}{} missed its deadline: {:.2f} ms", e.seq,
                     e.module < modules.size() && !modules[e.module].name.empty()
                         ? ", a result of XModule '" + modules[e.module].name + "',"
                         : "",
                     static_cast<double>(e.arg) / 1000);
}

Result<story::PagedRun> paged_of(const std::string& trace, std::string file) {
  XAUTO_ASSIGN(story::ReadTrace read, story::read_trace(trace, file.empty() ? "trace" : file));
  return story::PagedRun{std::move(file), std::move(read)};
}

}  // namespace xauto::cli
