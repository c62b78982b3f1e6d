// SPDX-License-Identifier: Apache-2.0
#include "import/ros2_app.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "base/index.h"
#include "base/quantile.h"
#include "model/components.h"
#include "model/periodic.h"
#include "model/reaction.h"

#include "import/arrivals.h"
#include "import/questions.h"

namespace xauto::import {
namespace {

using CallbackKind = RosCallback::Kind;

constexpr std::size_t kMostPaths = 1000;       ///< of an architecture
constexpr std::size_t kMostAskedPairs = 2000;  ///< XNodes whose pairs are looked at for questions
constexpr double kOnePerCall = 0.1;  ///< so many messages more or less are no other number
constexpr std::int64_t kLeastEvidence = 3;
/// What rclcpp itself subscribes to, and logging.
const std::set<std::string> kOfTheSystem = {"/parameter_events", "/rosout"};

std::int64_t median_of(std::vector<std::int64_t> values) {
  std::ranges::sort(values);
  return quantile_of_sorted(values, 0.5);
}

class Importer {
 public:
  Importer(const RosTrace& trace, const Architecture& architecture, const Ros2Options& options,
           std::vector<std::string>& lines)
      : trace_(trace), architecture_(architecture), options_(options), lines_(lines) {}

  Result<ImportedApp> run() {
    app().name = options_.name;
    out_.seen.from = options_.from;
    choose();
    if (app().xnodes.empty())
      return fail(ErrorCode::kInvalid, "no timer and no subscription ran in it", options_.from,
                  "record while the program does its work");
    find_triggers();
    drop_without_trigger();
    settle_periods(app());
    find_samples();
    complete_modules(app());
    find_executors();
    measure();
    find_chains();
    XAUTO_TRY(is_app(app(), "what was traced", options_.from));
    see_chains();
    ask();
    tell();
    return std::move(out_);
  }

 private:
  AppSpec& app() { return out_.app; }
  [[nodiscard]] const AppSpec& app() const { return out_.app; }
  [[nodiscard]] const RosCallback& callback(int xnode) const {
    return trace_.callbacks[at(callback_of_[at(xnode)])];
  }
  void todo(std::string at, const std::string& what) { import::todo(out_, std::move(at), what); }

  // ---- XNodes -------------------------------------------------------------------------------------

  /// A callback that ran is an XNode, in a module of its own: callbacks of a node have rates of their own.
  void choose() {
    std::vector<std::size_t> ran(trace_.callbacks.size(), 0);
    for (const RosCall& call : trace_.calls) ++ran[at(call.callback)];
    xnode_of_.assign(trace_.callbacks.size(), -1);
    std::set<std::string> names;
    for (std::size_t c = 0; c < trace_.callbacks.size(); ++c) {
      const RosCallback& one = trace_.callbacks[c];
      const bool wanted =
          one.kind == CallbackKind::kTimer || one.kind == CallbackKind::kSubscription;
      if (!wanted || kOfTheSystem.contains(one.topic)) {
        system_calls_ += ran[c];
        continue;
      }
      if (ran[c] == 0) {
        ++never_;
        continue;
      }
      if (app().xnodes.size() >= kMaxXNodes) continue;
      const std::string first = (one.node.empty() ? "node" : bare(one.node)) + "." +
                                (one.kind == CallbackKind::kTimer ? "timer" : bare(one.topic));
      std::string name = first;
      for (int n = 2; !names.insert(name).second; ++n) name = first + "-" + std::to_string(n);
      xnode_of_[c] = static_cast<int>(app().xnodes.size());
      callback_of_.push_back(static_cast<int>(c));
      app().xnodes.push_back({name, name, {{"cpu", 1}}});
    }
    calls_.resize(app().xnodes.size());
    for (std::size_t c = 0; c < trace_.calls.size(); ++c)
      if (const int x = xnode_of_[at(trace_.calls[c].callback)]; x >= 0) calls_[at(x)].push_back(c);
  }

  // ---- what fires whom ----------------------------------------------------------------------------

  [[nodiscard]] int writer_of(const RosCall& call) const {
    if (call.publication < 0) return -1;
    const std::int64_t by = trace_.publications[static_cast<std::size_t>(call.publication)].call;
    return by < 0 ? -1 : xnode_of_[at(trace_.calls[static_cast<std::size_t>(by)].callback)];
  }

