// SPDX-License-Identifier: Apache-2.0
// A model of Amalthea as an app.
//
// A task is an XNode, in a module of its own; where it triggers another task, or waits for what another one sets, it is
// cut, and each part is an XNode:
//
//      task PRE_gpu_POST   [ pre | trigger S ][ wait E | post ]           pre ──► gpu ──► post
//      task gpu, by S      [ gpu ... set E ]
//
// Each task that a stimulus of time activates has a source of its own, so that a label that one writes and another reads
// is a sample: it takes the newest that is there. Time is ticks by the slowest unit of a definition.
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

#include "base/index.h"
#include "model/components.h"
#include "model/periodic.h"

#include "import/amalthea.h"
#include "import/questions.h"

namespace xauto::import {
namespace {

using ItemKind = ActivityItem::Kind;
using StimulusKind = AmaltheaStimulus::Kind;

constexpr double kTicksPerUsWhereUnknown = 1000;
constexpr std::int64_t kPsPerUs = 1'000'000;
constexpr std::size_t kMostPairs =
    20'000'000;  ///< of who writes and who reads a label, that are looked at
constexpr std::size_t kMostChains = 1000, kMostSetters = 16;

/// us, at most and usually; none: it cannot run there.
using Cost = std::optional<std::pair<double, double>>;

Cost sum(const Cost& a, const Cost& b) {
  return a && b ? Cost({a->first + b->first, a->second + b->second}) : std::nullopt;
}

Cost worse(const Cost& a, const Cost& b) {
  return a && b ? Cost({std::max(a->first, b->first), std::max(a->second, b->second)})
                : std::nullopt;
}

Period period_of(std::int64_t ps) {
  const std::int64_t common = std::gcd(ps, kPsPerUs);
  return {ps / common, kPsPerUs / common};
}

struct Part {
  std::vector<Cost> cost;               ///< [definition]
  std::vector<std::string> runnables;   ///< in their order, with those that these call
  std::set<std::string> reads, writes;  ///< labels
  std::vector<std::string> waits, sets;
};

class AmaltheaImporter {
 public:
  AmaltheaImporter(const AmaltheaModel& model, const AmaltheaOptions& options,
                   std::vector<std::string>& lines)
      : model_(model), options_(options), lines_(lines) {}

  Result<ImportedApp> run() {
    app().name = options_.name;
    find_definitions();
    for (const AmaltheaTask& task : model_.tasks) cut(task);
    find_activations();
    if (app().xnodes.empty())
      return fail(ErrorCode::kInvalid, "has no task that anything activates", "the model",
                  "give its tasks stimuli");
    find_waits();
    complete_modules(app());
    find_chains();
    if (!chosen_samples_) find_samples();
    complete_chains(app());
    XAUTO_TRY(is_app(app(), "the model"));
    ask();
    tell();
    return std::move(out_);
  }

 private:
  AppSpec& app() { return out_.app; }
  void ask_once(const std::string& what) {
    if (asked_.insert(what).second && asked_.size() <= 4 * kMostAsked) todo(out_, "", what);
  }

  // ---- processing units -------------------------------------------------------------------------------

  struct Speed {
    std::string definition, type;
    double ticks_per_us = 0;
  };

  void find_definitions() {
    for (const AmaltheaUnit& unit : model_.units) {
      double ticks = unit.ticks_per_us;
      if (!(ticks > 0)) {
        ticks = kTicksPerUsWhereUnknown;
        ask_once("no frequency of '" + unit.definition +
                 "' is known: 1000 ticks are taken for 1 us");
      }
      const auto known = std::ranges::find(speeds_, unit.definition, &Speed::definition);
      if (known == speeds_.end())
        speeds_.push_back({unit.definition, unit.type, ticks});
      else
        known->ticks_per_us = std::min(known->ticks_per_us, ticks);
    }
    if (speeds_.empty()) {
      speeds_.push_back({"", "cpu", kTicksPerUsWhereUnknown});
      ask_once("the model has no processing units: 1000 ticks are taken for 1 us of a core");
    }
    any_cpu_ = std::ranges::find(speeds_, "cpu", &Speed::type) != speeds_.end();
    if (std::ranges::count(speeds_, "cpu", &Speed::type) > 1)
      ask_once("its cores are of several kinds: a WCET on cpu is that of the slowest");
  }

