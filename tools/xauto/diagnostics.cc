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

/// A chain, or the app as a whole, between two looks.
class FlowStatus {
 public:
  /// `of_each`: what is claimed is of every result. With tables it is of those that met no change.
  FlowStatus(const FlowCounts& now, const FlowCounts& before, const RunLook& look,
             std::int64_t before_ns, bool of_each)
      : now_(now), before_(before), look_(look), before_ns_(before_ns), of_each_(of_each) {}

  Diagnostic tell(const std::string& name) {
    count();
    find_delay();
    find_silence();
    if (found_.message.empty())
      found_.message = limit_us_ == 0       ? "there is nothing to hold results against"
                       : account_.stands()  ? "OK"
                       : !account_.claims() ? "OK; no worst case is certified"
                                            : "OK; the certified worst case is not claimed here";
    Diagnostic d{found_.level, name, found_.message, look_.platform, {}};
    tell_autowares(d);
    tell_ours(d);
    return d;
  }

 private:
  void count() {
    const std::uint64_t lost = grown(now_.lost, before_.lost),
                        old = grown(now_.age_misses, before_.age_misses);
    if (late_ > 0)
      found_.add(Level::kError, fmt::format("{} results later than the deadline of {} ms", late_,
                                            millis(now_.deadline_us)));
    if (old > 0)
      found_.add(Level::kError,
                 fmt::format("{} results became older than {} ms", old, millis(now_.max_age_us)));
    if (claimed_ && over_ > 0)
      found_.add(Level::kWarn,
                 fmt::format("{} results longer than the certified worst case of {} ms", over_,
                             millis(now_.worst_case_us)));
    if (lost > 0) found_.add(Level::kWarn, fmt::format("{} activations lost", lost));
  }

  void find_delay() {
    if (off_) {
      found_.add(Level::kOk, now_.gone ? "a module on its way is off in this table"
                                       : "its end is off in this table");
      return;
    }
    if (!watched_ || now_.results() == 0) return;
    const bool in_time = now_.in_time_ns == now_.last_ns;
    const std::int64_t since_ns = std::max(now_.in_time_ns, now_.gone_or_back_ns);
    delay_us_ = in_time ? 0 : std::max<std::int64_t>(0, look_.counts.at_ns - since_ns) / 1000;
    goes_on_ = most_us_ > 0 && delay_us_ > most_us_;
    if (goes_on_)
      found_.add(Level::kError, fmt::format("no result in time for {} ms", millis(delay_us_)));
  }

  void find_silence() {
    if (off_) return;
    if (now_.results() == 0) return found_.add(Level::kStale, "no result yet");
    const std::int64_t last_ns = std::max(now_.last_ns, now_.gone_or_back_ns);
    const std::int64_t silent_us =
        now_.last_ns > 0 ? std::max<std::int64_t>(0, look_.counts.at_ns - last_ns) / 1000 : -1;
    const bool silent = most_us_ > 0         ? silent_us > most_us_
                        : now_.period_us > 0 ? silent_us > 2 * now_.period_us + now_.longest_us
                                             : now_.results() == before_.results();
    if (silent) found_.add(Level::kStale, fmt::format("no result for {} ms", millis(silent_us)));
  }

  void tell_autowares(Diagnostic& d) const {
    const bool last_over = claimed_ && of_each_ && now_.last_us > now_.allowed_us;
    const bool last_late = has_deadline_ && now_.last_us > now_.deadline_us;
    const bool as_expected = (!claimed_ || over_ == 0) && late_ == 0 && !last_over && !last_late;
    say(d, "is_processing_time_ms_in_expected_range", limit_us_ > 0 ? word(as_expected) : kUnknown);
    say(d, "processing_time_ms", millis(now_.last_us));
    say(d, "is_consecutive_processing_delay_in_range",
        watched_ && most_us_ > 0 ? word(!goes_on_) : kUnknown);
    say(d, "consecutive_processing_delay_ms", millis(delay_us_));
  }

