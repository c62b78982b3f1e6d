// SPDX-License-Identifier: Apache-2.0
// Building a run, and its course. Releases, accounts, other processes and hangs are in files of
// their own beside this one.
#include "runtime/engine.h"

#include <algorithm>

#include <fcntl.h>
#include <fmt/format.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "model/claims.h"
#include "runtime/notes.h"
#include "runtime/supervisor.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kPatienceNs = 1'000'000'000;  ///< with an exec, once the run is over

/// Of a job in the trace: about 8, more when it is preempted.
constexpr double kEventsPerJob = 24;
constexpr std::uint64_t kMinTraceEvents = 1u << 12, kMaxTraceEvents = 1u << 22;  ///< 32 bytes each

}  // namespace

Engine::Engine(const detail::AppSpecErased& app, const Session& session, Graph graph)
    : app_(app), session_(session), graph_(std::move(graph)) {}

Engine::~Engine() {
  hub_.reset();
  if (receiver_) receiver_->stop();
  for (const auto& worker : workers_) worker->stop();
}

Result<std::unique_ptr<Engine>> Engine::create(const detail::AppSpecErased& app,
                                               const Session& session) {
  XAUTO_ASSIGN(Graph graph, Graph::build(app));
  XAUTO_TRY(graph.matches(session.app));
  auto engine = std::unique_ptr<Engine>(new Engine(app, session, std::move(graph)));
  Engine& e = *engine;
  XAUTO_ASSIGN(e.plan_, Plan::make(e.graph_, app, session));
  XAUTO_ASSIGN(e.routes_, Routes::make(e.graph_, session.deployment, session.app.deadline_us));
  if (session.trace_fd >= 0 && session.process == 0) {  // before any member may attach to it
    XAUTO_ASSIGN(e.trace_, trace::Writer::create(session.trace_fd, e.trace_capacity()));
  }
  const std::size_t flows = 1 + e.routes_->size();
  if (e.plan_.processes == 1) {
    const BoardShape shape{1, static_cast<std::uint32_t>(e.graph_.modules.size()),
                           static_cast<std::uint32_t>(e.graph_.nodes.size()),
                           static_cast<std::uint32_t>(flows)};
    if (session.board_fd >= 0) {
      UniqueFd fd(fcntl(session.board_fd, F_DUPFD_CLOEXEC, 3));
      XAUTO_ASSIGN(e.board_, Board::create(shape, fd));
    } else {
      e.board_ = Board::local(shape);
    }
  } else if (session.process == 0) {
    XAUTO_ASSIGN(e.hub_, Hub::create(e.plan_, e.graph_, session, flows, e));
    e.board_ = e.hub_->board();
  } else {
    XAUTO_ASSIGN(e.member_, Member::join(e.plan_, e.graph_, session, flows));
    e.board_ = e.member_->board();
    if (session.trace_fd >= 0) {
      XAUTO_ASSIGN(e.trace_, trace::Writer::attach(session.trace_fd));
    }
  }
  if (!e.member_) {
    for (std::size_t m = 0; m < e.graph_.modules.size(); ++m)
      name_line(e.board_->module(static_cast<int>(m)).name, e.graph_.modules[m].name);
    e.routes_->show_on(*e.board_);
  }
  XAUTO_TRY(e.place());
  XAUTO_TRY(e.open_topics());
  XAUTO_ASSIGN(e.interop_, Interop::open(e.graph_, e.plan_, session));
  XAUTO_TRY(e.wire());
  if (!e.member_) XAUTO_TRY(e.open_recorder());
  if (!e.member_) e.compare_with_certificate();
  XAUTO_TRY(e.start_workers());
  return engine;
}

/// Every XNode as often as the fastest source releases. In lockstep, or when an input is replayed
/// faster, the trace goes back less far than was asked for; reports say how far.
std::uint64_t Engine::trace_capacity() const {
  std::int64_t fastest_us = session_.period_us;
  if (fastest_us == 0)
    for (const auto& source : app_.sources)
      if (fastest_us == 0 || source.period.count() < fastest_us) fastest_us = source.period.count();
  const double jobs_per_s = static_cast<double>(graph_.nodes.size()) * 1e6 /
                            static_cast<double>(std::max<std::int64_t>(1, fastest_us));
  const double events = session_.trace_keep_s * jobs_per_s * kEventsPerJob;
  return events >= static_cast<double>(kMaxTraceEvents)
             ? kMaxTraceEvents
             : std::max(kMinTraceEvents, static_cast<std::uint64_t>(events));
}

