// SPDX-License-Identifier: Apache-2.0
#include "session/table_claims.h"

#include <cstdint>
#include <utility>

#include <fmt/format.h>

#include "model/claims.h"
#include "model/json_value.h"

namespace xauto::runtime {
namespace {

double in_ms(std::int64_t us) {
  return static_cast<double>(us) / 1000;
}

/// Null: there was none.
Json longest(std::int64_t us) {
  return us < 0 ? Json() : Json(us);
}

}  // namespace

TableClaims table_claims_of(const RunReport& report, bool one_at_a_time) {
  TableClaims claims;
  claims.scope = scope_of(one_at_a_time);
  claims.broken = report.unkept;
  claims.broken.insert(claims.broken.end(), report.broken.begin(), report.broken.end());
  if (std::string met = words_of_overlaps(report.overlapping_releases, report.num_releases);
      !met.empty())
    claims.broken.push_back(std::move(met));
  std::uint64_t lost = 0;
  for (const ModuleReport& m : report.modules) lost += m.failed + m.dropped;
  if (lost > 0) claims.broken.push_back(fmt::format("{} activations were lost", lost));
  if (report.lost_releases > 0)
    claims.broken.push_back(fmt::format("{} releases were lost", report.lost_releases));
  if (std::string over = words_of_overruns(report); !over.empty())
    claims.broken.push_back(std::move(over));
  for (std::string& line : words_of_unended(report)) claims.broken.push_back(std::move(line));
  for (std::string& line : words_of_deaths(report)) claims.broken.push_back(std::move(line));
  for (const RouteReport& r : report.routes)
    if (r.over_claim > 0)
      claims.exceeded.push_back(fmt::format(
          "chain '{}': {} releases longer than their scenario claims, or the change that "
          "they met",
          r.name, r.over_claim));
  return claims;
}

bool nearer(std::int64_t us, std::int64_t worst_us, std::int64_t than_us,
            std::int64_t than_worst_us) {
  if (us < 0 || than_us < 0) return us > than_us;
  if (worst_us == 0 || than_worst_us == 0)
    return worst_us == than_worst_us ? us > than_us : worst_us > 0;
  return static_cast<long double>(us) * static_cast<long double>(than_worst_us) >
         static_cast<long double>(than_us) * static_cast<long double>(worst_us);
}

const SwitchReport* nearest(const RunReport& report) {
  const SwitchReport* nearest = nullptr;
  for (const SwitchReport& s : report.switches) {
    const std::int64_t worst_us = s.worst_case_us.value_or(0);
    if (worst_us > 0 && s.spanned_us >= 0 &&
        (nearest == nullptr ||
         nearer(s.spanned_us, worst_us, nearest->spanned_us, nearest->worst_case_us.value_or(0))))
      nearest = &s;
  }
  return nearest;
}

std::string words_of_nearest(const std::string& chain, std::int64_t us, std::int64_t worst_us,
                             const std::string& from, const std::string& to, const char* mark) {
  const std::string what = "result of '" + chain + "'";
  if (worst_us == 0)
    return fmt::format(
        "the longest {} that met a change took {:.2f} ms ('{}' to '{}'); nothing is "
        "claimed of it",
        what, in_ms(us), from, to);
  return fmt::format(
      "of what met a change the nearest to its worst case, a {}, took {:.2f} ms of {}{:.2f} ms "
      "('{}' to '{}')",
      what, in_ms(us), mark, in_ms(worst_us), from, to);
}

std::vector<std::string> words_of_deaths(const RunReport& report) {
  std::vector<std::string> lines = report.dead_daemons;
  if (!report.lost_coordinators.empty() || !report.died.empty())
    lines.emplace_back("processes of the run died");
  return lines;
}

std::vector<std::string> words_of_unended(const RunReport& report) {
  std::vector<std::string> lines;
  if (!report.complete)
    lines.push_back("the run is not complete" +
                    (report.not_complete.empty() ? "" : ": " + report.not_complete));
  for (const XNodeReport& x : report.xnodes) {
    if (x.unended > 0)
      lines.push_back(words_of_unended(x.name, x.module, x.unended, x.unended_us, x.wcet_us));
    // By tables its XPU counts as lost, and they say what is claimed then.
    if (x.hangs > 0 && report.scenarios.empty())
      lines.push_back(words_of_hangs(x.name, x.module, x.hangs));
  }
  return lines;
}

std::string words_of_unended(const std::string& xnode, const std::string& module,
                             std::uint64_t jobs, std::int64_t us, std::int64_t wcet_us) {
  return fmt::format(
      "{}XNode '{}' of XModule '{}' {} run for {:.2f} ms and {} not ended; its WCET is {:.2f} ms",
      jobs > 1 ? fmt::format("{} jobs of ", jobs) : "", xnode, module, jobs > 1 ? "have" : "has",
      in_ms(us), jobs > 1 ? "have" : "has", in_ms(wcet_us));
}

std::string words_of_hangs(const std::string& xnode, const std::string& module,
                           std::uint64_t jobs) {
  return fmt::format("{} job{} of XNode '{}' of XModule '{}' ran past {} hang limit", jobs,
                     jobs > 1 ? "s" : "", xnode, module, jobs > 1 ? "their" : "its");
}

std::vector<std::string> words_of(const FailedPreemptionReport& failed) {
  std::vector<std::string> lines;
  const auto times = [](std::uint64_t n) { return fmt::format("{} time{}", n, n == 1 ? "" : "s"); };
  if (failed.suspends > 0)
    lines.push_back(
        fmt::format("preemption failed {} on {}: the work of XNode '{}' was not suspended",
                    times(failed.suspends), failed.xpu, failed.xnode));
  if (failed.resumes > 0)
    lines.push_back(
        fmt::format("preemption failed {} on {}: the work of XNode '{}' was not resumed",
                    times(failed.resumes), failed.xpu, failed.xnode));
  return lines;
}

std::string words_of_overlaps(std::uint64_t overlapping, std::uint64_t releases) {
  if (overlapping == 0) return {};
  return fmt::format("{} of {} releases came while an earlier one was in flight", overlapping,
                     releases);
}

std::string words_of_overruns(const RunReport& report) {
  std::uint64_t count = 0, jobs = 0;
  const XNodeReport* worst = nullptr;
  for (const XNodeReport& x : report.xnodes) {
    jobs += x.jobs;
    count += x.over_wcet;
    if (x.over_wcet > 0 && (worst == nullptr || x.over_us > worst->over_us)) worst = &x;
  }
  if (worst == nullptr) return {};
  return fmt::format("{} of {} jobs outran {}, {} by {:.3f} ms", count, jobs,
                     report.scenarios.empty() ? "their WCET" : "the WCET of their scenario",
                     worst->name, in_ms(worst->over_us));
}

std::string words_of_unproven(std::uint64_t switches) {
  return fmt::format(
      "{} changes of the table have no worst case for some chains, of which nothing is claimed "
      "since: an XPU was lost, or a job had been too long for more than tables.json's notice_us",
      switches);
}

std::string words_of_unsettled(std::uint64_t releases) {
  return fmt::format(
      "{} releases kept a table that no longer fits: the change before had not settled", releases);
}

void add_tables(const RunReport& report, const TableClaims& claims, Json& into) {
  into["worst_case_of"] = claims.scope;
  into["worst_case_exceeded"] = !claims.exceeded.empty();
  into["worst_case_broken"] = claims.broken;
  Json scenarios = Json::array();
  for (const ScenarioReport& s : report.scenarios) {
    scenarios.push_back({{"name", s.name}, {"table", s.table}, {"releases", s.releases}});
  }
  into["scenarios"] = std::move(scenarios);
  Json switches = Json::array();
  for (const SwitchReport& s : report.switches) {
    Json one = {{"release", s.release},
                {"from", s.from},
                {"to", s.to},
                {"table", s.table},
                {"why", s.why},
                {"held_us", s.held_us},
                {"spanned_us", longest(s.spanned_us)}};
    if (s.worst_case_us) one["worst_case_us"] = *s.worst_case_us;
    if (!s.chain.empty()) one["chain"] = s.chain;
    if (!s.detail.empty()) one["detail"] = s.detail;
    switches.push_back(std::move(one));
  }
  into["switches"] = std::move(switches);
  into["num_switches"] = report.num_switches;
}

}  // namespace xauto::runtime