  void tell_ours(Diagnostic& d) const {
    say(d, "longest_ms", millis(now_.longest_us));
    say(d, "worst_case_ms", claimed_ ? millis(now_.worst_case_us) : kUnknown);
    say(d, "slack_ms",
        claimed_ && of_each_ && now_.longest_us >= 0
            ? signed_millis(now_.worst_case_us - now_.longest_us)
            : kUnknown);
    say(d, "deadline_ms", has_deadline_ ? millis(now_.deadline_us) : kUnknown);
    say(d, "claim", claim_words(now_, account_, !look_.counts.scenarios.empty()));
    const FlowNumbers n = numbers_of(now_, before_, look_.counts.at_ns, before_ns_);
    say(d, "rate_hz", before_ns_ > 0 ? fmt::format("{:.3f}", n.rate_hz) : kUnknown);
    say(d, "results", std::to_string(now_.results()));
    say(d, "deadline_misses", std::to_string(now_.deadline_misses));
    say(d, "lost", std::to_string(now_.lost));
    if (now_.worst_case_us > 0) say(d, "over_worst_case", std::to_string(now_.over_claim));
    if (now_.max_age_us > 0) say(d, "age_misses", std::to_string(now_.age_misses));
  }

  static void say(Diagnostic& d, const char* key, std::string value) {
    d.values.emplace_back(key, std::move(value));
  }

  const FlowCounts &now_, &before_;
  const RunLook& look_;
  const std::int64_t before_ns_;
  const bool of_each_;
  const runtime::Account& account_ = look_.counts.account;
  const bool claimed_ = now_.worst_case_us > 0 && account_.stands();
  const bool has_deadline_ = now_.deadline_us > 0;
  const std::uint64_t late_ = grown(now_.deadline_misses, before_.deadline_misses),
                      over_ = grown(now_.over_claim, before_.over_claim);
  /// What results are held against: a deadline, and without one what is claimed. Nothing else.
  const std::int64_t limit_us_ = has_deadline_ ? now_.deadline_us : claimed_ ? now_.allowed_us : 0;
  /// In time are results that come within a period and the limit of each other. Two periods: one of
  /// them may be late or lost before it is a delay that goes on. Where there is no limit the longest so far is it.
  const std::int64_t most_us_ =
      limit_us_ > 0 && now_.period_us > 0 ? 2 * now_.period_us + limit_us_ : 0;
  const bool watched_ =
      limit_us_ > 0 && limit_us_ == now_.limit_us;  ///< with tables deadlines alone
  /// Nothing is late, and nothing comes.
  const bool off_ = now_.gone || (now_.off > before_.off && now_.results() == before_.results());
  Findings found_;
  std::int64_t delay_us_ = -1;
  bool goes_on_ = false;  ///< the delay
};

Diagnostic of_flow(const std::string& name, const FlowCounts& now, const FlowCounts& before,
                   const RunLook& look, std::int64_t before_ns, bool of_each) {
  return FlowStatus(now, before, look, before_ns, of_each).tell(name);
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

/// Of one link, what came too late for its X.
Diagnostic of_crossing(const std::string& name, const CrossingCounts& now,
                       const CrossingCounts& before, const RunLook& look) {
  Findings found;
  if (const std::uint64_t lost = grown(now.lost, before.lost); lost > 0)
    found.add(Level::kWarn, fmt::format("{} messages were not here by their key + X", lost));
  if (found.message.empty()) found.message = "OK";
  return {found.level,
          name,
          found.message,
          look.platform,
          {{"x_ms", fmt::format("{:.3f}", static_cast<double>(now.x_us) / 1000)},
           {"longest_ms", now.messages == 0
                              ? kUnknown
                              : fmt::format("{:.3f}", static_cast<double>(now.longest_us) / 1000)},
           {"messages", std::to_string(now.messages)},
           {"lost", std::to_string(now.lost)},
           {"late", std::to_string(now.late)}}};
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
  // Each host's monitor tells of its part, on one topic.
  const std::string prefix = "xauto/" + now.app + (now.host.empty() ? "" : "@" + now.host) + ": ";
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
  for (std::size_t c = 0; c < is.crossings.size(); ++c) {
    const CrossingCounts& of = is.crossings[c];
    list.push_back(of_crossing(prefix + of.xnode + " from " + of.from + " to " + of.to, of,
                               c < was.crossings.size() ? was.crossings[c] : CrossingCounts(),
                               now));
  }
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