  // ---- what a task does -------------------------------------------------------------------------------

  [[nodiscard]] Part nothing() const {
    return {std::vector<Cost>(speeds_.size(), Cost({0, 0})), {}, {}, {}, {}, {}};
  }

  void add_ticks(const ActivityItem& item, Part& to) {
    for (std::size_t d = 0; d < speeds_.size(); ++d) {
      const auto on = item.ticks_on.find(speeds_[d].definition);
      const Deviation* ticks = on != item.ticks_on.end() ? &on->second
                               : item.ticks && (speeds_[d].type == "cpu" || !any_cpu_)
                                   ? &*item.ticks
                                   : nullptr;
      if (ticks != nullptr && !ticks->bounded)
        ask_once(
            "some execution needs have no upper bound: their mean and three standard deviations "
            "are taken");
      const double per_us = speeds_[d].ticks_per_us;
      to.cost[d] = sum(to.cost[d], ticks == nullptr
                                       ? std::nullopt
                                       : Cost({ticks->highest / per_us, ticks->usual / per_us}));
    }
  }

  void join(const Part& from, Part& to) {
    work_ += from.runnables.size() + from.reads.size() + from.writes.size();
    if (work_ > kMaxRunnablesCalled) return;
    to.runnables.insert(to.runnables.end(), from.runnables.begin(), from.runnables.end());
    to.reads.insert(from.reads.begin(), from.reads.end());
    to.writes.insert(from.writes.begin(), from.writes.end());
  }

  /// Whether something in it triggers, sets or waits.
  bool has_sync(const std::vector<ActivityItem>& items, int depth = 0) {
    return depth < kMaxCallDepth && std::ranges::any_of(items, [&](const ActivityItem& item) {
             switch (item.kind) {
               case ItemKind::kTrigger:
               case ItemKind::kWait:
               case ItemKind::kSet:
                 return true;
               case ItemKind::kSwitch:
                 return std::ranges::any_of(item.branches, [&](const auto& branch) {
                   return has_sync(branch, depth + 1);
                 });
               case ItemKind::kRunnable:
                 return runnable_has_sync(item.name, depth);
               default:
                 return false;
             }
           });
  }

  bool runnable_has_sync(const std::string& name, int depth) {
    const auto known = sync_.find(name);
    if (known != sync_.end()) return known->second;
    const auto runnable = model_.runnables.find(name);
    if (runnable == model_.runnables.end()) return false;
    sync_[name] = false;  // of one that calls itself
    return sync_[name] = has_sync(runnable->second, depth + 1);
  }

  /// What items without triggers, sets and waits do.
  void add(const std::vector<ActivityItem>& items, Part& to, int depth) {
    if (depth > kMaxCallDepth) return ask_once("runnables call each other too deep, or themselves");
    for (const ActivityItem& item : items) {
      if (++work_ > kMaxRunnablesCalled)
        return ask_once("too many calls of runnables: the rest is left out");
      switch (item.kind) {
        case ItemKind::kTicks:
          add_ticks(item, to);
          break;
        case ItemKind::kAccess:
          (item.write ? to.writes : to.reads).insert(item.name);
          break;
        case ItemKind::kRunnable:
          add_runnable(item.name, to, depth);
          break;
        case ItemKind::kSwitch: {
          std::vector<Cost> worst(speeds_.size(), Cost({0, 0}));
          for (const std::vector<ActivityItem>& branch : item.branches) {
            Part one = nothing();
            add(branch, one, depth + 1);
            join(one, to);
            for (std::size_t d = 0; d < worst.size(); ++d) worst[d] = worse(worst[d], one.cost[d]);
          }
          for (std::size_t d = 0; d < worst.size(); ++d) to.cost[d] = sum(to.cost[d], worst[d]);
          break;
        }
        default:
          break;
      }
    }
  }