  /// Whether x hears of v by edges.
  [[nodiscard]] bool behind(int x, int v) const {
    for (; x >= 0; x = trigger_[at(x)])
      if (x == v) return true;
    return false;
  }

  void find_triggers() {
    trigger_.assign(app().xnodes.size(), -1);
    source_.assign(app().xnodes.size(), -1);
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x) {
      if (callback(x).kind == CallbackKind::kTimer) continue;
      std::map<int, std::size_t> writers;
      for (const std::size_t c : calls_[at(x)]) ++writers[writer_of(trace_.calls[c])];
      const auto most =
          std::ranges::max_element(writers, {}, [](const auto& writer) { return writer.second; });
      if (most == writers.end() || most->first < 0) continue;
      const int writer = most->first;
      if (behind(writer, x)) {
        todo("", "'" + app().xnodes[at(x)].name + "' fires itself in a circle, by '" +
                     app().xnodes[at(writer)].name + "': here it comes at the rate that was seen");
        continue;
      }
      trigger_[at(x)] = writer;
      if (writers.size() > 1 && most->second < calls_[at(x)].size())
        todo("", "'" + app().xnodes[at(x)].name + "' is also fired by others than '" +
                     app().xnodes[at(writer)].name + "': only that one is an edge");
      else
        tell_other_number(writer, x);
    }
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x)
      if (trigger_[at(x)] < 0) find_source(x);
  }

  void tell_other_number(int writer, int x) {
    const auto of_writer = static_cast<double>(calls_[at(writer)].size());
    const auto of_reader = static_cast<double>(calls_[at(x)].size());
    if (of_reader < of_writer * (1 - 2 * kOnePerCall) - 2 ||
        of_reader > of_writer * (1 + kOnePerCall) + 1)
      todo("", "'" + app().xnodes[at(x)].name + "' ran " + std::to_string(calls_[at(x)].size()) +
                   " times, '" + app().xnodes[at(writer)].name + "', which fires it, " +
                   std::to_string(calls_[at(writer)].size()) + " times: an edge says each time");
  }

  void find_source(int x) {
    std::vector<std::int64_t> instants;
    for (const std::size_t c : calls_[at(x)]) instants.push_back(arrival_of(trace_.calls[c]));
    std::ranges::sort(instants);
    const bool timer = callback(x).kind == CallbackKind::kTimer;
    auto grid = timer ? timer_grid(instants, callback(x).made_ns, callback(x).period_ns)
                      : seen_grid(instants);
    if (!grid) return;
    const std::string name = timer ? app().xnodes[at(x)].name + "/tick" : bare(callback(x).topic);
    SourceSpec source{name, grid->period};
    if (!timer) {
      // Several callbacks may hear of one topic.
      const auto same = std::ranges::find(app().sources, name, &SourceSpec::name);
      if (same != app().sources.end()) {
        const auto s = static_cast<std::size_t>(same - app().sources.begin());
        source_[at(x)] = static_cast<int>(s);
        for (const std::int64_t instant : instants)
          release_of_[x].push_back(std::max<std::ptrdiff_t>(
              0, std::ranges::upper_bound(grids_[s], instant) - grids_[s].begin() - 1));
        return;
      }
      source.clock = static_cast<int>(app().clocks.size());
      app().clocks.push_back({name, kDefaultPpm});
    }
    release_of_[x] = grid->release;
    source_[at(x)] = static_cast<int>(app().sources.size());
    app().sources.push_back(std::move(source));
    grids_.push_back(std::move(grid->nominal_ns));
  }

  [[nodiscard]] std::int64_t arrival_of(const RosCall& call) const {
    if (call.publication >= 0)
      return trace_.publications[static_cast<std::size_t>(call.publication)].time_ns;
    const auto stamp = static_cast<std::int64_t>(call.stamp);
    return stamp > call.start_ns - 1'000'000'000 && stamp < call.start_ns ? stamp : call.start_ns;
  }

