// SPDX-License-Identifier: Apache-2.0
#include "xauto/diagnostics.h"

#include <algorithm>

#include <fmt/format.h>

namespace xauto::cli {
namespace {

constexpr const char* kUnknown = "n/a";

/// As ROS 2's diagnostic_updater writes a bool.
std::string word(bool yes) {
  return yes ? "True" : "False";
}

/// Milliseconds, exact; below 0: it was not measured.
std::string millis(std::int64_t us) {
  return us < 0 ? kUnknown : fmt::format("{}.{:03}", us / 1000, us % 1000);
}

std::string signed_millis(std::int64_t us) {
  return (us < 0 ? "-" : "") + millis(us < 0 ? -us : us);
}

std::uint64_t grown(std::uint64_t now, std::uint64_t before) {
  return now - std::min(now, before);
}

/// What a status says; the worst of it is its level.
struct Findings {
  Level level = Level::kOk;
  std::string message;
  void add(Level of, const std::string& text) {
    level = std::max(level, of);
    message += (message.empty() ? "" : "; ") + text;
  }
};

std::string one_line(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += (text.empty() ? "" : "; ") + line;
  return text;
}

/// Whether something is claimed of this flow, in words.
std::string claim_words(const FlowCounts& flow, const runtime::Account& account, bool tables) {
  if (flow.worst_case_us == 0)
    return tables             ? "of releases, see their status"
           : account.claims() ? "none of this; see the chains of app.json"
                              : "none: no certified worst case";
  if (account.stands()) return "stands";
  return "not claimed here: " + one_line(account.broken());
}

/// `of_each`: what is claimed is of every result. With tables it is of those that met no change.
Diagnostic of_flow(const std::string& name, const FlowCounts& now, const FlowCounts& before,
                   const RunLook& look, std::int64_t before_ns, bool of_each) {
  const runtime::Account& account = look.counts.account;
  const std::int64_t at_ns = look.counts.at_ns;
  const bool claimed = now.worst_case_us > 0 && account.stands();
  const bool has_deadline = now.deadline_us > 0;
  const std::uint64_t late = grown(now.deadline_misses, before.deadline_misses),
                      over = grown(now.over_claim, before.over_claim),
                      lost = grown(now.lost, before.lost),
                      old = grown(now.age_misses, before.age_misses);
  // What results are held against: a deadline, and without one what is claimed. Nothing else.
  const std::int64_t limit_us = has_deadline ? now.deadline_us : claimed ? now.allowed_us : 0;

  Findings found;
  if (late > 0)
    found.add(Level::kError, fmt::format("{} results later than the deadline of {} ms", late,
                                         millis(now.deadline_us)));
  if (old > 0)
    found.add(Level::kError,
              fmt::format("{} results became older than {} ms", old, millis(now.max_age_us)));
  if (claimed && over > 0)
    found.add(Level::kWarn, fmt::format("{} results longer than the certified worst case of {} ms",
                                        over, millis(now.worst_case_us)));
  if (lost > 0) found.add(Level::kWarn, fmt::format("{} activations lost", lost));

  // In time are results that come within a period and the limit of each other. Two periods: one of
  // them may be late or lost before it is a delay that goes on. Where there is no limit the longest so far is it.
  std::int64_t delay_us = -1;
  bool goes_on = false;
  const std::int64_t most_us = limit_us > 0 && now.period_us > 0 ? 2 * now.period_us + limit_us : 0;
  const bool watched = limit_us > 0 && limit_us == now.limit_us;  // with tables deadlines alone
  // Nothing is late, and nothing comes.
  const bool off = now.gone || (now.off > before.off && now.results() == before.results());
  if (off) {
    found.add(Level::kOk, now.gone ? "a module on its way is off in this table"
                                   : "its end is off in this table");
  } else if (watched && now.results() > 0) {
    const bool in_time = now.in_time_ns == now.last_ns;
    const std::int64_t since_ns = std::max(now.in_time_ns, now.gone_or_back_ns);
    delay_us = in_time ? 0 : std::max<std::int64_t>(0, at_ns - since_ns) / 1000;
    goes_on = most_us > 0 && delay_us > most_us;
    if (goes_on)
      found.add(Level::kError, fmt::format("no result in time for {} ms", millis(delay_us)));
  }
  const std::int64_t silent_us =
      now.last_ns > 0
          ? std::max<std::int64_t>(0, at_ns - std::max(now.last_ns, now.gone_or_back_ns)) / 1000
          : -1;
  if (!off && now.results() == 0)
    found.add(Level::kStale, "no result yet");
  else if (!off && (most_us > 0         ? silent_us > most_us
                    : now.period_us > 0 ? silent_us > 2 * now.period_us + now.longest_us
                                        : now.results() == before.results()))
    found.add(Level::kStale, fmt::format("no result for {} ms", millis(silent_us)));
  if (found.message.empty())
    found.message = limit_us == 0       ? "there is nothing to hold results against"
                    : account.stands()  ? "OK"
                    : !account.claims() ? "OK; no worst case is certified"
                                        : "OK; the certified worst case is not claimed here";

  Diagnostic d{found.level, name, found.message, look.platform, {}};
  const auto say = [&](const char* key, std::string value) {
    d.values.emplace_back(key, std::move(value));
  };
  // Autoware's four keys, then ours.
  const bool last_over = claimed && of_each && now.last_us > now.allowed_us;
  const bool last_late = has_deadline && now.last_us > now.deadline_us;
  const bool as_expected = (!claimed || over == 0) && late == 0 && !last_over && !last_late;
  say("is_processing_time_ms_in_expected_range", limit_us > 0 ? word(as_expected) : kUnknown);
  say("processing_time_ms", millis(now.last_us));
  say("is_consecutive_processing_delay_in_range",
      watched && most_us > 0 ? word(!goes_on) : kUnknown);
  say("consecutive_processing_delay_ms", millis(delay_us));
  say("longest_ms", millis(now.longest_us));
  say("worst_case_ms", claimed ? millis(now.worst_case_us) : kUnknown);
  say("slack_ms", claimed && of_each && now.longest_us >= 0
                      ? signed_millis(now.worst_case_us - now.longest_us)
                      : kUnknown);
  say("deadline_ms", has_deadline ? millis(now.deadline_us) : kUnknown);
  say("claim", claim_words(now, account, !look.counts.scenarios.empty()));
  const FlowNumbers n = numbers_of(now, before, at_ns, before_ns);
  say("rate_hz", before_ns > 0 ? fmt::format("{:.3f}", n.rate_hz) : kUnknown);
  say("results", std::to_string(now.results()));
  say("deadline_misses", std::to_string(now.deadline_misses));
  say("lost", std::to_string(now.lost));
  if (now.worst_case_us > 0) say("over_worst_case", std::to_string(now.over_claim));
  if (now.max_age_us > 0) say("age_misses", std::to_string(now.age_misses));
  return d;
}

/// What the certified worst cases take for granted.
Diagnostic of_claims(const std::string& name, const RunLook& look, const Counts& before) {
  const runtime::Account& account = look.counts.account;
  Findings found;
  if (!account.claims())
    found.add(Level::kOk, "nothing is claimed of this run");
  else if (!account.stands())
    found.add(Level::kWarn,
              "the certified worst cases are not claimed here: " + one_line(account.broken()));
  else if (account.exceeded())
    found.add(Level::kError,
              "a certified worst case was exceeded, though nothing that is watched was broken");
  else
    found.add(Level::kOk, "the certified worst cases stand, as far as is watched");
  Diagnostic d{found.level, name, found.message, look.platform, {}};
  d.values.emplace_back("claimed", word(account.claims()));
  d.values.emplace_back("stands", account.claims() ? word(account.stands()) : kUnknown);
  d.values.emplace_back("exceeded", account.claims() ? word(account.exceeded()) : kUnknown);
  for (const runtime::Assumption& v : account.assumptions)
    d.values.emplace_back(v.kind, std::to_string(v.count));
  if (const auto& scenario = look.counts.scenario) {
    d.values.emplace_back("scenario", scenario->name);
    d.values.emplace_back("table", scenario->table);
    d.values.emplace_back("why", scenario->why);
    d.values.emplace_back("table_switches", std::to_string(scenario->switches));
    if (before.scenario && before.scenario->switches != scenario->switches)
      d.message += fmt::format("; table '{}' now", scenario->table);
  }
  return d;
}

Diagnostic of_module(const std::string& name, const ModuleCounts& now, const ModuleCounts& before,
                     const RunLook& look) {
  Findings found;
  if (now.deaths > before.deaths) found.add(Level::kError, "its process died");
  if (const std::uint64_t failed = grown(now.failed, before.failed); failed > 0)
    found.add(Level::kWarn, fmt::format("{} activations failed", failed));
  if (const std::uint64_t dropped = grown(now.dropped, before.dropped); dropped > 0)
    found.add(Level::kWarn, fmt::format("{} activations were dropped", dropped));
  if (found.message.empty()) found.message = now.off > before.off ? "off in this table" : "OK";
  return {found.level,
          name,
          found.message,
          look.platform,
          {{"activations", std::to_string(now.activations)},
           {"failed", std::to_string(now.failed)},
           {"dropped", std::to_string(now.dropped)},
           {"off", std::to_string(now.off)},
           {"process_deaths", std::to_string(now.deaths)}}};
}

std::string list_of_names(const std::vector<std::string>& list) {
  std::string text;
  for (const std::string& name : list) text += (text.empty() ? "" : ", ") + name;
  return text.empty() ? "none" : text;
}

Diagnostic of_xpu(const std::string& name, const XpuCounts& now, const XpuCounts& before,
                  const RunLook& look, std::int64_t before_ns) {
  const auto status = std::find_if(look.xpus.begin(), look.xpus.end(),
                                   [&](const XpuStatus& s) { return s.xpu == now.name; });
  Diagnostic d{Level::kOk, name, "OK", now.name, {}};
  const auto say = [&](const char* key, std::string value) {
    d.values.emplace_back(key, std::move(value));
  };
  if (status == look.xpus.end()) {
    const bool scheduled = look.scheduling == "xauto";
    d.level = scheduled ? Level::kStale : Level::kOk;
    d.message = scheduled ? "its coordinator does not answer" : "nobody schedules this run";
  } else {
    std::vector<std::string> running, waiting;
    for (const WorkerStatus& worker : status->workers)
      if (!worker.idle() && worker.state != "starting")
        (worker.state == "running" ? running : waiting).push_back(worker.xnode);
    say("coordinator_pid", std::to_string(status->pid));
    say("running", list_of_names(running));
    say("waiting", list_of_names(waiting));
    say("decisions", std::to_string(status->decisions));
  }
  const std::int64_t wall_ns = look.counts.at_ns - before_ns;
  say("busy_percent",
      before_ns > 0 && wall_ns > 0
          ? fmt::format("{:.1f}", 100 * static_cast<double>(now.busy_ns - before.busy_ns) /
                                      static_cast<double>(wall_ns))
          : kUnknown);
  say("suspensions", std::to_string(now.suspensions));
  return d;
}

/// The same element of the look before; there is none, or another one stands there.
template <class T>
T same(const std::vector<T>& list, std::size_t index, const std::string& name) {
  return index < list.size() && list[index].name == name ? list[index] : T();
}

}  // namespace

const char* to_string(Level level) {
  constexpr const char* kWords[] = {"ok", "warn", "error", "stale"};
  return kWords[static_cast<std::size_t>(level)];
}

std::vector<Diagnostic> diagnostics_of(const RunLook& now, const RunLook* before) {
  const Counts none;
  const Counts& was = before == nullptr ? none : before->counts;
  const Counts& is = now.counts;
  const std::string prefix = "xauto/" + now.app + ": ";
  std::vector<Diagnostic> list;
  if (is.single_rate())
    list.push_back(
        of_flow(prefix + "releases", is.whole, was.whole, now, was.at_ns, is.scenarios.empty()));
  for (std::size_t i = 0; i < is.chains.size(); ++i)
    list.push_back(of_flow(prefix + "chain " + is.chains[i].name, is.chains[i],
                           same(was.chains, i, is.chains[i].name), now, was.at_ns, true));
  list.push_back(of_claims(prefix + "worst cases", now, was));
  for (std::size_t i = 0; i < is.modules.size(); ++i)
    list.push_back(of_module(prefix + "module " + is.modules[i].name, is.modules[i],
                             same(was.modules, i, is.modules[i].name), now));
  for (std::size_t i = 0; i < is.xpus.size(); ++i)
    list.push_back(of_xpu(prefix + "XPU " + is.xpus[i].name, is.xpus[i],
                          same(was.xpus, i, is.xpus[i].name), now, was.at_ns));
  return list;
}

std::vector<Diagnostic> stale(std::vector<Diagnostic> last, const std::string& why) {
  for (Diagnostic& d : last) {
    d.level = Level::kStale;
    d.message = why;
  }
  return last;
}

}  // namespace xauto::cli