  void add_runnable(const std::string& name, Part& to, int depth) {
    const auto runnable = model_.runnables.find(name);
    if (runnable == model_.runnables.end())
      return ask_once("runnable '" + name + "' is called and not in the model");
    to.runnables.push_back(name);
    auto known = runnable_.find(name);
    if (known == runnable_.end()) {
      if (!calling_.insert(name).second) return ask_once("runnable '" + name + "' calls itself");
      Part made = nothing();
      add(runnable->second, made, depth + 1);
      calling_.erase(name);
      known = runnable_.emplace(name, std::move(made)).first;
    }
    join(known->second, to);
    for (std::size_t d = 0; d < speeds_.size(); ++d)
      to.cost[d] = sum(to.cost[d], known->second.cost[d]);
  }

  // ---- tasks are cut --------------------------------------------------------------------------------------

  struct Task {
    const AmaltheaTask* from = nullptr;
    std::vector<Part> parts;
    std::vector<std::pair<std::string, std::size_t>>
        triggers;             ///< stimulus, and the part before it
    int first = -1;           ///< XNode; -1: left out
    int by_task = -1;         ///< what activates it: this task ...
    std::size_t by_part = 0;  ///< ... behind this part of it
    int source = -1;          ///< ... or this source
  };

  struct Cutting {
    Task* task = nullptr;
    bool open = false;  ///< the last part may grow

    Part& part(const Part& fresh) {
      if (!std::exchange(open, true)) task->parts.push_back(fresh);
      return task->parts.back();
    }
  };

  void cut(const AmaltheaTask& from) {
    Task& task = tasks_.emplace_back();
    task.from = &from;
    Cutting cutting{&task};
    walk(from.items, cutting, 0);
    if (task.parts.empty()) task.parts.push_back(nothing());
  }

  void walk(const std::vector<ActivityItem>& items, Cutting& cutting, int depth) {
    if (depth > kMaxCallDepth) return ask_once("runnables call each other too deep, or themselves");
    for (const ActivityItem& item : items) {
      if (++work_ > kMaxRunnablesCalled || cutting.task->parts.size() >= kMaxXNodes) return;
      if (item.kind == ItemKind::kTrigger) {
        cutting.part(nothing());
        cutting.task->triggers.emplace_back(item.name, cutting.task->parts.size() - 1);
        cutting.open = false;
      } else if (item.kind == ItemKind::kSet) {
        std::vector<std::string>& sets = cutting.part(nothing()).sets;
        sets.insert(sets.end(), item.events.begin(), item.events.end());
        cutting.open = false;
      } else if (item.kind == ItemKind::kWait) {
        cutting.open = false;
        cutting.part(nothing()).waits = item.events;
      } else if (item.kind == ItemKind::kRunnable && runnable_has_sync(item.name, depth)) {
        cutting.part(nothing()).runnables.push_back(item.name);
        walk(model_.runnables.at(item.name), cutting, depth + 1);
      } else if (item.kind == ItemKind::kSwitch && has_sync({item}, depth)) {
        ask_once(
            "a switch with triggers or events in it: all its branches are taken, one after the "
            "other");
        for (const std::vector<ActivityItem>& branch : item.branches)
          walk(branch, cutting, depth + 1);
      } else {
        add({item}, cutting.part(nothing()), depth);
      }
    }
  }

  // ---- what activates it ------------------------------------------------------------------------------------

  void find_activations() {
    std::map<std::string, std::vector<std::pair<int, std::size_t>>> triggered;
    for (std::size_t t = 0; t < tasks_.size(); ++t)
      for (const auto& [stimulus, part] : tasks_[t].triggers)
        triggered[stimulus].emplace_back(static_cast<int>(t), part);
    std::map<std::string, int> heard;  // tasks that a stimulus activates
    for (const Task& task : tasks_)
      for (const std::string& stimulus : task.from->stimuli) ++heard[stimulus];
    for (std::size_t t = 0; t < tasks_.size(); ++t) activate(static_cast<int>(t), triggered, heard);
    find_rates();
    for (std::size_t t = 0; t < tasks_.size(); ++t) place(static_cast<int>(t));
    for (std::size_t t = 0; t < tasks_.size(); ++t) join_parts(tasks_[t]);
  }