// ---- building
// --------------------------------------------------------------------------------------

/// The XPU instance of `node`: the policy's, or with ROS 2 scheduling the first of its fastest
/// type.
int Engine::xpu_of(const Graph::Node& node, std::uint32_t xnode) const {
  if (session_.scheduling != Scheduling::kRos2) return session_.policy.placements[xnode].xpu;
  const XNodeSpec& spec = session_.app.xnodes[xnode];
  int best = -1;
  std::int64_t best_us = 0;
  for (std::size_t i = 0; i < session_.platform.xpus.size(); ++i) {
    const std::string& type = session_.platform.xpus[i].type;
    const auto wcet = spec.wcet_on(type);
    if (wcet && find_impl(*node.spec, type) != nullptr && (best < 0 || *wcet < best_us)) {
      best = static_cast<int>(i);
      best_us = *wcet;
    }
  }
  return best;
}

/// What all modules are placed by.
struct Engine::Placing {
  FifoPlan fifo;                   ///< of the workers; all 0: SCHED_OTHER
  std::vector<int> fifo_by_xnode;  ///< of XNodes on real CPUs
  std::vector<int> cores;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> order;
  std::vector<std::uint32_t> xnode;  ///< [graph node] -> index in app.json
  std::vector<int> xpu;              ///< [graph node]; -1: none has an implementation
};

Status Engine::place() {
  XAUTO_ASSIGN(threads_, xpu::CpuThreads::create({.run = session_.cpu_run,
                                                  .scheduler_pid = session_.cpu_scheduler_pid,
                                                  .partial = session_.cpu_partial}));
  const bool scheduled = session_.scheduling == Scheduling::kXAuto;
  Placing placing;
  placing.fifo = choose_priorities();
  if (scheduled) {
    placing.fifo_by_xnode = placing.fifo.by_rank(session_.policy);
    placing.order = order_in_force();
  }
  placing.cores = rt::allowed_cores();
  for (const Graph::Node& node : graph_.nodes) {
    const auto xnode = static_cast<std::uint32_t>(session_.app.find(node.name));
    const int xpu = xpu_of(node, xnode);
    placing.xnode.push_back(xnode);
    placing.xpu.push_back(xpu);
    Limits limits;
    if (xpu >= 0) {
      const std::string& type = session_.platform.xpus[static_cast<std::size_t>(xpu)].type;
      limits = Limits::of(session_.deployment,
                          graph_.modules[static_cast<std::size_t>(node.module)].name, node.name,
                          session_.app.xnodes[xnode].wcet_on(type).value_or(0));
    }
    limits_.push_back(limits);
  }
  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    chains_.push_back(std::make_unique<Chain>());
    chains_.back()->module = static_cast<int>(m);
    if (hosted(m)) XAUTO_TRY(place_module(m, placing));
  }
  return {};
}

/// Of the workers; what falls short of what a run would like is noted.
FifoPlan Engine::choose_priorities() {
  const int highest = rt::highest_fifo();
  fifo_ = FifoPlan::within(session_.fifo_lowest, highest);
  // With sched_ext too: what is no XNode runs above it, and it may go at any time.
  const bool real_cpus_wanted = session_.cpu_sched != CpuSched::kOther;
  if (!session_.emulates() && !real_cpus_wanted) return FifoPlan::within(0, 0);
  if (fifo_.none()) {
    note_ = "no permission for SCHED_FIFO: threads run as SCHED_OTHER; " +
            (session_.fifo_why.empty() ? "" : session_.fifo_why + "; ") + rt::fifo_hint();
    log::warn("{}", note_);
    return fifo_;
  }
  std::vector<int> cpus;  // real ones
  for (const int x : session_.platform.instances_of("cpu"))
    if (session_.presence_of(x) == Presence::kReal) cpus.push_back(x);
  if (session_.scheduling == Scheduling::kXAuto && real_cpus_wanted && !cpus.empty()) {
    if (const std::string pressed = fifo_.note(highest, session_.policy, cpus); !pressed.empty()) {
      add_note(note_, pressed);
      if (session_.process == 0) log::warn("{}", pressed);
    }
  }
  FifoPlan plan = fifo_;
  if (!real_cpus_wanted) plan.cpu_lowest = plan.cpu_highest = 0;
  return plan;
}

