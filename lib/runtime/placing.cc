// SPDX-License-Identifier: Apache-2.0
#include "runtime/placing.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <string_view>

#include <fmt/format.h>

#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "model/claims.h"
#include "model/contention.h"
#include "session/claimed_wcets.h"
#include "session/notes.h"
#include "xpu/kind.h"
#include "xpu/presence.h"

namespace xauto::runtime {
namespace {

/// The XPU instance of `node`: the table's, or with ROS 2 scheduling the first of its fastest
/// type.
int xpu_of(const Session& session, std::size_t table, const Graph::Node& node,
           std::uint32_t xnode) {
  if (session.scheduling != Scheduling::kRos2) return session.of_table(table).placements[xnode].xpu;
  const XNodeSpec& spec = session.app.xnodes[xnode];
  int best = -1;
  std::int64_t best_us = 0;
  for (std::size_t i = 0; i < session.platform.xpus.size(); ++i) {
    const std::string& type = session.platform.xpus[i].type;
    const auto wcet = spec.wcet_on(type);
    if (wcet && find_impl(*node.spec, type) != nullptr && (best < 0 || *wcet < best_us)) {
      best = static_cast<int>(i);
      best_us = *wcet;
    }
  }
  return best;
}

/// Of the workers; what falls short of what a run would like is noted.
FifoRange choose_priorities(const Session& session, FifoRange& fifo, std::string& note) {
  const int highest = rt::highest_fifo();
  fifo = FifoRange::within(highest);
  // With sched_ext too: what is no XNode runs above it, and it may go at any time.
  const bool real_cpus_wanted = session.cpu.sched != CpuSched::kOther;
  if (!session.emulates() && !real_cpus_wanted) return FifoRange::within(0);
  if (fifo.none()) {
    note = "no permission for SCHED_FIFO: threads run as SCHED_OTHER; " + rt::fifo_hint();
    log::warn("{}", note);
    return fifo;
  }
  std::vector<int> cpus;  // real ones
  for (const int x : session.platform.instances_of("cpu"))
    if (session.presence_of(x) == Presence::kReal) cpus.push_back(x);
  if (session.scheduling == Scheduling::kXAuto && real_cpus_wanted && !cpus.empty()) {
    if (const std::string pressed = fifo.note(highest, session.policy, cpus); !pressed.empty()) {
      add_note(note, pressed);
      if (session.parts.process == 0) log::warn("{}", pressed);
    }
  }
  FifoRange plan = fifo;
  if (!real_cpus_wanted) plan.cpu_lowest = plan.cpu_highest = 0;
  return plan;
}

/// Below every XNode, and above what has no priority. sched_ext has its XNodes above all ordinary threads and below
/// SCHED_FIFO, so there it is the most of the ordinary ones.
std::function<void()> choose_carriers(const Session& session, const FifoRange& fifo,
                                      std::string& note) {
  if (!session.host.there()) return nullptr;
  const bool ext = session.cpu.sched == CpuSched::kExt;
  const std::function<Status()> enter = [ext, priority = fifo.carriers] {
    return ext ? rt::set_nice(-20) : rt::set_fifo(priority);
  };
  const std::vector<int> cpus = session.platform.instances_of("cpu");
  const bool unordered =
      session.cpu.sched == CpuSched::kOther &&
      std::ranges::any_of(cpus, [&](int x) { return session.presence_of(x) == Presence::kReal; });
  Status may = fail(ErrorCode::kPermission, "there is no priority below the XNodes'", {},
                    unordered ? "run without --cpu-sched other" : rt::fifo_hint());
  if (ext || (!unordered && fifo.carriers > 0))
    if (auto tries = start_thread([&] { may = enter(); })) tries->join();
  if (may) return [enter] { (void)enter(); };
  const std::string line =
      "what crosses to other hosts has no priority, so this host's load counts "
      "in X: " +
      may.error().what + ": " + may.error().hint;
  add_note(note, line);
  log::warn("{}", line);
  return nullptr;
}

/// Whether the policy's pairs of XNodes are kept, on all XPUs.
bool keeps_order(const Session& session, const Graph& graph, Placing& placing) {
  if (graph.single_rate) return true;
  if (session.policy.order.empty()) return false;
  // Of keys a pair is of what is released together. Where activations are numbered by releases that the grid knows, those
  // of one number belong together.
  std::map<std::string_view, const Graph::Module*> module_by_name;
  for (const Graph::Node& node : graph.nodes)
    module_by_name[node.name] = &graph.modules[static_cast<std::size_t>(node.module)];
  const auto module_of = [&](int xnode) -> const Graph::Module& {  // the graph matches the app
    return *module_by_name.at(session.app.xnodes[static_cast<std::size_t>(xnode)].name);
  };
  std::set<int> pushed;  // components
  for (const Graph::Module& module : graph.modules)
    for (const int t : module.inputs)
      if (const int s = graph.topics[static_cast<std::size_t>(t)].source;
          s >= 0 && graph.sources[static_cast<std::size_t>(s)].pushed)
        pushed.insert(module.component);
  const auto together = [&](const std::pair<int, int>& pair) {
    const Graph::Module &u = module_of(pair.first), &v = module_of(pair.second);
    return u.numbered && v.numbered &&
           (u.component == v.component ||
            (!pushed.contains(u.component) && !pushed.contains(v.component)));
  };
  if (session.keys &&
      std::all_of(session.policy.order.begin(), session.policy.order.end(), together))
    return true;
  // A pair would have to say which release of u comes before which of v.
  const std::string unordered =
      "sources that have several periods, or are pushed, meet: the policy's order constraints are "
      "not enforced";
  add_note(placing.note, unordered);
  placing.unkept.push_back("its order constraints are not enforced");
  return false;
}

/// The app with the longest WCETs that any scenario allows.
AppSpec longest(const Session& session) {
  AppSpec app = session.app;
  if (!session.tables) return app;
  for (const Scenario& scenario : session.tables->scenarios) {
    const AppSpec under = app_under(session.app, scenario);
    const auto raise = [](auto& wcets, const auto& to) {
      for (auto& [type, us] : wcets) us = std::max(us, to.find(type)->second);
    };
    for (std::size_t x = 0; x < app.xnodes.size(); ++x) {
      raise(app.xnodes[x].wcet_us, under.xnodes[x].wcet_us);
      for (std::size_t v = 0; v < app.xnodes[x].variants.size(); ++v)
        raise(app.xnodes[x].variants[v].wcet_us, under.xnodes[x].variants[v].wcet_us);
    }
  }
  return app;
}

/// What a policy of keys takes for granted and this run does not keep by the way it was set up.
std::vector<std::string> unkept_of_keys(const Session& session) {
  std::vector<std::string> lines;
  if (session.releases.lockstep && !session.app.one_at_a_time)
    lines.emplace_back("each release waits for the one before (--lockstep)");
  if (!session.releases.input.empty() && !session.app.one_at_a_time)
    lines.emplace_back("a recording is released as it was recorded, not as app.json says");
  for (const ModuleSpec& module : session.app.modules)
    if (const auto said = session.deployment.of(module.name).overload;
        said && said->kind != Overload::Kind::kQueue)
      lines.push_back("XModule '" + module.name + "' drops what it has no time for (" +
                      said->to_string() + ")");
  return lines;
}

bool real_and_used(const Session& session, std::size_t x) {
  if (session.presence_of(static_cast<int>(x)) != Presence::kReal) return false;
  for (std::size_t t = 0; t < session.num_tables(); ++t)
    for (const PriorityPlacement& p : session.of_table(t).placements)
      if (p.xpu == static_cast<int>(x)) return true;
  return false;
}

/// Who schedules work on XPUs, where that says less than a plan would like.
void note_caveats(const Session& session, std::string& note) {
  for (std::size_t x = 0; x < session.platform.xpus.size(); ++x) {
    const Xpu& xpu = session.platform.xpus[x];
    if (!real_and_used(session, x)) continue;
    if (const std::string caveat = xpu::caveat_of(xpu, false); !caveat.empty())
      add_note(note, "work on " + xpu.id + " is " + caveat);
  }
}

/// Processes of the run that have XNodes on it.
std::size_t processes_on(const Session& session, std::size_t x) {
  std::set<std::size_t> processes;
  for (std::size_t t = 0; t < session.num_tables(); ++t) {
    const std::vector<PriorityPlacement>& placements = session.of_table(t).placements;
    for (std::size_t i = 0; i < placements.size(); ++i) {
      if (placements[i].xpu != static_cast<int>(x)) continue;
      const auto& all = session.parts.modules;
      const auto has = [&](const std::vector<std::string>& one) {
        return std::ranges::find(one, session.app.xnodes[i].module) != one.end();
      };
      processes.insert(static_cast<std::size_t>(std::ranges::find_if(all, has) - all.begin()));
    }
  }
  return processes.size();
}

/// What both kinds of policies plan with, and the machine does not do.
std::vector<std::string> unkept_by_xpus(const Session& session) {
  std::vector<std::string> lines;
  for (std::size_t x = 0; x < session.platform.xpus.size(); ++x) {
    const Xpu& xpu = session.platform.xpus[x];
    if (!real_and_used(session, x)) continue;
    const Discipline discipline = xpu::discipline_of(xpu, false, session.cpu.by_keys);
    if (xpu.preemptive && discipline == Discipline::kGate)
      lines.push_back("nobody can suspend work on " + xpu.id + ": its jobs run to their end");
    if (const std::size_t processes = processes_on(session, x);
        processes > 1 && xpu::orders_one_process(xpu, false))
      lines.push_back(fmt::format(
          "work on {} is ordered within one process, and {} have some: run its modules in one, "
          "or plan without \"levels\"",
          xpu.id, processes));
    if (discipline == Discipline::kLevels)
      if (const int there = xpu::levels_of(xpu, false); xpu.levels == 0 || there < xpu.levels)
        lines.push_back(fmt::format(
            "{} preempts by {} priority levels, and the plan counts on {}: a more urgent job may "
            "wait "
            "for the job that runs",
            xpu.id, there, xpu.levels == 0 ? "any number" : std::to_string(xpu.levels)));
    if (session.keys && discipline == Discipline::kKernel && session.cpu.sched != CpuSched::kExt)
      lines.push_back("nobody keeps keys on " + xpu.id +
                      ": without SCHED_FIFO Linux orders its threads as it likes");
  }
  return lines;
}

/// By jobs within one WCET each.
bool claims_worst_case(const Session& session) {
  if (session.scheduling != Scheduling::kXAuto || session.tables) return false;
  return session.keys && session.keys->certified;
}

}  // namespace

Placing Placing::of(const Session& session, const Graph& graph) {
  Placing placing;
  placing.workers = choose_priorities(session, placing.fifo, placing.note);
  placing.carriers = choose_carriers(session, placing.fifo, placing.note);
  if (session.scheduling == Scheduling::kXAuto) {
    for (std::size_t t = 0; t < session.num_tables(); ++t)
      placing.fifo_by_xnode.push_back(placing.workers.by_rank(session.of_table(t)));
    placing.ordered = keeps_order(session, graph, placing);
    note_caveats(session, placing.note);
  }
  placing.cores = rt::allowed_cores();
  for (const Graph::Node& node : graph.nodes)
    placing.xnode.push_back(static_cast<std::uint32_t>(session.app.find(node.name)));
  const AppSpec app = longest(session);
  std::optional<ClaimedWcets> claimed;
  if (session.tables) claimed.emplace(session);
  for (std::size_t t = 0; t < session.num_tables(); ++t) {
    placing.xpu.emplace_back();
    placing.limits.emplace_back();
    for (std::size_t n = 0; n < graph.nodes.size(); ++n) {
      const int at = xpu_of(session, t, graph.nodes[n], placing.xnode[n]);
      placing.xpu.back().push_back(at);
      placing.limits.back().push_back(placing.limits_of(session, app, graph, t, n, at));
      if (!claimed || at < 0) continue;
      placing.limits.back().back().wcet_ns = claimed->least(t, placing.xnode[n]);
      // Whoever is nearer to what a scenario allows than the margin keeps the run from going back to it.
      placing.limits.back().back().tell_ns =
          claimed->shortest(t, placing.xnode[n]) *
          (100 - session.deployment.tables.margin_pct.value_or(0)) / 100;
    }
  }
  return placing;
}

Limits Placing::limits_of(const Session& session, const AppSpec& app, const Graph& graph,
                          std::size_t table, std::size_t node, int at) const {
  if (at < 0) return {};
  const std::string& name = graph.nodes[node].name;
  const std::string& type = session.platform.xpus[static_cast<std::size_t>(at)].type;
  const auto module = static_cast<std::size_t>(graph.nodes[node].module);
  const int variant = session.variant_of(table, xnode[node]);
  const std::int64_t wcet_us =
      session.scheduling == Scheduling::kXAuto && session.keys && !session.tables
          ? counted_wcet_us(session.app, session.platform, *session.keys, xnode[node])
          : wcet_of(app.xnodes[xnode[node]], variant, type).value_or(0);
  Limits of_job = Limits::of(session.deployment, graph.modules[module].name, name, wcet_us);
  if (claims_worst_case(session)) of_job.wcet_ns = watched_ns(wcet_us, session.emulated(at));
  return of_job;
}

void Placing::compare_with_certificate(const Session& session) {
  if (session.scheduling != Scheduling::kXAuto) return;
  if (session.keys && !session.keys->certified) {
    log::warn("nothing is claimed of this run: its policy is not certified");
    return;
  }
  if (session.keys) {
    for (std::string& line : unkept_of_keys(session)) unkept.push_back(std::move(line));
    for (std::string& line : unkept_by_xpus(session)) unkept.push_back(std::move(line));
    for (const std::string& why : unkept)
      log::warn("the policy's worst cases do not hold in this run: {}", why);
    return;
  }
  if (!session.tables) return;
  const bool kept =
      session.cpu.sched == CpuSched::kExt || (session.cpu.sched == CpuSched::kFifo && !fifo.none());
  const std::vector<int> cpus = session.platform.instances_of("cpu");
  const bool real_cpus = std::any_of(
      cpus.begin(), cpus.end(), [&](int x) { return session.presence_of(x) == Presence::kReal; });
  if (real_cpus && !kept) unkept.emplace_back("nobody keeps the priorities on CPUs (SCHED_OTHER)");
  for (std::string& line : unkept_by_xpus(session)) unkept.push_back(std::move(line));
  for (const std::string& why : unkept)
    log::warn("the tables' worst cases do not hold in this run: {}", why);
}

Result<WorkerOptions> Placing::worker(const Context& context, std::size_t module, int index,
                                      int at) const {
  const Session& session = context.session;
  const Platform& platform = session.platform;
  const Xpu& x = platform.xpus[static_cast<std::size_t>(at)];
  const bool scheduled = context.scheduled();
  const bool emulated = session.emulated(at);
  const bool real_cpu = !emulated && x.type == "cpu";
  WorkerOptions options{.backend = {x, xpu_id(platform, at), emulated, session.emulator_modules,
                                    scheduled, session.cpu.by_keys && !session.cpu.regulated}};
  options.xpu = at;
  options.preempt_ns = x.preempt_us * 1000;
  options.name = context.graph.modules[module].name +
                 (index > 0 ? fmt::format("#{}", index + 1) : "") + "@" + x.id;
  options.mgmt_fifo = workers.management;
  options.exec_fifo = !real_cpu               ? workers.execution
                      : session.cpu.regulated ? 0
                      : session.cpu.by_keys   ? kCpuAsks
                      : scheduled             ? workers.cpu_lowest
                                              : 0;
  const xpu::Hardware machine = xpu::Hardware::here();
  if (session.presence_of(at) == Presence::kAbsent ||
      (!emulated && !machine.has(platform, static_cast<std::size_t>(at)) && x.type == "cpu"))
    return fail(ErrorCode::kInvalid, "has XNodes in this run, and is not here: " + machine.lacks(x),
                x.id, "use a platform file of this machine: xauto doctor --platform-out here.json");
  if (real_cpu && !session.cpu.regulated &&
      (scheduled || session.scheduling == Scheduling::kTimeshare)) {
    options.core = cores[static_cast<std::size_t>(options.backend.id.index)];
  }
  if (scheduled) {
    const auto coordinator = session.coordinators.find(x.id);
    if (coordinator == session.coordinators.end())
      return fail(ErrorCode::kInternal, "session names no coordinator", x.id);
    options.coordinator = coordinator->second;
    if (ordered) options.order = session.order_on(at);
  }
  return options;
}

}  // namespace xauto::runtime