  [[nodiscard]] bool behind(int task, int other) const {
    for (std::size_t n = 0; task >= 0 && n <= tasks_.size(); ++n, task = tasks_[at(task)].by_task)
      if (task == other) return true;
    return task >= 0;
  }

  void activate(int t,
                const std::map<std::string, std::vector<std::pair<int, std::size_t>>>& triggered,
                const std::map<std::string, int>& heard) {
    Task& task = tasks_[at(t)];
    if (task.from->stimuli.size() > 1)
      ask_once("'" + task.from->name +
               "' has several stimuli: the first that is known activates it here");
    for (const std::string& name : task.from->stimuli) {
      const auto stimulus = model_.stimuli.find(name);
      const auto by = triggered.find(name);
      const AmaltheaStimulus* known =
          stimulus == model_.stimuli.end() ? nullptr : &stimulus->second;
      std::vector<std::pair<int, std::size_t>> from;
      if (by != triggered.end()) from = by->second;
      if (known != nullptr && known->kind == StimulusKind::kEvent)
        for (const std::string& event : known->events)
          if (const auto where = part_of_event(event)) from.push_back(*where);
      std::erase_if(from, [&](const auto& one) { return behind(one.first, t); });
      if (from.size() > 1)
        ask_once("'" + task.from->name + "' is triggered by several: only the first is an edge");
      if (!from.empty()) {
        task.by_task = from.front().first;
        task.by_part = from.front().second;
        return;
      }
      if (known == nullptr || known->kind == StimulusKind::kInterProcess) continue;
      make_source(task, *known, heard.at(name) > 1);
      return;
    }
    if (task.from->stimuli.empty())
      ask_once("'" + task.from->name + "' has no stimulus: it is left out");
    else
      ask_once("'" + task.from->name +
               "': nothing triggers its stimulus, or itself does: it is left out");
  }

  void make_source(Task& task, const AmaltheaStimulus& stimulus, bool shared) {
    if (app().sources.size() >= kMaxSources) return;
    std::string name = bare(shared ? stimulus.name + "/" + task.from->name : stimulus.name);
    name = unique(name, source_names_);
    SourceSpec source{name, kNoRate};
    if (stimulus.kind == StimulusKind::kPeriodic || stimulus.kind == StimulusKind::kSporadic)
      source.period = period_of(stimulus.least_ps);
    if (source.period != kNoRate && !source.period.valid()) {
      ask_once("'" + stimulus.name + "' has a period below a microsecond, or above an hour");
      source.period = kNoRate;
    }
    if (source.period == kNoRate) {
      unknown_rate_.emplace_back(app().sources.size(), stimulus.type);
    } else {
      const std::int64_t period_us = std::max<std::int64_t>(1, source.period.floor_us());
      source.offset_us = stimulus.offset_ps / kPsPerUs;
      if (source.offset_us >= period_us) {
        ask_once("the offset of '" + stimulus.name +
                 "' is a period or more: what is more is left out");
        source.offset_us %= period_us;
      }
      source.jitter_us = std::min(up_to_us(stimulus.jitter_ps / 1000), kMaxPeriodUs);
      if (stimulus.kind == StimulusKind::kSporadic) {
        source.clock = static_cast<int>(app().clocks.size());
        app().clocks.push_back({name, kDefaultPpm});
        if (stimulus.most_ps > stimulus.least_ps)
          ask_once("'" + stimulus.name + "' comes " + std::to_string(stimulus.least_ps / kPsPerUs) +
                   " to " + std::to_string(stimulus.most_ps / kPsPerUs) +
                   " us after the last: here as often as it may, on a clock of its own");
      }
    }
    task.source = static_cast<int>(app().sources.size());
    app().sources.push_back(std::move(source));
  }