  /// What nothing fires that is known, and what that fires, is left out.
  void drop_without_trigger() {
    std::vector<int> now_at(app().xnodes.size(), -1);
    int kept = 0;
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x) {
      int root = x;
      while (trigger_[at(root)] >= 0) root = trigger_[at(root)];
      if (source_[at(root)] >= 0)
        now_at[at(x)] = kept++;
      else
        todo("", "'" + app().xnodes[at(x)].name + "' ran " + counted(calls_[at(x)].size(), "time") +
                     ": too few to see a rate; it is left out");
    }
    const auto compact = [&](auto& list) {
      std::size_t x = 0;
      std::erase_if(list, [&](const auto&) { return now_at[x++] < 0; });
    };
    std::map<int, std::vector<std::int64_t>> releases;
    for (auto& [x, list] : release_of_)
      if (now_at[at(x)] >= 0) releases[now_at[at(x)]] = std::move(list);
    release_of_ = std::move(releases);
    for (int& x : xnode_of_) x = x < 0 ? -1 : now_at[at(x)];
    for (int& x : trigger_) x = x < 0 ? -1 : now_at[at(x)];
    compact(app().xnodes);
    compact(callback_of_);
    compact(calls_);
    compact(trigger_);
    compact(source_);
    for (int x = 0; x < kept; ++x) {
      if (trigger_[at(x)] >= 0)
        app().edges.emplace_back(trigger_[at(x)], x);
      else
        app().xnodes[at(x)].sources = {source_[at(x)]};
    }
  }

  // ---- what is read without waiting ---------------------------------------------------------------

  [[nodiscard]] int root_of(int x) const {
    while (trigger_[at(x)] >= 0) x = trigger_[at(x)];
    return x;
  }

  void add_sample(int u, int v) {
    if (u == v || behind(v, u) || std::ranges::count(app().samples, std::pair(u, v)) > 0) return;
    if (source_[at(root_of(u))] == source_[at(root_of(v))] && !behind(u, v)) {
      todo("", "'" + app().xnodes[at(v)].name + "' uses what '" + app().xnodes[at(u)].name +
                   "' has left, of the same source: no sample says that, and an edge would make it "
                   "wait");
      return;
    }
    app().samples.emplace_back(u, v);
  }

  /// CARET's events have the stamps of headers: who publishes one that another callback of its node has received uses
  /// what that one has left.
  void samples_by_headers() {
    std::map<int, std::vector<int>> of_node;
    std::map<std::string, int> nodes;
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x) {
      if (callback(x).node.empty()) continue;
      const auto number = nodes.try_emplace(callback(x).node, static_cast<int>(nodes.size()));
      of_node[number.first->second].push_back(x);
    }
    std::map<std::pair<int, int>, std::int64_t> evidence;
    std::vector<std::map<std::uint64_t, std::int64_t>> received(app().xnodes.size());
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x)
      for (const std::size_t c : calls_[at(x)])
        if (const RosCall& call = trace_.calls[c]; call.header != 0)
          received[at(x)].try_emplace(call.header, call.end_ns);
    for (const RosPublication& p : trace_.publications) {
      if (p.call < 0 || p.header == 0) continue;
      const RosCall& call = trace_.calls[static_cast<std::size_t>(p.call)];
      const int v = xnode_of_[at(call.callback)];
      if (v < 0 || call.header == p.header || callback(v).node.empty()) continue;
      for (const int u : of_node[nodes.at(callback(v).node)])
        if (const auto got = received[at(u)].find(p.header);
            u != v && got != received[at(u)].end() && got->second <= p.time_ns)
          ++evidence[{u, v}];
    }
    for (const auto& [pair, count] : evidence)
      if (count >= kLeastEvidence) add_sample(pair.first, pair.second);
  }

  /// The XNode that architecture.yaml means by a callback's name; -1: none that ran.
  [[nodiscard]] int named(const std::string& name) const {
    const auto one = std::ranges::find(architecture_.callbacks, name, &ArchitectureCallback::name);
    if (one == architecture_.callbacks.end()) return -1;
    for (int pass = 0; pass < 2; ++pass)  // first by its symbol too
      for (int x = 0; x < static_cast<int>(callback_of_.size()); ++x) {
        const RosCallback& c = callback(x);
        if (c.node == one->node && c.topic == one->topic &&
            (c.kind == CallbackKind::kTimer) == one->topic.empty() &&
            (pass == 1 || c.symbol == one->symbol) &&
            (!one->topic.empty() || c.period_ns == one->period_ns))
          return x;
      }
    return -1;
  }

  [[nodiscard]] int subscriber(const std::string& node, const std::string& topic) const {
    for (int x = 0; x < static_cast<int>(callback_of_.size()); ++x)
      if (callback(x).node == node && !topic.empty() && callback(x).topic == topic) return x;
    return -1;
  }

  /// Who of a node publishes on a topic.
  [[nodiscard]] int publisher(const std::string& node, const std::string& topic) const {
    for (const RosPublication& p : trace_.publications)
      if (p.topic == topic && p.call >= 0)
        if (const int x = xnode_of_[at(trace_.calls[static_cast<std::size_t>(p.call)].callback)];
            x >= 0 && callback(x).node == node)
          return x;
    return -1;
  }

  void find_samples() {
    samples_by_headers();
    for (const auto& [from, to] : architecture_.passings)
      if (const int u = named(from), v = named(to); u >= 0 && v >= 0) add_sample(u, v);
    for (const ArchitecturePath& path : architecture_.paths)
      for (const ArchitecturePath::Step& step : path.steps)
        if (const int u = subscriber(step.node, step.from_topic),
            v = publisher(step.node, step.to_topic);
            u >= 0 && v >= 0)
          add_sample(u, v);
  }

  // ---- executors ----------------------------------------------------------------------------------

  static std::optional<ExecutorKind> kind_of(const std::string& type) {
    const auto says = [&](const char* word) { return type.find(word) != std::string::npos; };
    if (says("multi_threaded")) return ExecutorKind::kMultiThreaded;
    if (says("static_single")) return ExecutorKind::kStaticSingleThreaded;
    if (says("events")) return ExecutorKind::kEvents;
    if (says("single_threaded")) return ExecutorKind::kSingleThreaded;
    return std::nullopt;
  }

  /// Those that the trace tells, then one for each thread or process of the rest.
  void find_executors() {
    std::map<std::int64_t, std::vector<int>> untold;      // [process]
    std::map<int, std::map<int, std::vector<int>>> told;  // [executor][group]
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x) {
      const int group = callback(x).group;
      const int executor = group < 0 ? -1 : trace_.groups[at(group)].executor;
      if (executor < 0 || !kind_of(trace_.executors[at(executor)].type))
        untold[callback(x).process].push_back(x);
      else
        told[executor][group].push_back(x);
    }
    for (const auto& [number, groups] : told) {
      SeenExecutor executor{"executor-" + std::to_string(out_.seen.executors.size()),
                            *kind_of(trace_.executors[at(number)].type),
                            1,
                            {}};
      std::set<std::int64_t> threads;
      for (const auto& [group, xnodes] : groups) {
        for (const int x : xnodes)
          for (const std::size_t c : calls_[at(x)]) threads.insert(trace_.calls[c].thread);
        executor.groups.push_back({trace_.groups[at(group)].reentrant, xnodes});
      }
      if (executor.kind == ExecutorKind::kMultiThreaded)
        executor.threads = std::clamp(static_cast<int>(threads.size()), 1, kMaxSeenThreads);
      out_.seen.executors.push_back(std::move(executor));
    }
    for (const auto& [process, xnodes] : untold) guess_executors(xnodes);
    for (const SeenExecutor& executor : out_.seen.executors)
      for (const SeenGroup& group : executor.groups)
        if (!group.reentrant && group.xnodes.size() > 1) {
          std::vector<std::string>& names = out_.groups.emplace_back();
          for (const int x : group.xnodes) names.push_back(app().xnodes[at(x)].name);
        }
  }

  /// Of a process whose executors the trace does not tell: one for each thread, if no callback ever changed its
  /// thread; else one of all. A node is a group, unless callbacks of it overlapped.
  void guess_executors(const std::vector<int>& xnodes) {
    std::map<int, std::set<std::int64_t>> threads;  // [xnode]
    std::set<std::int64_t> all;
    bool moved = false;
    for (const int x : xnodes) {
      for (const std::size_t c : calls_[at(x)]) threads[x].insert(trace_.calls[c].thread);
      moved = moved || threads[x].size() > 1;
      all.insert(threads[x].begin(), threads[x].end());
    }
    std::map<std::int64_t, std::vector<int>> parts;
    for (const int x : xnodes) parts[moved ? 0 : *threads[x].begin()].push_back(x);
    for (const auto& [thread, part] : parts) {
      const std::size_t number = out_.seen.executors.size();
      SeenExecutor executor{
          "executor-" + std::to_string(number), ExecutorKind::kSingleThreaded, 1, {}};
      if (moved) {
        executor.kind = ExecutorKind::kMultiThreaded;
        executor.threads = std::clamp(static_cast<int>(all.size()), 1, kMaxSeenThreads);
      }
      std::map<std::string, std::vector<int>> nodes;
      for (const int x : part) nodes[callback(x).node].push_back(x);
      for (const auto& [node, of_node] : nodes)
        executor.groups.push_back({overlapped(of_node), of_node});
      out_.seen.executors.push_back(std::move(executor));
      todo("/seen/executors/" + std::to_string(number) + "/type",
           "which executor runs these callbacks? by their threads it is " +
               std::string(name_of(out_.seen.executors.back().kind)));
    }
  }

  [[nodiscard]] bool overlapped(const std::vector<int>& xnodes) const {
    std::vector<std::size_t> calls;
    for (const int x : xnodes)
      calls.insert(calls.end(), calls_[at(x)].begin(), calls_[at(x)].end());
    std::ranges::sort(calls);
    std::int64_t until = 0;
    for (const std::size_t c : calls) {
      if (trace_.calls[c].start_ns < until) return true;
      until = std::max(until, trace_.calls[c].end_ns);
    }
    return false;
  }

  // ---- times --------------------------------------------------------------------------------------

  /// [call] what it waits for besides its message, as a number: its executor if that has one thread, else its group.
  [[nodiscard]] std::vector<int> units() const {
    std::vector<int> unit(app().xnodes.size(), -1);
    int next = 0;
    for (const SeenExecutor& executor : out_.seen.executors) {
      const int of_executor = next++;
      for (const SeenGroup& group : executor.groups) {
        const int of_group = next++;
        for (const int x : group.xnodes)
          unit[at(x)] = executor.kind != ExecutorKind::kMultiThreaded ? of_executor
                        : group.reentrant                             ? -1
                                                                      : of_group;
      }
    }
    return unit;
  }

  void measure() {
    std::vector<std::vector<std::int64_t>> delays(app().xnodes.size()), leads(app().xnodes.size());
    const std::vector<int> unit = units();
    std::map<int, std::int64_t> busy_until;
    std::vector<std::size_t> nth(app().xnodes.size(), 0);
    for (const RosCall& call : trace_.calls) {
      const int x = xnode_of_[at(call.callback)];
      if (x < 0) continue;
      const std::int64_t ready = ready_of(x, nth[at(x)]++, call);
      std::int64_t& until = busy_until[unit[at(x)]];
      if (unit[at(x)] < 0 || until <= ready)
        delays[at(x)].push_back(std::max<std::int64_t>(0, call.start_ns - ready));
      until = std::max(until, call.end_ns);
    }
    std::int64_t last = -1;
    for (const RosPublication& p : trace_.publications)
      if (p.call >= 0 && std::exchange(last, p.call) != p.call) {
        const RosCall& call = trace_.calls[static_cast<std::size_t>(p.call)];
        if (const int x = xnode_of_[at(call.callback)]; x >= 0)
          leads[at(x)].push_back(std::max<std::int64_t>(0, call.end_ns - p.time_ns));
      }
    out_.seen.xnodes.resize(app().xnodes.size());
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x)
      put_times(x, delays[at(x)], leads[at(x)]);
    out_.seen.duration_us = std::max<std::int64_t>(1, up_to_us(trace_.end_ns - trace_.begin_ns));
    out_.seen.cores = std::clamp(trace_.cpus, 1, kMaxSeenThreads);
    place_sources();
  }

  /// When call `n` of the XNode could have begun.
  [[nodiscard]] std::int64_t ready_of(int x, std::size_t n, const RosCall& call) const {
    if (callback(x).kind != CallbackKind::kTimer) return arrival_of(call);
    return grids_[at(source_[at(x)])][static_cast<std::size_t>(release_of_.at(x)[n])];
  }

  void put_times(int x, const std::vector<std::int64_t>& delays,
                 const std::vector<std::int64_t>& leads) {
    std::vector<std::int64_t> times;
    for (const std::size_t c : calls_[at(x)])
      times.push_back(
          std::max<std::int64_t>(1, up_to_us(trace_.calls[c].end_ns - trace_.calls[c].start_ns)));
    XNodeSpec& xnode = app().xnodes[at(x)];
    const std::int64_t longest = *std::ranges::max_element(times);
    xnode.wcet_us["cpu"] = with_margin(longest, options_.margin_pct);
    xnode.typical_us["cpu"] = median_of(times);
    SeenXNode& seen = out_.seen.xnodes[at(x)];
    seen.times_us.assign(times.begin(), times.begin() + static_cast<std::ptrdiff_t>(
                                                            std::min(times.size(), kMaxSeenTimes)));
    seen.delay_us = median_of(delays) / 1000;
    seen.lead_us = std::min(median_of(leads) / 1000, seen.times_us.empty() ? 0 : longest);
    seen.depth = std::clamp<std::int64_t>(callback(x).depth, 1, kMaxInFlight);
    longest_delay_.push_back(delays.empty() ? 0 : up_to_us(*std::ranges::max_element(delays)));
  }

  /// Offsets, from the first timer on, and jitters: of a timer how late it was called where nothing was in its way.
  void place_sources() {
    std::int64_t origin = 0;
    for (std::size_t s = 0; s < grids_.size(); ++s)
      if (app().sources[s].clock == 0 && (origin == 0 || grids_[s].front() < origin))
        origin = grids_[s].front();
    for (int x = 0; x < static_cast<int>(app().xnodes.size()); ++x) {
      const int s = source_[at(x)];
      if (trigger_[at(x)] >= 0 || s < 0) continue;
      SourceSpec& source = app().sources[at(s)];
      if (source.clock == 0) {
        source.offset_us = (grids_[at(s)].front() - origin) / 1000 % source.period.floor_us();
        source.jitter_us = std::min(longest_delay_[at(x)], source.period.floor_us());
        continue;
      }
      std::int64_t latest = 0;
      for (std::size_t n = 0; n < calls_[at(x)].size(); ++n) {
        const auto k = static_cast<std::size_t>(release_of_.at(x)[n]);
        if (k < grids_[at(s)].size())
          latest = std::max(latest, arrival_of(trace_.calls[calls_[at(x)][n]]) - grids_[at(s)][k]);
      }
      source.jitter_us = std::min(up_to_us(latest), kMaxPeriodUs);
    }
  }

  // ---- chains -------------------------------------------------------------------------------------

  void find_chains() {
    if (architecture_.paths.size() > kMostPaths)
      todo("", "the architecture names more than " + std::to_string(kMostPaths) +
                   " paths: only the first are chains");
    for (std::size_t p = 0; p < std::min(architecture_.paths.size(), kMostPaths); ++p) {
      const ArchitecturePath& path = architecture_.paths[p];
      if (path.steps.empty()) continue;
      const auto &first = path.steps.front(), &last = path.steps.back();
      int from = subscriber(first.node, first.from_topic);
      if (from < 0) from = publisher(first.node, first.to_topic);
      int to = publisher(last.node, last.to_topic);
      if (to < 0) to = subscriber(last.node, last.from_topic);
      std::string name = bare(path.name);
      if (from < 0 || to < 0 || name.empty()) {
        todo("", "path '" + name + "' of the architecture has an end that did not run");
        continue;
      }
      app().chains.push_back({name, source_[at(root_of(from))], to, std::nullopt, 1});
      if (const Status valid = validate(app()); !valid) {
        app().chains.pop_back();
        todo("", "path '" + name + "' is no chain here: " + valid.error().what);
      }
    }
    complete_chains(app());
  }

  void see_chains() {
    std::vector<RanJob> jobs;
    std::vector<std::int64_t> job_of(trace_.calls.size(), -1);
    std::vector<std::size_t> nth(app().xnodes.size(), 0);
    for (std::size_t c = 0; c < trace_.calls.size(); ++c) {
      const RosCall& call = trace_.calls[c];
      const int x = xnode_of_[at(call.callback)];
      if (x < 0) continue;
      RanJob job{x, call.start_ns, call.end_ns};
      if (trigger_[at(x)] < 0) {
        job.source = source_[at(x)];
        job.release = release_of_.at(x)[nth[at(x)]++];
      } else if (call.publication >= 0) {
        const auto by = trace_.publications[static_cast<std::size_t>(call.publication)].call;
        job.from = by < 0 ? -1 : job_of[static_cast<std::size_t>(by)];
      }
      job_of[c] = static_cast<std::int64_t>(jobs.size());
      jobs.push_back(job);
    }
    auto times = reaction_times(app(), jobs, grids_);
    for (std::size_t k = 0; k < times.size(); ++k) {
      if (times[k].empty()) continue;
      for (std::int64_t& ns : times[k]) ns = std::max<std::int64_t>(0, ns);  // a damaged trace
      std::ranges::sort(times[k]);
      out_.seen.chains.push_back({static_cast<int>(k), static_cast<std::int64_t>(times[k].size()),
                                  up_to_us(quantile_of_sorted(times[k], 0.5)),
                                  up_to_us(quantile_of_sorted(times[k], 0.99)),
                                  up_to_us(times[k].back())});
    }
  }

  // ---- what is not known --------------------------------------------------------------------------

  void ask() {
    std::size_t fewest = calls_.front().size();
    for (const auto& calls : calls_) fewest = std::min(fewest, calls.size());
    todo("", "WCETs are the longest times that were seen, of " + counted(fewest, "activation") +
                 " or more" +
                 (options_.margin_pct > 0 ? ", and " + std::to_string(options_.margin_pct) + " %"
                                          : "") +
                 ": longer ones may come (--margin-pct)");
    ask_deadlines(out_);
    ask_jitters(out_);
    ask_for_samples();
    std::vector<double> load;
    for (std::size_t x = 0; x < app().xnodes.size(); ++x)
      load.push_back(static_cast<double>(app().xnodes[x].typical_us.at("cpu")) *
                     static_cast<double>(calls_[x].size()));
    ask_other_xpus(out_, load);
  }

  /// Of a node in which one callback publishes, and another one does not: whether the first uses what the second left.
  void ask_for_samples() {
    if (app().xnodes.size() > kMostAskedPairs) return;
    std::set<int> publish;
    for (const RosPublication& p : trace_.publications)
      if (p.call >= 0)
        publish.insert(xnode_of_[at(trace_.calls[static_cast<std::size_t>(p.call)].callback)]);
    for (int v = 0; v < static_cast<int>(app().xnodes.size()); ++v)
      for (int u = 0; u < static_cast<int>(app().xnodes.size()); ++u)
        if (u != v && callback(u).node == callback(v).node && !callback(u).node.empty() &&
            publish.contains(v) && !publish.contains(u) &&
            callback(u).kind == CallbackKind::kSubscription &&
            std::ranges::none_of(app().samples, [&](const auto& s) { return s.first == u; }) &&
            source_[at(root_of(u))] != source_[at(root_of(v))])
          todo("/samples/-", "does '" + app().xnodes[at(v)].name + "' use what '" +
                                 app().xnodes[at(u)].name +
                                 R"(' has left? ["the second", "the first"])");
  }

  void tell() {
    lines_.push_back(
        counted(app().xnodes.size(), "XNode") + " of " + counted(trace_.calls.size(), "callback") +
        " that ran, " + counted(app().sources.size(), "source") + ", " +
        counted(app().edges.size(), "edge") + ", " + counted(app().samples.size(), "sample") +
        ", " + counted(app().chains.size(), "chain"));
    if (system_calls_ > 0)
      lines_.push_back("left out: " + std::to_string(system_calls_) +
                       " calls of services, parameter events and logging");
    if (never_ > 0)
      lines_.push_back("left out: " + counted(never_, "callback") + " that never ran");
    for (const std::string& note : trace_.notes) lines_.push_back(note);
  }

  const RosTrace& trace_;
  const Architecture& architecture_;
  const Ros2Options& options_;
  std::vector<std::string>& lines_;
  ImportedApp out_;
  std::vector<int> xnode_of_;                            ///< [callback] or -1
  std::vector<int> callback_of_;                         ///< [xnode]
  std::vector<std::vector<std::size_t>> calls_;          ///< [xnode] in the order of their starts
  std::vector<int> trigger_;                             ///< [xnode] whose message fires it, or -1
  std::vector<int> source_;                              ///< [xnode] what releases it, or -1
  std::vector<std::vector<std::int64_t>> grids_;         ///< [source] nominal releases in ns
  std::map<int, std::vector<std::int64_t>> release_of_;  ///< [xnode][its call]
  std::vector<std::int64_t> longest_delay_;              ///< [xnode] us
  std::size_t system_calls_ = 0, never_ = 0;
};

}  // namespace

Result<ImportedApp> ros2_app(const RosTrace& trace, const Architecture& architecture,
                             const Ros2Options& options, std::vector<std::string>& lines) {
  return Importer(trace, architecture, options, lines).run();
}

}  // namespace xauto::import
