// SPDX-License-Identifier: Apache-2.0
#include "tables/table_switch.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <uapi/xauto/event.h>

#include "base/clock.h"
#include "base/log.h"
#include "model/claims.h"
#include "model/drain.h"
#include "session/changes.h"

namespace xauto::runtime {
namespace {

ChoiceOptions options_of(const Deployment& deployment) {
  ChoiceOptions options;
  if (deployment.tables.dwell_ms) options.dwell_ns = *deployment.tables.dwell_ms * 1'000'000;
  if (deployment.tables.margin_pct) options.margin_pct = *deployment.tables.margin_pct;
  return options;
}

constexpr std::int64_t kGlanceOftenNs = 1'000'000, kGlanceSeldomNs = 4'000'000;

void say(const std::vector<std::string>& lines) {
  for (const std::string& line : lines) log::error("{}", line);
}

/// Where some XPUs of a type are emulated, all of them are judged as such.
bool emulates_type(const Session& session, const std::string& type) {
  const std::vector<int> all = session.platform.instances_of(type);
  return std::any_of(all.begin(), all.end(), [&](int x) { return session.emulated(x); });
}

}  // namespace

Result<std::unique_ptr<TableSwitch>> TableSwitch::make(const Context& context, Ledger& ledger,
                                                       TellTimes tell_times) {
  if (!context.session.tables) return std::unique_ptr<TableSwitch>();
  std::unique_ptr<TableSwitch> made(new TableSwitch(context, ledger, std::move(tell_times)));
  // A job that is too long is found in the same period; what is in memory costs nothing to look at.
  const std::int64_t glance_ns = std::clamp(made->period_ns_ / 8, kGlanceOftenNs, kGlanceSeldomNs);
  const ScenarioOrder* order = nullptr;
  {
    const Guard lock(made->mutex_);
    order = &made->choice_.order();
  }
  XAUTO_ASSIGN(made->conditions_,
               ConditionWatch::start(
                   made->tables_, *order, {read_every_ns(made->period_ns_), glance_ns},
                   [t = made.get()](const MachineState& machine) { return t->glance(machine); }));
  return made;
}

TableSwitch::TableSwitch(const Context& context, Ledger& ledger, TellTimes tell_times)
    : context_(context),
      ledger_(ledger),
      tell_times_(std::move(tell_times)),
      tables_(*context.session.tables),
      choice_(
          context.session.app, context.session.platform, tables_,
          [&](const std::string& type, std::int64_t wcet_us) {
            const bool emulated = emulates_type(context.session, type);
            return watched_ns(wcet_us, emulated) + (emulated ? kEmulatorStallUs * 1000 : 0);
          },
          options_of(context.session.deployment)),
      node_of_(context.session.app.xnodes.size()),
      claimed_(context.session),
      past_(context.session.app.xnodes.size()),
      hangs_(context.session.app.xnodes.size()),
      table_(choice_.now().table),
      scenario_(choice_.now().scenario) {
  for (std::size_t n = 0; n < context.graph.nodes.size(); ++n)
    node_of_[static_cast<std::size_t>(context.session.app.find(context.graph.nodes[n].name))] = n;
  const Session& session = context.session;
  if (session.input.empty() && !session.lockstep && !context.app.sources.empty())
    period_ns_ = 1000 * (session.period_us > 0 ? session.period_us
                                               : context.app.sources.front().period.floor_us());
  Board& board = context.board;
  for (std::size_t s = 0; s < tables_.scenarios.size(); ++s) {
    ScenarioLine& line = board.scenario(s);
    name_line(line.name, tables_.scenarios[s].name);
    name_line(line.table, tables_.tables[static_cast<std::size_t>(tables_.serves[s].table)].name);
  }
  for (int from = 0; from < static_cast<int>(tables_.tables.size()); ++from) {
    std::vector<std::int64_t>& of = drains_us_.emplace_back();
    for (int to = 0; to < static_cast<int>(tables_.tables.size()); ++to)
      of.push_back(from == to ? 0 : drain_us(tables_, from, to, session.app, session.platform));
  }
  put(0, table_);
}

/// What jobs took since the last look, and how long those that run have taken so far; what people and
/// the machine's files say.
void TableSwitch::look(const MachineState& machine) {
  const std::int64_t now = now_ns();
  tell_times_(now);
  for (std::size_t x = 0; x < node_of_.size(); ++x) {
    XNodeLine& line = context_.board.xnode(node_of_[x]);
    if (line.seen_job.load(std::memory_order_relaxed) != 0) {
      const std::uint64_t seen = line.seen_job.exchange(0);
      const std::size_t table = XNodeLine::table_of(seen);
      if (table < tables_.tables.size())
        choice_.saw(static_cast<int>(table), x, XNodeLine::ns_of(seen));
    }
    if (const std::uint64_t hangs = line.hangs.load(); hangs > hangs_[x]) {
      hangs_[x] = hangs;
      const std::uint32_t table = line.hung_table.load();
      if (table < tables_.tables.size()) choice_.hung(static_cast<int>(table), x);
    }
  }
  choice_.ask(static_cast<int>(context_.board.header().asked.load()) - 1);
  choice_.expect(machine.scenario);
}

/// Before `look`, so that the choice knows of all of them.
void TableSwitch::take_past() {
  for (std::size_t x = 0; x < past_.size(); ++x) {
    XNodeLine& line = context_.board.xnode(node_of_[x]);
    past_[x] = {};
    if (line.past_jobs.load(std::memory_order_relaxed) != 0)
      past_[x] = {line.past_jobs.exchange(0), line.past_job.exchange(0)};
  }
}

/// They ended under the scenario that was told last; what is chosen now is from the next release on, and
/// the change between both is claimed with the longer jobs of either.
void TableSwitch::judge_past() {
  for (std::size_t x = 0; x < past_.size(); ++x) {
    const std::size_t table = XNodeLine::table_of(past_[x].longest);
    if (past_[x].jobs == 0 || table >= tables_.tables.size()) continue;
    const auto may = [&](int scenario) {
      return claimed_.under(static_cast<std::size_t>(scenario), table, x);
    };
    const std::int64_t by_ns =
        XNodeLine::ns_of(past_[x].longest) - std::max(may(scenario_), may(choice_.now().scenario));
    if (by_ns > 0) context_.board.xnode(node_of_[x]).over(past_[x].jobs, by_ns);
  }
}

bool TableSwitch::glance(const MachineState& machine) {
  std::vector<std::string> said;
  bool holds = true;
  {
    const Guard lock(mutex_);
    look(machine);
    holds = choice_.holds();
    said = outside(holds ? choice_.now() : choice_.foresee(now_ns()), machine);
  }
  say(said);
  return !holds;
}

void TableSwitch::stop_watch() {
  thread_.check();
  if (conditions_ == nullptr) return;
  const MachineState machine = conditions_->now();
  conditions_.reset();
  (void)glance(machine);
  const Guard lock(mutex_);
  take_past();
  judge_past();  // no release comes that another scenario would be for
}

/// What shall be in force, and the table that is. What no scenario covers is said here where the watch
/// has not seen it.
std::pair<Choice, int> TableSwitch::choose() {
  std::vector<std::string> said;
  std::pair<Choice, int> chosen;
  {
    const MachineState machine = conditions_->now();
    const Guard lock(mutex_);
    take_past();
    look(machine);
    choice_.decide(now_ns());
    judge_past();
    chosen = {choice_.now(), table_};
    said = outside(chosen.first, machine);
  }
  say(said);
  return chosen;
}

void TableSwitch::at_release(std::int64_t nominal_ns) {
  thread_.check();
  if (leaves_out(nominal_ns)) return;  // what is chosen meanwhile counts when it has drained
  give_table(nominal_ns);
  if (leaves_out(nominal_ns)) return;
  context_.board.scenario(static_cast<std::size_t>(scenario_))
      .releases.fetch_add(1, std::memory_order_relaxed);
}

void TableSwitch::give_table(std::int64_t nominal_ns) {
  const int from = scenario_;
  const auto [choice, table] = choose();
  const std::int64_t now = now_ns();
  const std::uint64_t since_us = first_us_of_table(nominal_ns, newest_ns_);
  newest_ns_ = std::max(newest_ns_, nominal_ns);
  const std::int64_t before_ns = std::exchange(released_ns_, now);
  std::int64_t drains_us = 0;
  if (choice.table != table) {
    if (static_cast<std::int64_t>(since_us) * 1000 < settled_ns_) {
      context_.board.header().unsettled.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    const std::int64_t too_long_ns = choice.saw_ns - choice.allowed_ns +
                                     (context_.session.emulates() ? kEmulatorStallUs * 1000 : 0);
    drains_us =
        this->change(since_us, table, choice,
                     choice.why != Why::kOverrun ||
                         noticed_in_time(now, too_long_ns, before_ns, tables_.notice_us * 1000));
  } else if (choice.scenario != from && context_.grid.one_at_a_time) {
    change_scenario(static_cast<std::int64_t>(since_us) * 1000, choice);
  }
  ledger_.judge_claims();
  if (!is_news(choice, from)) return;
  SwitchReport change;
  change.release = context_.board.released();
  change.from = tables_.scenarios[static_cast<std::size_t>(from)].name;
  change.to = tables_.scenarios[static_cast<std::size_t>(choice.scenario)].name;
  change.held_us = drains_us;
  tell(std::move(change), choice);
}

/// What is nominally released at `from_us` or later has the table of `to`, in whichever process; where the
/// change drains, after that. `in_time`: the certificate of the change counts with nothing that came
/// earlier. Returns how long it drains.
std::int64_t TableSwitch::change(std::uint64_t from_us, int from, const Choice& to, bool in_time) {
  const std::int64_t drains_us =
      drains_us_[static_cast<std::size_t>(from)][static_cast<std::size_t>(to.table)];
  put(from_us + static_cast<std::uint64_t>(drains_us), to.table);
  const auto since_ns = static_cast<std::int64_t>(from_us) * 1000;
  drains_from_ns_ = since_ns;
  drains_until_ns_ = since_ns + drains_us * 1000;
  const Handover* change = handover_of(tables_, from, to.table);
  Handover drained;
  const bool alone = context_.grid.one_at_a_time;  // then what met it has ended, and is known
  if (drains_us > 0 || (alone && (change == nullptr || !change->claims_all()))) {
    // Nothing is claimed of what meets it, and all is in time again.
    drained.worst_case_us.assign(context_.session.app.chains.size(), kNotThere);
    drained.settles_us = drains_us;
    change = &drained;
  }
  const std::int64_t settles_ns = change == nullptr ? 0 : change->settles_us * 1000;
  if (!in_time && !alone) change = nullptr;
  const bool proven = change != nullptr && change->claims_all();
  if (!proven) context_.board.header().unproven_switches.fetch_add(1, std::memory_order_relaxed);
  ledger_.claim_change(since_ns, since_ns + settles_ns, static_cast<std::size_t>(to.scenario),
                       change == nullptr ? nullptr : &change->worst_case_us,
                       {num_switches_, static_cast<std::uint32_t>(scenario_),
                        static_cast<std::uint32_t>(to.scenario)});
  // Jobs of the next change may be too long that much before it is known.
  settled_ns_ = since_ns + settles_ns + tables_.notice_us * 1000;
  return drains_us;
}

/// The same table: of the release that met the change it claims what it does of all that it serves.
void TableSwitch::change_scenario(std::int64_t since_ns, const Choice& to) {
  const auto us = worst_cases(tables_.tables[static_cast<std::size_t>(to.table)].keys);
  const std::vector<std::optional<std::int64_t>> across_us(us.begin(), us.end());
  ledger_.claim_change(since_ns, since_ns, static_cast<std::size_t>(to.scenario), &across_us,
                       {num_switches_, static_cast<std::uint32_t>(scenario_),
                        static_cast<std::uint32_t>(to.scenario)});
}

/// Known before what is released at `from_us` is published, so by all that have it.
void TableSwitch::put(std::uint64_t from_us, int table) {
  context_.board.put_table(from_us, static_cast<std::uint32_t>(table));
  if (from_us > 0) context_.board.header().switches.fetch_add(1);
  const Guard lock(mutex_);
  table_ = table;
}

std::string TableSwitch::words_of(const Passing& job) const {
  return fmt::format("XNode '{}' had its XPU for {:.3f} ms, allowed are {:.3f}", name_of(job.xnode),
                     static_cast<double>(job.saw_ns) * 1e-6,
                     static_cast<double>(job.allowed_ns) * 1e-6);
}

std::string TableSwitch::words_of(const Choice& choice) const {
  if (choice.xnode < 0) return {};
  if (choice.xpu >= 0)
    return fmt::format("XNode '{}' did not return from {} within its hang limit",
                       name_of(choice.xnode),
                       context_.session.platform.xpus[static_cast<std::size_t>(choice.xpu)].id);
  return words_of(Passing{choice.xnode, choice.saw_ns, choice.allowed_ns});
}

/// That an XPU is lost, and that no scenario allows what was seen, is told also where the scenario is the
/// one before.
bool TableSwitch::is_news(const Choice& choice, int from) {
  const bool lost = choice.why == Why::kLost && choice.xpu != std::exchange(lost_, choice.xpu);
  const bool is_outside = choice.why == Why::kOutside;
  const bool outside = !std::exchange(told_outside_, is_outside) && is_outside;
  return choice.scenario != from || lost || outside;
}

void TableSwitch::tell(SwitchReport change, const Choice& choice) {
  scenario_ = choice.scenario;
  BoardHeader& header = context_.board.header();
  header.scenario.store(static_cast<std::uint32_t>(choice.scenario));
  header.why.store(static_cast<std::uint32_t>(choice.why));
  change.table = tables_.tables[static_cast<std::size_t>(choice.table)].name;
  change.why = to_string(choice.why);
  change.detail = words_of(choice);
  if (context_.trace != nullptr)
    context_.trace->write(
        XAUTO_EV_SWITCH, change.release,
        choice.xnode < 0 ? XAUTO_EV_NONE : static_cast<std::uint16_t>(choice.xnode),
        static_cast<std::uint16_t>(choice.table), XAUTO_EV_NONE,
        static_cast<std::uint32_t>(choice.scenario) | static_cast<std::uint32_t>(choice.why) << 16);
  log::info("scenario '{}' -> '{}' ({}), table '{}' from release {} on{}{}", change.from, change.to,
            change.why, change.table, change.release, change.detail.empty() ? "" : ": ",
            change.detail);
  ++num_switches_;
  switches_.push_back(std::move(change));
  if (switches_.size() > kKeptSwitches) switches_.pop_front();
}

/// Counts what no scenario covers. Returns what is to be said of it.
std::vector<std::string> TableSwitch::outside(const Choice& choice, const MachineState& machine) {
  using Kind = OutsideLog::Kind;
  std::vector<OutsideLog::What> all;
  const auto name = [&](int scenario) -> const std::string& {
    return tables_.scenarios[static_cast<std::size_t>(scenario)].name;
  };
  for (const MachineState::Outside& one : machine.outside)
    all.push_back({Kind::kFile, one.file, [&] {
                     return fmt::format(
                         "the machine's clocks and modes are those of no scenario: {}; '{}' is the "
                         "least that counts",
                         one.words, name(machine.scenario));
                   }});
  // A guess may hold by now.
  if (choice.why == Why::kOutside && !choice_.holds()) {
    const std::vector<Passing> jobs = choice_.passing(choice.scenario);
    for (const Passing& job : jobs)
      all.push_back({Kind::kJob, name_of(job.xnode), [this, job, &choice, &name] {
                       return fmt::format("outside of every scenario: {} under '{}', which counts",
                                          words_of(job), name(choice.scenario));
                     }});
    if (jobs.empty())
      all.push_back({Kind::kJob, {}, [] {
                       return std::string(
                           "no scenario covers both what is asked for and what the machine's "
                           "clocks say; the clocks decide");
                     }});
  }
  const OutsideLog::News news = outside_.look(now_ns(), all);
  BoardHeader& header = context_.board.header();
  header.outside_jobs.fetch_add(news.jobs, std::memory_order_relaxed);
  header.outside_clocks.fetch_add(news.files, std::memory_order_relaxed);
  return news.say;
}

void TableSwitch::report(RunReport& into) {
  thread_.check();
  for (std::size_t s = 0; s < tables_.scenarios.size(); ++s) {
    const ScenarioLine& line = context_.board.scenario(s);
    into.scenarios.push_back({line_name(line.name), line_name(line.table), line.releases.load()});
  }
  into.switches.assign(switches_.begin(), switches_.end());
  for (const Routes::Met& met : ledger_.met()) {
    const std::uint64_t dropped = num_switches_ - switches_.size();
    if (met.change < dropped || met.change >= num_switches_) continue;
    SwitchReport& change = into.switches[met.change - dropped];
    change.chain = context_.session.app.chains[met.chain].name;
    change.spanned_us = met.us;
    change.worst_case_us = met.claimed_us;
  }
  into.num_switches = num_switches_;
  const Guard lock(mutex_);
  into.account.add("job_outside_scenarios", 0, outside_.all(OutsideLog::Kind::kJob));
  into.account.add("clock_outside_scenarios", 0, outside_.all(OutsideLog::Kind::kFile));
}

}  // namespace xauto::runtime