  /// Either all sources have rates, or none has.
  void find_rates() {
    Period slowest{0, 1};
    for (const SourceSpec& source : app().sources)
      if (source.period != kNoRate) slowest = std::max(slowest, source.period);
    app().one_at_a_time = slowest.num == 0;
    const std::int64_t us = slowest.num / slowest.den;
    for (const auto& [s, type] : unknown_rate_) {
      SourceSpec& source = app().sources[s];
      const std::string what = "how often does '" + source.name + "' come (" + type + ")";
      if (app().one_at_a_time) {
        todo(out_, "/sources/" + std::to_string(s) + "/rate_hz", what + ", in Hz?");
        continue;
      }
      source.period = {std::max<std::int64_t>(1, us), 1};
      todo(out_, "/sources/" + std::to_string(s) + "/period_us",
           what + ", each how many us? here as the slowest, " + std::to_string(us));
    }
  }

  static std::string unique(const std::string& wanted, std::set<std::string>& used) {
    std::string name = wanted;
    for (int n = 2; !used.insert(name).second; ++n) name = wanted + "-" + std::to_string(n);
    return name;
  }

  [[nodiscard]] int root_of(int task) const {
    while (tasks_[at(task)].by_task >= 0) task = tasks_[at(task)].by_task;
    return task;
  }

  void place(int t) {
    Task& task = tasks_[at(t)];
    const int root = root_of(t);
    if (tasks_[at(root)].source < 0) return;
    if (app().xnodes.size() + task.parts.size() > kMaxXNodes)
      return ask_once("more than 20000 XNodes: the rest is left out");
    task.first = static_cast<int>(app().xnodes.size());
    for (std::size_t p = 0; p < task.parts.size(); ++p) {
      const std::string plain = bare(task.from->name);
      const std::string name =
          unique(p == 0 ? plain : bare(plain + "." + std::to_string(p + 1)), xnode_names_);
      XNodeSpec xnode{name, name, {}};
      put_cost(task.parts[p], xnode);
      if (p == 0 && task.source >= 0) xnode.sources = {task.source};
      task_of_.push_back(t);
      app().xnodes.push_back(std::move(xnode));
    }
  }

  void put_cost(const Part& part, XNodeSpec& xnode) {
    for (std::size_t d = 0; d < speeds_.size(); ++d) {
      const Cost& cost = part.cost[d];
      if (!cost || cost->first <= 0) continue;
      const auto us = [](double value) {
        return static_cast<std::int64_t>(
            std::clamp(std::ceil(value), 1.0, static_cast<double>(kMaxTimeUs)));
      };
      std::int64_t& wcet = xnode.wcet_us[speeds_[d].type];
      wcet = std::max(wcet, with_margin(us(cost->first), options_.margin_pct));
      std::int64_t& usual = xnode.typical_us[speeds_[d].type];
      usual = std::max(usual, std::min(us(cost->second), wcet));
    }
    if (!xnode.wcet_us.empty()) return;
    xnode.wcet_us["cpu"] = 1;
    const std::size_t x = app().xnodes.size();
    if (++unknown_times_ <= kMostAsked)
      todo(out_, "/xnodes/" + std::to_string(x) + "/wcet_us",
           "how long does '" + xnode.name +
               R"(' take? the model does not say. {"cpu": MICROSECONDS})");
  }

  void join_parts(const Task& task) {
    if (task.first < 0) return;
    if (task.by_task >= 0) {
      const Task& by = tasks_[at(task.by_task)];
      if (by.first < 0) return;  // there were too many
      edge(by.first + static_cast<int>(task.by_part), task.first);
    }
    for (std::size_t p = 1; p < task.parts.size(); ++p)
      if (task.parts[p].waits.empty())
        edge(task.first + static_cast<int>(p) - 1, task.first + static_cast<int>(p));
  }

  void edge(int u, int v) {
    if (u != v && edges_.insert({u, v}).second) app().edges.emplace_back(u, v);
  }

  // ---- events -----------------------------------------------------------------------------------------------

  /// A part that waits comes behind those that set what it waits for, and behind the part before it.
  void find_waits() {
    std::map<std::string, std::vector<int>> setters;
    for (const Task& task : tasks_)
      for (std::size_t p = 0; p < task.parts.size() && task.first >= 0; ++p)
        for (const std::string& event : task.parts[p].sets)
          setters[event].push_back(task.first + static_cast<int>(p));
    for (std::size_t t = 0; t < tasks_.size(); ++t) {
      const Task& task = tasks_[t];
      for (std::size_t p = 0; p < task.parts.size() && task.first >= 0; ++p)
        if (!task.parts[p].waits.empty()) wait(static_cast<int>(t), p, setters);
    }
  }