/// What is known before the first release of the assumptions behind the policy's worst case: the
/// user hears of it now, not after an hour.
void Engine::compare_with_certificate() {
  if (session_.scheduling != Scheduling::kXAuto || !session_.policy.worst_case_us) return;
  const std::int64_t worst_us = *session_.policy.worst_case_us;
  const auto ms = [](std::int64_t us) {
    return fmt::format("{:.2f} ms", static_cast<double>(us) / 1000);
  };
  if (!graph_.single_rate) {
    unkept_.emplace_back("the sources have several periods, so releases overlap in any phase");
  } else if (session_.input.empty() && !session_.lockstep && !app_.sources.empty()) {
    const std::int64_t period_us =
        session_.period_us > 0 ? session_.period_us : app_.sources.front().period.count();
    if (period_us < worst_us)
      log::warn(
          "releases come every {}, the worst case is {} of {}: those that overlap may take longer",
          ms(period_us), ms(worst_us), kWorstCaseScope);
  }
  const bool kept = session_.cpu_sched == CpuSched::kExt ||
                    (session_.cpu_sched == CpuSched::kFifo && !fifo_.none());
  const std::vector<int> cpus = session_.platform.instances_of("cpu");
  const bool real_cpus = std::any_of(
      cpus.begin(), cpus.end(), [&](int x) { return session_.presence_of(x) == Presence::kReal; });
  if (real_cpus && !kept) unkept_.emplace_back("nobody keeps the priorities on CPUs (SCHED_OTHER)");
  for (const std::string& why : unkept_)
    log::warn("the policy's worst case of {} does not hold in this run: {}", ms(worst_us), why);
}

/// The policy's pairs of XNodes, on all XPUs.
std::vector<std::pair<std::uint32_t, std::uint32_t>> Engine::order_in_force() {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> order;
  if (session_.policy.order.empty()) return order;
  if (!graph_.single_rate) {
    // A pair would have to say which release of u comes before which of v.
    const std::string unordered =
        "the sources have several periods: the policy's order constraints are not enforced";
    add_note(note_, unordered);
    unkept_.push_back("its order constraints are not enforced");
    return order;
  }
  for (const auto& [u, v] : session_.policy.order)
    order.emplace_back(static_cast<std::uint32_t>(u), static_cast<std::uint32_t>(v));
  return order;
}

/// The module's chain, and a worker per XPU that it uses.
Status Engine::place_module(std::size_t m, const Placing& placing) {
  const Platform& platform = session_.platform;
  const bool scheduled = session_.scheduling == Scheduling::kXAuto;
  Chain& chain = *chains_[m];
  std::vector<std::pair<int, Worker*>> here;  // by XPU
  for (const int n : graph_.modules[m].nodes) {
    const auto index = static_cast<std::size_t>(n);
    const Graph::Node& node = graph_.nodes[index];
    const int xpu = placing.xpu[index];
    const std::string where = "XNode '" + node.name + "'";
    if (xpu < 0)
      return fail(ErrorCode::kInvalid,
                  "has no implementation for any XPU of platform '" + platform.name + "'", where);
    const Xpu& x = platform.xpus[static_cast<std::size_t>(xpu)];
    Placed placed;
    placed.name = node.name;
    placed.xnode = placing.xnode[index];
    placed.impl = find_impl(*node.spec, x.type);
    if (placed.impl == nullptr)
      return fail(ErrorCode::kInvalid,
                  "is assigned to " + x.id + " but has no implementation for '" + x.type + "'",
                  where, "add one with add_impl, or solve again with the app.json of this program");
    placed.limits = limits_[index];
    placed.line = &board_->xnode(index);
    if (scheduled) {
      placed.priority = session_.policy.placements[placed.xnode].priority;
      if (!session_.emulated(xpu) && x.type == "cpu")
        placed.fifo_priority = placing.fifo_by_xnode[placed.xnode];
    }
    auto at = std::find_if(here.begin(), here.end(), [&](const auto& h) { return h.first == xpu; });
    if (at == here.end()) {
      XAUTO_ASSIGN(WorkerOptions options, worker_options(m, xpu, placing));
      workers_.push_back(
          std::make_unique<Worker>(std::move(options), chain, trace_.get(), *threads_));
      at = here.insert(here.end(), {xpu, workers_.back().get()});
    }
    placed.worker = at->second;
    chain.nodes.push_back(std::move(placed));
  }
  return {};
}

