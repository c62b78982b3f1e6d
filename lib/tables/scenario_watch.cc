// SPDX-License-Identifier: Apache-2.0
#include "tables/scenario_watch.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "base/clock.h"
#include "base/log.h"
#include "model/claims.h"

namespace xauto::runtime {
namespace {

ChoiceOptions options_of(const Deployment& deployment) {
  ChoiceOptions options;
  if (deployment.tables.dwell_us) options.dwell_ns = *deployment.tables.dwell_us * 1'000;
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

/// Of the first source; 0: none is stated.
std::int64_t period_ns(const Context& context) {
  const Session& session = context.session;
  if (!session.releases.input.empty() || session.releases.lockstep || context.app.sources.empty())
    return 0;
  return 1000 * (session.releases.period_us > 0 ? session.releases.period_us
                                                : context.app.sources.front().period.floor_us());
}

}  // namespace

Result<std::unique_ptr<ScenarioWatch>> ScenarioWatch::start(const Context& context,
                                                            TellTimes tell_times) {
  std::unique_ptr<ScenarioWatch> made(new ScenarioWatch(context, std::move(tell_times)));
  const std::int64_t period = period_ns(context);
  // A job that is too long is found in the same period; what is in memory costs nothing to look at.
  const std::int64_t glance_ns = std::clamp(period / 8, kGlanceOftenNs, kGlanceSeldomNs);
  const ScenarioOrder* order = nullptr;
  {
    const Guard lock(made->mutex_);
    order = &made->choice_.order();
  }
  XAUTO_ASSIGN(made->conditions_,
               ConditionWatch::start(
                   made->tables_, *order, {read_every_ns(period), glance_ns},
                   [w = made.get()](const MachineState& machine) { return w->glance(machine); }));
  return made;
}

ScenarioWatch::ScenarioWatch(const Context& context, TellTimes tell_times)
    : context_(context),
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
      hangs_(context.session.app.xnodes.size()) {
  for (std::size_t n = 0; n < context.graph.nodes.size(); ++n)
    node_of_[static_cast<std::size_t>(context.session.app.find(context.graph.nodes[n].name))] = n;
}

/// What jobs took since the last look, and how long those that run have taken so far; what people and
/// the machine's files say.
void ScenarioWatch::look(const MachineState& machine) {
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
void ScenarioWatch::take_past() {
  for (std::size_t x = 0; x < past_.size(); ++x) {
    XNodeLine& line = context_.board.xnode(node_of_[x]);
    past_[x] = {};
    if (line.past_jobs.load(std::memory_order_relaxed) != 0)
      past_[x] = {line.past_jobs.exchange(0), line.past_job.exchange(0)};
  }
}

/// They ended under `in_force`; what is chosen now is from the next release on, and
/// the change between both is claimed with the longer jobs of either.
void ScenarioWatch::judge_past(int in_force) {
  for (std::size_t x = 0; x < past_.size(); ++x) {
    const std::size_t table = XNodeLine::table_of(past_[x].longest);
    if (past_[x].jobs == 0 || table >= tables_.tables.size()) continue;
    const auto may = [&](int scenario) {
      return claimed_.under(static_cast<std::size_t>(scenario), table, x);
    };
    const std::int64_t by_ns =
        XNodeLine::ns_of(past_[x].longest) - std::max(may(in_force), may(choice_.now().scenario));
    if (by_ns > 0) context_.board.xnode(node_of_[x]).over(past_[x].jobs, by_ns);
  }
}

bool ScenarioWatch::glance(const MachineState& machine) {
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

Choice ScenarioWatch::now() const {
  const Guard lock(mutex_);
  return choice_.now();
}

void ScenarioWatch::stop(int in_force) {
  if (conditions_ == nullptr) return;
  const MachineState machine = conditions_->now();
  conditions_.reset();
  (void)glance(machine);
  const Guard lock(mutex_);
  take_past();
  judge_past(in_force);  // no release comes that another scenario would be for
}

/// What no scenario covers is said here where the watch's thread has not seen it.
Choice ScenarioWatch::choose(int in_force) {
  std::vector<std::string> said;
  Choice chosen;
  {
    const MachineState machine = conditions_->now();
    const Guard lock(mutex_);
    take_past();
    look(machine);
    choice_.decide(now_ns());
    judge_past(in_force);
    chosen = choice_.now();
    said = outside(chosen, machine);
  }
  say(said);
  return chosen;
}

std::string ScenarioWatch::words_of(const Passing& job) const {
  return fmt::format("XNode '{}' had its XPU for {:.3f} ms, allowed are {:.3f}", name_of(job.xnode),
                     static_cast<double>(job.saw_ns) * 1e-6,
                     static_cast<double>(job.allowed_ns) * 1e-6);
}

std::string ScenarioWatch::words_of(const Choice& choice) const {
  if (choice.xnode < 0) return {};
  if (choice.xpu >= 0)
    return fmt::format("XNode '{}' did not return from {} within its hang limit",
                       name_of(choice.xnode),
                       context_.session.platform.xpus[static_cast<std::size_t>(choice.xpu)].id);
  return words_of(Passing{choice.xnode, choice.saw_ns, choice.allowed_ns});
}

/// Counts what no scenario covers. Returns what is to be said of it.
std::vector<std::string> ScenarioWatch::outside(const Choice& choice, const MachineState& machine) {
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

void ScenarioWatch::report(Account& into) const {
  const Guard lock(mutex_);
  into.add("job_outside_scenarios", 0, outside_.all(OutsideLog::Kind::kJob));
  into.add("clock_outside_scenarios", 0, outside_.all(OutsideLog::Kind::kFile));
}

}  // namespace xauto::runtime