  void wait(int t, std::size_t p, const std::map<std::string, std::vector<int>>& setters) {
    const Task& task = tasks_[at(t)];
    const int waits = task.first + static_cast<int>(p);
    bool set_behind = false;
    for (const std::string& event : task.parts[p].waits) {
      const auto found = setters.find(event);
      if (found == setters.end()) {
        ask_once("nobody sets event '" + event + "', for which '" + app().xnodes[at(waits)].name +
                 "' waits");
        continue;
      }
      if (found->second.size() > kMostSetters)
        ask_once("event '" + event + "' is set in more places than are looked at");
      for (std::size_t n = 0; n < std::min(found->second.size(), kMostSetters); ++n) {
        const int u = found->second[n];
        if (u == waits || precedes(waits, u)) continue;
        if (root_of(task_of_[at(u)]) != root_of(t)) {
          sample(u, waits);
          ask_once("'" + app().xnodes[at(waits)].name +
                   "' waits for an event of another rate: here it takes the newest");
          continue;
        }
        edge(u, waits);
        set_behind = set_behind || (p > 0 && precedes(waits - 1, u));
      }
    }
    if (p > 0 && !set_behind) edge(waits - 1, waits);
  }

  [[nodiscard]] bool precedes(int u, int v) const {
    std::set<int> seen;
    std::vector<int> open = {u};
    while (!open.empty()) {
      const int x = open.back();
      open.pop_back();
      if (x == v) return true;
      if (!seen.insert(x).second) continue;
      for (auto e = edges_.lower_bound({x, -1}); e != edges_.end() && e->first == x; ++e)
        open.push_back(e->second);
    }
    return false;
  }

  // ---- labels -----------------------------------------------------------------------------------------------

  void sample(int u, int v) {
    if (app().one_at_a_time)
      return ask_once(
          "who reads what others write is left out: without rates there are no samples");
    if (app().samples.size() < kMaxSamples && samples_.insert({u, v}).second)
      app().samples.emplace_back(u, v);
  }

  void find_samples() {
    std::map<std::string, std::pair<std::vector<int>, std::vector<int>>> labels;
    for (const Task& task : tasks_)
      for (std::size_t p = 0; p < task.parts.size() && task.first >= 0; ++p) {
        const int x = task.first + static_cast<int>(p);
        for (const std::string& label : task.parts[p].writes) labels[label].first.push_back(x);
        for (const std::string& label : task.parts[p].reads) labels[label].second.push_back(x);
      }
    std::size_t pairs = 0;
    for (const auto& [label, users] : labels)
      for (const int u : users.first)
        for (const int v : users.second) {
          if (++pairs > kMostPairs)
            return ask_once("more pairs of who writes and reads than are looked at");
          if (root_of(task_of_[at(u)]) != root_of(task_of_[at(v)])) sample(u, v);
        }
  }

  // ---- chains -----------------------------------------------------------------------------------------------

  /// The task and its part in which an event happens.
  [[nodiscard]] std::optional<std::pair<int, std::size_t>> part_of_event(
      const std::string& name) const {
    const auto found = model_.events.find(name);
    if (found == model_.events.end()) return std::nullopt;
    const AmaltheaEvent& event = found->second;
    const bool of_process = event.type == "ProcessEvent";
    const std::string& runnable = event.type == "RunnableEvent" ? event.entity : event.runnable;
    const std::string& process = of_process ? event.entity : event.process;
    for (std::size_t t = 0; t < tasks_.size(); ++t) {
      const Task& task = tasks_[t];
      if (!process.empty() && task.from->name != process) continue;
      for (std::size_t p = 0; p < task.parts.size(); ++p) {
        const Part& part = task.parts[p];
        const bool here =
            !runnable.empty()
                ? std::ranges::find(part.runnables, runnable) != part.runnables.end()
                : of_process ||
                      (event.type == "LabelEvent" &&
                       (part.writes.contains(event.entity) || part.reads.contains(event.entity)));
        if (here) return std::pair(static_cast<int>(t), p);
      }
    }
    return std::nullopt;
  }