Result<WorkerOptions> Engine::worker_options(std::size_t module, int xpu,
                                             const Placing& placing) const {
  const Platform& platform = session_.platform;
  const Xpu& x = platform.xpus[static_cast<std::size_t>(xpu)];
  const bool scheduled = session_.scheduling == Scheduling::kXAuto;
  const bool emulated = session_.emulated(xpu);
  const bool real_cpu = !emulated && x.type == "cpu";
  WorkerOptions options;
  options.xpu = xpu;
  options.xpu_id = xpu_id(platform, xpu);
  options.name = graph_.modules[module].name + "@" + x.id;
  options.emulated = emulated;
  options.driver = suspended_by_module(x, emulated, session_.emulator_modules);
  options.real_cpu = real_cpu && scheduled;
  options.mgmt_fifo = placing.fifo.management;
  options.exec_fifo = !real_cpu ? placing.fifo.execution : scheduled ? placing.fifo.cpu_lowest : 0;
  const Machine machine = Machine::here();
  if (session_.presence_of(xpu) == Presence::kAbsent ||
      (!emulated && !machine.has(platform, static_cast<std::size_t>(xpu)) && x.type == "cpu"))
    return fail(ErrorCode::kInvalid, "has XNodes in this run, and is not here: " + machine.lacks(x),
                x.id, "use a platform file of this machine: xauto doctor --platform-out here.json");
  if (real_cpu && (scheduled || session_.scheduling == Scheduling::kTimeshare)) {
    options.core = placing.cores[static_cast<std::size_t>(options.xpu_id.index)];
  }
  if (scheduled) {
    const auto coordinator = session_.coordinators.find(x.id);
    if (coordinator == session_.coordinators.end())
      return fail(ErrorCode::kInternal, "session names no coordinator", x.id);
    options.coordinator = coordinator->second;
    for (const auto& pair : placing.order)
      if (session_.policy.placements[pair.first].xpu == xpu) options.order.push_back(pair);
  }
  return options;
}

Status Engine::wire() {
  channels_.resize(graph_.topics.size());
  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    const Graph::Module& module = graph_.modules[m];
    latencies_.push_back(std::make_unique<Latencies>());
    if (module.sink) ++num_sinks_;
    if (!hosted(m)) {
      modules_.push_back(nullptr);
      continue;
    }
    std::vector<const transport::Channel*> outputs;
    std::vector<MessageMemory*> memories;
    for (const int t : module.outputs) {
      outputs.push_back(&channels_[static_cast<std::size_t>(t)]);
      memories.push_back(publishers_[static_cast<std::size_t>(t)].get());
    }
    try {
      modules_.push_back(std::make_unique<ModuleRuntime>(graph_, static_cast<int>(m), *this,
                                                         std::move(outputs), std::move(memories)));
    } catch (const std::exception& e) {
      return fail(ErrorCode::kUnavailable,
                  std::string("the state's constructor threw: ") + e.what(),
                  "XModule '" + module.name + "'");
    }
    chains_[m]->runtime = modules_.back().get();
    const ModuleDeployment said = session_.deployment.of(module.name);
    if (said.overload) modules_.back()->set_overload(*said.overload);
    if (said.match_us) modules_.back()->match_within(*said.match_us * 1000);
    if (said.on_hang == OnHang::kDrop) modules_.back()->watch();
  }
  sink_next_.assign(graph_.modules.size(), 0);
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    // Other processes first: they have a longer way.
    if (publishers_[t] != nullptr) channels_[t].subscribe(publishers_[t]->sender());
    for (const detail::ObserverSpec& observer : app_.observers)
      if (!member_ && observer.topic.name == graph_.topics[t].spec.name)
        channels_[t].subscribe([&observer](const detail::Envelope& envelope) {
          if (envelope.message == nullptr) return;
          try {
            observer.callback(envelope.message.get(), envelope.sequence);
          } catch (const std::exception& e) {
            log::warn("on_message of topic '{}' threw: {}", observer.topic.name, e.what());
          } catch (...) {
            log::warn("on_message of topic '{}' threw", observer.topic.name);
          }
        });
    for (const Graph::Subscriber& subscriber : graph_.topics[t].subscribers)
      if (hosted(static_cast<std::size_t>(subscriber.module)))
        channels_[t].subscribe(
            [module = modules_[static_cast<std::size_t>(subscriber.module)].get(),
             input = subscriber.input](const detail::Envelope& envelope) {
              module->receive(input, envelope);
            });
    if (interop_ && interop_->publisher(t) != nullptr)
      channels_[t].subscribe(interop_->publisher(t)->sender());
  }
  return {};
}

