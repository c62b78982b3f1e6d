// SPDX-License-Identifier: Apache-2.0
#include "tables/table_switch.h"

#include <algorithm>
#include <utility>

#include <uapi/xauto/event.h>

#include "base/clock.h"
#include "base/log.h"
#include "model/claims.h"
#include "model/drain.h"
#include "session/changes.h"

namespace xauto::runtime {

Result<std::unique_ptr<TableSwitch>> TableSwitch::make(const Context& context, Ledger& ledger,
                                                       ScenarioWatch::TellTimes tell_times,
                                                       std::function<void(std::size_t)> show) {
  if (!context.session.tables) return std::unique_ptr<TableSwitch>();
  XAUTO_ASSIGN(auto watch, ScenarioWatch::start(context, std::move(tell_times)));
  return std::unique_ptr<TableSwitch>(
      new TableSwitch(context, ledger, std::move(watch), std::move(show)));
}

TableSwitch::TableSwitch(const Context& context, Ledger& ledger,
                         std::unique_ptr<ScenarioWatch> watch,
                         std::function<void(std::size_t)> show)
    : context_(context),
      ledger_(ledger),
      tables_(*context.session.tables),
      watch_(std::move(watch)),
      show_(std::move(show)),
      table_(watch_->now().table),
      scenario_(watch_->now().scenario) {
  const Session& session = context.session;
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

void TableSwitch::stop_watch() {
  thread_.check();
  watch_->stop(scenario_);
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
  const Choice choice = watch_->choose(from);
  const std::int64_t now = now_ns();
  const std::uint64_t since_us = first_us_of_table(nominal_ns, newest_ns_);
  newest_ns_ = std::max(newest_ns_, nominal_ns);
  const std::int64_t before_ns = std::exchange(released_ns_, now);
  std::int64_t drains_us = 0;
  if (choice.table != table_) {
    if (static_cast<std::int64_t>(since_us) * 1000 < settled_ns_) {
      context_.board.header().unsettled.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    const std::int64_t too_long_ns = choice.saw_ns - choice.allowed_ns +
                                     (context_.session.emulates() ? kEmulatorStallUs * 1000 : 0);
    drains_us =
        change_table(since_us, choice,
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
std::int64_t TableSwitch::change_table(std::uint64_t from_us, const Choice& to, bool in_time) {
  const int from = table_;
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
  table_ = table;
  show_(static_cast<std::size_t>(table));
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
  change.detail = watch_->words_of(choice);
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
  watch_->report(into.account);
}

}  // namespace xauto::runtime