  void find_chains() {
    std::map<std::string, std::int64_t> of_chain;
    for (const AmaltheaLimit& limit : model_.limits)
      if (!limit.chain.empty()) of_chain[limit.chain] = limit.limit_ps;
    std::set<std::string> names;
    for (const AmaltheaChain& chain : model_.chains) {
      if (app().chains.size() >= kMostChains)
        return ask_once("more than 1000 chains: the rest is left out");
      const auto limit = of_chain.find(chain.name);
      add_event_chain(
          chain, limit == of_chain.end() ? std::optional<std::int64_t>() : limit->second, names);
    }
    for (const AmaltheaLimit& limit : model_.limits) {
      if (app().chains.size() >= kMostChains)
        return ask_once("more than 1000 chains: the rest is left out");
      for (std::size_t t = 0; t < tasks_.size(); ++t) add_limit(limit, static_cast<int>(t), names);
    }
  }

  void add_limit(const AmaltheaLimit& limit, int t, std::set<std::string>& names) {
    const Task& task = tasks_[at(t)];
    if (task.first < 0 || !limit.chain.empty()) return;
    std::size_t part = task.parts.size() - 1;
    if (limit.process.empty()) {
      part = 0;
      while (part < task.parts.size() &&
             std::ranges::find(task.parts[part].runnables, limit.runnable) ==
                 task.parts[part].runnables.end())
        ++part;
    } else if (task.from->name != limit.process) {
      return;
    }
    if (part == task.parts.size()) return;
    if (task.by_task >= 0)
      ask_once("the limit of '" + task.from->name +
               "' counts from what triggers it on; its chain from the source on");
    push_chain({bare(limit.process.empty() ? limit.runnable : limit.process),
                tasks_[at(root_of(t))].source, task.first + static_cast<int>(part),
                deadline(limit.limit_ps), 1},
               names);
  }

  static std::optional<std::int64_t> deadline(std::optional<std::int64_t> ps) {
    if (!ps || *ps < kPsPerUs) return std::nullopt;
    return std::min(*ps / kPsPerUs, kMaxTimeUs);
  }

  void push_chain(ChainSpec chain, std::set<std::string>& names) {
    chain.name = unique(chain.name, names);
    app().chains.push_back(std::move(chain));
  }

  void add_event_chain(const AmaltheaChain& chain, std::optional<std::int64_t> limit_ps,
                       std::set<std::string>& names) {
    std::vector<std::pair<int, std::string>> way;  // XNode, and the runnable
    for (const std::string& name : chain.events) {
      const auto where = part_of_event(name);
      if (!where || tasks_[at(where->first)].first < 0)
        return ask_once("chain '" + chain.name + "' is left out: no task has event '" + name + "'");
      const AmaltheaEvent& event = model_.events.at(name);
      way.emplace_back(tasks_[at(where->first)].first + static_cast<int>(where->second),
                       event.type == "RunnableEvent" ? event.entity : event.runnable);
    }
    if (way.empty()) return;
    chosen_samples_ = true;
    for (std::size_t n = 1; n < way.size(); ++n) {
      const auto& [u, from] = way[n - 1];
      const auto& [v, to] = way[n];
      if (root_of(task_of_[at(u)]) != root_of(task_of_[at(v)]))
        sample(u, v);
      else if (goes_back(u, v, from, to))
        ask_once("chain '" + chain.name + "' goes back inside '" + app().xnodes[at(v)].name +
                 "': it takes a period more than is claimed here");
    }
    push_chain({bare(chain.name), tasks_[at(root_of(task_of_[at(way.front().first)]))].source,
                way.back().first, deadline(limit_ps), 1},
               names);
    if (const Status valid = validate(app()); !valid) {
      ask_once("chain '" + chain.name + "' is no chain here: " + valid.error().what);
      app().chains.pop_back();
    }
  }