Status Engine::start_workers() {
  for (const auto& worker : workers_) XAUTO_TRY(worker->start());
  start_watchdog();
  return {};
}

void Engine::stop_workers() {
  const std::int64_t limit = now_ns() + kPatienceNs;
  for (const auto& worker : workers_)
    if (!worker->stop(std::max<std::int64_t>(kPatienceNs / 5, limit - now_ns()))) {
      stuck_ = true;
      const std::string text =
          "an exec of " + worker->options().name + " never returned; its thread was left behind";
      log::error("{}", text);
      const std::lock_guard lock(hung_mutex_);
      add_note(hung_note_, text);
    }
  watchdog_.reset();
}

// ---- running
// ---------------------------------------------------------------------------------------

Result<RunReport> Engine::run() {
  auto result = member_ ? run_member() : run_whole();
  stop_workers();  // if there was an error
  return result;
}

Result<RunReport> Engine::run_whole() {
  if (hub_) {
    XAUTO_TRY(open_inputs());
    XAUTO_ASSIGN(const bool ready, hub_->wait_ready(stop_));
    if (!ready) {
      (void)hub_->stop();
      return report();
    }
  }
  Status status;
  // The releasing thread runs the sources' callbacks, so it is not the caller's: its priority is
  // ours.
  std::thread releaser([&] {
    rt::set_thread_name("xauto/sources");
    rt::set_timer_slack_1ns();
    if (fifo_.sources > 0) (void)rt::set_fifo(fifo_.sources);
    status = session_.input.empty() ? release_periodic() : release_recorded();
  });
  releaser.join();
  XAUTO_TRY(status);
  const bool drained = wait_drained();
  if (recorder_)
    if (const Status closed = recorder_->close(); !closed) recording_error_ = closed.error().what;
  std::vector<std::string> members;
  if (hub_) {
    members = hub_->stop();
    receiver_->stop();
  }
  stop_workers();
  RunReport result = report();
  if (hub_) {
    gather(members, result);
    if (const std::uint64_t lost = receiver_->lost(); lost > 0)
      add_note(result.note,
               std::to_string(lost) + " messages to this process were lost in full queues");
  }
  // A run without an end of its own is complete when it has been told to stop.
  const bool endless = session_.activations == 0 && session_.duration_us == 0;
  result.complete = drained && (!stop_.load() || endless);
  if (!drained)
    add_note(result.note, in_flight_.load() > 0
                              ? std::to_string(in_flight_.load()) + " activations did not end"
                          : graph_.single_rate ? "a module whose result was not needed did not end"
                                               : "a module's last activation did not end");
  for (const auto& callback : app_.on_end) {
    try {
      callback();
    } catch (const std::exception& e) {
      return fail(ErrorCode::kIo, std::string("on_end threw: ") + e.what(),
                  "app '" + app_.name + "'");
    }
  }
  return result;
}

}  // namespace xauto::runtime