  /// Whether v, or in one part the runnable `to`, is not behind u.
  [[nodiscard]] bool goes_back(int u, int v, const std::string& from, const std::string& to) const {
    if (u != v) return !precedes(u, v);
    const Task& task = tasks_[at(task_of_[at(u)])];
    const auto& order = task.parts[at(u - task.first)].runnables;
    return std::ranges::find(order, from) > std::ranges::find(order, to);
  }

  // ---- what is not known ------------------------------------------------------------------------------------

  void ask() {
    todo(out_, "",
         "a WCET is the upper bound of the ticks: what accesses to memory take is not in it");
    ask_deadlines(out_);
    std::size_t without = 0;
    std::set<int> ends;
    for (const ChainSpec& chain : app().chains) ends.insert(chain.to);
    for (const Task& task : tasks_)
      without +=
          task.first >= 0 &&
                  std::ranges::none_of(
                      ends, [&](int to) { return task_of_[at(to)] == task_of_[at(task.first)]; })
              ? 1
              : 0;
    if (without > 0)
      todo(out_, "",
           "no chain ends in " + counted(without, "task") + ": nothing is claimed of them");
    if (chosen_samples_)
      todo(out_, "",
           "samples are those of the model's chains: other labels that tasks share lead nowhere "
           "here");
    std::vector<double> load;
    for (std::size_t x = 0; x < app().xnodes.size(); ++x) {
      const Period& period = app().sources[at(tasks_[at(root_of(task_of_[x]))].source)].period;
      const auto usual = app().xnodes[x].typical_us.begin();
      load.push_back(usual == app().xnodes[x].typical_us.end()
                         ? 0
                         : static_cast<double>(usual->second) * static_cast<double>(period.den) /
                               static_cast<double>(period.num));
    }
    ask_other_xpus(out_, load);
  }

  void tell() {
    lines_.push_back(
        counted(app().xnodes.size(), "XNode") + " of " + counted(model_.tasks.size(), "task") +
        " and " + counted(model_.runnables.size(), "runnable") + ", " +
        counted(app().sources.size(), "source") + ", " + counted(app().edges.size(), "edge") +
        ", " + counted(app().samples.size(), "sample") + ", " +
        counted(app().chains.size(), "chain"));
    std::map<std::string, std::size_t> units;
    for (const AmaltheaUnit& unit : model_.units) ++units[unit.type];
    std::string text;
    for (const auto& [type, count] : units)
      text += (text.empty() ? "" : ", ") + std::to_string(count) + " " + type;
    if (!text.empty())
      lines_.push_back("processing units: " + text +
                       " (--platform-out); which task is on which core is left out");
    for (const std::string& note : model_.notes) lines_.push_back(note);
  }

  const AmaltheaModel& model_;
  const AmaltheaOptions& options_;
  std::vector<std::string>& lines_;
  ImportedApp out_;
  std::vector<Speed> speeds_;
  bool any_cpu_ = false;
  std::vector<Task> tasks_;
  std::map<std::string, Part> runnable_;
  std::map<std::string, bool> sync_;
  std::set<std::string> calling_, asked_, source_names_, xnode_names_;
  std::vector<std::pair<std::size_t, std::string>>
      unknown_rate_;          ///< source, and the type of its stimulus
  std::vector<int> task_of_;  ///< [xnode]
  std::set<std::pair<int, int>> edges_, samples_;
  bool chosen_samples_ = false;  ///< those of event chains
  std::size_t work_ = 0, unknown_times_ = 0;
};

}  // namespace

Result<ImportedApp> amalthea_app(const AmaltheaModel& model, const AmaltheaOptions& options,
                                 std::vector<std::string>& lines) {
  return AmaltheaImporter(model, options, lines).run();
}

Platform amalthea_platform(const AmaltheaModel& model, const std::string& name) {
  Platform platform;
  platform.name = name;
  std::map<std::string, int> count;
  for (const AmaltheaUnit& unit : model.units) {
    if (platform.xpus.size() >= kMaxXpus) break;
    Xpu xpu{unit.type + std::to_string(count[unit.type]++), unit.type};
    xpu.preempt_measured = false;
    platform.xpus.push_back(std::move(xpu));
  }
  return platform;
}

}  // namespace xauto::import
