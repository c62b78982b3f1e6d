// SPDX-License-Identifier: Apache-2.0
#include "runtime/engine.h"

#include <algorithm>
#include <set>

#include <sched.h>
#include <signal.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "base/rt.h"
#include "record/recording.h"
#include "runtime/supervisor.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kStallNs =
    10'000'000'000;  ///< no progress for so long: give up, say what hangs
constexpr std::int64_t kSilenceNs = 3'000'000'000;   ///< of a watchdog, beyond the hang limit
constexpr std::int64_t kPatienceNs = 1'000'000'000;  ///< with an exec, once the run is over

/// To the notes of a report, which are one text; "" adds none.
void add_note(std::string& notes, const std::string& text) {
  if (!text.empty()) notes += (notes.empty() ? "" : "; ") + text;
}

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
    XAUTO_ASSIGN(e.trace_, trace::Writer::create(session.trace_fd, session.trace_capacity));
  }
  if (e.plan_.processes == 1) {
    e.board_ = Board::local({1, static_cast<std::uint32_t>(e.graph_.modules.size()),
                             static_cast<std::uint32_t>(e.graph_.nodes.size())});
  } else if (session.process == 0) {
    XAUTO_ASSIGN(e.hub_, Hub::create(e.plan_, e.graph_, session, e));
    e.board_ = e.hub_->board();
  } else {
    XAUTO_ASSIGN(e.member_, Member::join(e.plan_, e.graph_, session));
    e.board_ = e.member_->board();
    if (session.trace_fd >= 0) {
      XAUTO_ASSIGN(e.trace_, trace::Writer::attach(session.trace_fd));
    }
  }
  XAUTO_TRY(e.place());
  XAUTO_TRY(e.open_topics());
  XAUTO_ASSIGN(e.interop_, Interop::open(e.graph_, e.plan_, session));
  XAUTO_TRY(e.wire());
  if (!e.member_) XAUTO_TRY(e.open_recorder());
  XAUTO_TRY(e.start_workers());
  return engine;
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

Status Engine::place() {
  const Platform& platform = session_.platform;
  const bool scheduled = session_.scheduling == Scheduling::kXAuto;
  // With sched_ext too: what is no XNode runs above it, and it may go at any time.
  bool fifo = session_.emulated || session_.cpu_sched != CpuSched::kOther;
  XAUTO_ASSIGN(threads_, xpu::CpuThreads::create({.run = session_.cpu_run,
                                                  .scheduler_pid = session_.cpu_scheduler_pid,
                                                  .partial = session_.cpu_partial}));
  const int highest_fifo = rt::highest_fifo();
  fifo_ = FifoPlan::within(session_.fifo_lowest, highest_fifo);
  if (fifo && fifo_.none()) {
    fifo = false;
    note_ = "no permission for SCHED_FIFO: threads run as SCHED_OTHER; " +
            (session_.fifo_why.empty() ? "" : session_.fifo_why + "; ") + rt::fifo_hint();
    log::warn("{}", note_);
  }
  const std::vector<int> fifo_by_xnode =
      scheduled ? fifo_.by_rank(session_.policy) : std::vector<int>();
  const std::vector<int> cores = rt::allowed_cores();

  if (fifo && scheduled && !session_.emulated) {
    std::vector<int> cpus;
    for (std::size_t x = 0; x < platform.xpus.size(); ++x)
      if (platform.xpus[x].type == "cpu") cpus.push_back(static_cast<int>(x));
    if (const std::string pressed = fifo_.note(highest_fifo, session_.policy, cpus);
        !pressed.empty()) {
      add_note(note_, pressed);
      if (session_.process == 0) log::warn("{}", pressed);
    }
  }

  std::vector<std::pair<std::uint32_t, std::uint32_t>> order;
  if (scheduled && !session_.policy.order.empty()) {
    if (graph_.single_rate) {
      for (const auto& [u, v] : session_.policy.order)
        order.emplace_back(static_cast<std::uint32_t>(u), static_cast<std::uint32_t>(v));
    } else {
      const std::string unordered =
          "the sources have several periods: the policy's order constraints are not enforced, "
          "its worst case does not hold";
      add_note(note_, unordered);
      log::warn("{}", unordered);
    }
  }

  limits_.resize(graph_.nodes.size());
  xnode_of_.resize(graph_.nodes.size());
  for (std::size_t n = 0; n < graph_.nodes.size(); ++n)
    xnode_of_[n] = static_cast<std::uint32_t>(session_.app.find(graph_.nodes[n].name));

  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    for (const int n : graph_.modules[m].nodes) {
      const Graph::Node& node = graph_.nodes[static_cast<std::size_t>(n)];
      const std::uint32_t xnode = xnode_of_[static_cast<std::size_t>(n)];
      if (const int xpu = xpu_of(node, xnode); xpu >= 0)
        limits_[static_cast<std::size_t>(n)] =
            Limits::of(session_.deployment, graph_.modules[m].name, node.name,
                       session_.app.xnodes[xnode]
                           .wcet_on(platform.xpus[static_cast<std::size_t>(xpu)].type)
                           .value_or(0));
    }
    auto chain = std::make_unique<Chain>();
    chain->module = static_cast<int>(m);
    if (!hosted(m)) {
      chains_.push_back(std::move(chain));
      continue;
    }
    std::vector<std::pair<int, Worker*>> here;  // one worker per XPU of this module
    std::vector<int> xpus;
    for (const int n : graph_.modules[m].nodes) {
      const Graph::Node& node = graph_.nodes[static_cast<std::size_t>(n)];
      const std::uint32_t xnode = xnode_of_[static_cast<std::size_t>(n)];
      const int xpu = xpu_of(node, xnode);
      const std::string where = "XNode '" + node.name + "'";
      if (xpu < 0)
        return fail(ErrorCode::kInvalid,
                    "has no implementation for any XPU of platform '" + platform.name + "'", where);
      const Xpu& x = platform.xpus[static_cast<std::size_t>(xpu)];
      Placed placed;
      placed.name = node.name;
      placed.xnode = xnode;
      placed.impl = find_impl(*node.spec, x.type);
      if (placed.impl == nullptr)
        return fail(ErrorCode::kInvalid,
                    "is assigned to " + x.id + " but has no implementation for '" + x.type + "'",
                    where,
                    "add one with add_impl, or solve again with the app.json of this program");
      placed.limits = limits_[static_cast<std::size_t>(n)];
      placed.line = &board_->xnode(static_cast<std::size_t>(n));
      const bool real_cpu = !session_.emulated && x.type == "cpu";
      if (scheduled) {
        placed.priority = session_.policy.placements[xnode].priority;
        if (real_cpu && fifo) placed.fifo_priority = fifo_by_xnode[xnode];
      }
      auto at =
          std::find_if(here.begin(), here.end(), [&](const auto& h) { return h.first == xpu; });
      if (at == here.end()) {
        WorkerOptions options;
        options.xpu = xpu;
        options.xpu_id = xpu_id(platform, xpu);
        options.name = graph_.modules[m].name + "@" + x.id;
        options.emulated = session_.emulated;
        options.driver = suspended_by_module(x, session_.emulated, session_.emulator_modules);
        options.mgmt_fifo = fifo ? fifo_.management : 0;
        if (real_cpu) {
          if (scheduled || session_.scheduling == Scheduling::kTimeshare) {
            if (options.xpu_id.index >= static_cast<int>(cores.size()))
              return fail(ErrorCode::kInvalid,
                          "platform '" + platform.name + "' has more CPUs than the " +
                              std::to_string(cores.size()) + " that this process may use",
                          x.id, "use a platform file of this machine, or --emulate");
            options.core = cores[static_cast<std::size_t>(options.xpu_id.index)];
          }
          options.exec_fifo = scheduled && fifo ? fifo_.cpu_lowest : 0;
        } else {
          options.exec_fifo = fifo ? fifo_.execution : 0;
        }
        if (scheduled) {
          const auto coordinator = session_.coordinators.find(x.id);
          if (coordinator == session_.coordinators.end())
            return fail(ErrorCode::kInternal, "session names no coordinator", x.id);
          options.coordinator = coordinator->second;
          for (const auto& pair : order)
            if (session_.policy.placements[pair.first].xpu == xpu) options.order.push_back(pair);
        }
        options.real_cpu = real_cpu && scheduled;
        workers_.push_back(
            std::make_unique<Worker>(std::move(options), *chain, trace_.get(), *threads_));
        here.emplace_back(xpu, workers_.back().get());
        at = here.end() - 1;
      }
      placed.worker = at->second;
      chain->nodes.push_back(std::move(placed));
    }
    chains_.push_back(std::move(chain));
  }
  return {};
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

/// Looks often enough to notice a hang within a quarter of the shortest limit.
void Engine::start_watchdog() {
  std::int64_t shortest = 0;
  for (std::size_t n = 0; n < limits_.size(); ++n) {
    const std::int64_t ns = limits_[n].hang_ns;
    const auto module = static_cast<std::size_t>(graph_.nodes[n].module);
    if (ns <= 0) continue;
    if (hosted(module)) {
      shortest = shortest == 0 ? ns : std::min(shortest, ns);
    } else if (hub_ && limits_[n].on_hang == OnHang::kRestart) {
      std::int64_t& silence = silence_ns_[plan_.process_of[module]];
      silence = std::max(silence, std::min(ns, INT64_MAX - kSilenceNs) + kSilenceNs);
    }
  }
  if (shortest == 0 && silence_ns_.empty()) return;
  const std::int64_t period =
      shortest == 0 ? 50'000'000 : std::clamp<std::int64_t>(shortest / 4, 1'000'000, 50'000'000);
  watchdog_ = std::make_unique<Watchdog>(period, [this](std::int64_t now) {
    for (const auto& worker : workers_)
      if (const auto job = worker->find_hung(now)) hung(*worker, *job);
    if (member_) board_->process(session_.process).watched_ns.store(now);
    watch_members(now);
  });
}

/// In the hub: a process that has stopped as a whole cannot tell that it hangs.
void Engine::watch_members(std::int64_t now) {
  for (const auto& [process, silence] : silence_ns_) {
    std::atomic<std::int64_t>& watched = board_->process(process).watched_ns;
    const std::int64_t last = watched.load();
    if (last == 0 || now - last <= silence) continue;
    watched.store(0);  // of this one; the next starts anew
    log::error("process {} has not looked after itself for {} ms: it is killed", process,
               (now - last) / 1'000'000);
    hub_->kill(process);
  }
}

void Engine::hung(const Worker& worker, const Worker::Hung& job) {
  const std::string text = "XNode '" + job.placed->name + "' on " + worker.options().xpu_id.name +
                           " ran past its hang limit of " +
                           std::to_string(job.placed->limits.hang_ns / 1'000'000) +
                           " ms in activation " + std::to_string(job.sequence);
  const bool first = job.placed->line->hangs.load(std::memory_order_relaxed) == 1;
  if (first) {
    const std::lock_guard lock(hung_mutex_);
    add_note(hung_note_, text);
  }
  switch (job.placed->limits.on_hang) {
    case OnHang::kLog:
      if (first) log::warn("{} (further ones are only counted)", text);
      break;
    case OnHang::kDrop:
      if (modules_[static_cast<std::size_t>(job.module)]->abandon(job.sequence) && first)
        log::warn("{}: given up (further ones are only counted)", text);
      break;
    case OnHang::kRestart:
      log::error("{}: its process is killed", text);
      (void)kill(getpid(), SIGKILL);
      break;
  }
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

// ---- topics between processes
// -------------------------------------------------------------------

transport::Link& Engine::link(std::size_t topic) const {
  return hub_ ? hub_->topic(topic) : member_->topic(topic);
}

/// What this process publishes to others.
Status Engine::open_topics() {
  publishers_.resize(graph_.topics.size());
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    const Plan::Remote& remote = plan_.topics[t];
    if (remote.readers.empty() || remote.publisher != session_.process) continue;
    ringers_.push_back(std::make_unique<BoardRinger>(board_, remote.readers));
    XAUTO_ASSIGN(publishers_[t], link(t).publisher(graph_.topics[t].spec, ringers_.back().get()));
  }
  return {};
}

/// What this process reads of others. From here on messages come in.
Status Engine::open_inputs() {
  if (plan_.processes == 1) return {};
  receiver_ = std::make_unique<transport::Receiver>(board_->process(session_.process).doorbell);
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    const int reader = plan_.topics[t].reader(session_.process);
    if (reader < 0) continue;
    XAUTO_ASSIGN(auto subscriber,
                 link(t).subscriber(graph_.topics[t].spec, static_cast<std::uint32_t>(reader)));
    receiver_->add(-1, std::move(subscriber), false,
                   [channel = &channels_[t]](const detail::Envelope& envelope) {
                     channel->publish(envelope);
                   });
  }
  receiver_->start([priority = fifo_.sources] {
    rt::set_thread_name("xauto/topics");
    rt::set_timer_slack_1ns();
    if (priority > 0) (void)rt::set_fifo(priority);
  });
  return {};
}

void Engine::event(const Packet& packet) {
  through(static_cast<int>(packet.index), packet.sequence, packet.origin_ns,
          packet.rates != 0 ? &packet.origins : nullptr, packet.now_ns, packet.lost != 0);
}

void Engine::left(int process) {
  std::string modules;
  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    if (plan_.process_of[m] != process) continue;
    modules += (modules.empty() ? "" : ", ") + graph_.modules[m].name;
    // It may have died between counting a release and telling.
    const std::uint64_t settled = board_->module(static_cast<int>(m)).settled();
    if (graph_.modules[m].sink && graph_.single_rate && settled > 0)
      account(static_cast<int>(m), settled - 1, now_ns(), true);
  }
  log::warn("the process of {} died: its activations are dropped", modules);
  auto ghost = Ghost::haunt(
      process, plan_, graph_, *hub_, *receiver_,
      [this](int module, std::uint64_t sequence) { dropped(module, sequence, XAUTO_DROP_DIED); });
  if (!ghost) {
    log::error("cannot stand in for it: {}", ghost.error().to_string());
    stop_.store(true);
    return;
  }
  ghosts_[process] = std::move(*ghost);
  board_->process(process).stand_in.store(0);
  board_->process(0).doorbell.ring();
}

void Engine::joins(int process) {
  receiver_->remove(process);
  ghosts_.erase(process);
  board_->process(process).stand_in.store(static_cast<std::uint32_t>(process));
}

Result<RunReport> Engine::run_member() {
  XAUTO_ASSIGN(const bool go, member_->ready(stop_));
  if (go) {
    if (graph_.single_rate)
      for (std::size_t m = 0; m < modules_.size(); ++m)
        if (modules_[m] != nullptr) {
          const std::uint64_t next = board_->module(static_cast<int>(m)).settled();
          modules_[m]->begin_at(next);
          if (next > 0) skip(static_cast<int>(m), next - 1);
        }
    XAUTO_TRY(open_inputs());
    if (!member_->wait_stop(stop_))
      return fail(ErrorCode::kUnavailable, "the app's hub is gone", "app '" + app_.name + "'");
  }
  if (receiver_) receiver_->stop();
  stop_workers();
  RunReport result;  // the counts are on the board
  tell_notes(result);
  member_->report(to_json(result));
  return result;
}

/// Adds what the members have to tell. The counts are on the board, the latencies came with events.
void Engine::gather(const std::vector<std::string>& reports, RunReport& report) const {
  const auto note = [&](const std::string& text) {
    if (report.note.find(text) == std::string::npos) add_note(report.note, text);
  };
  for (const std::string& text : reports) {
    const auto member = parse_run_report(text);
    if (!member) {
      note("a module process's report is unreadable");
      continue;
    }
    note(member->note);
    report.lost_coordinators.insert(report.lost_coordinators.end(),
                                    member->lost_coordinators.begin(),
                                    member->lost_coordinators.end());
  }
  std::sort(report.lost_coordinators.begin(), report.lost_coordinators.end());
  report.lost_coordinators.erase(
      std::unique(report.lost_coordinators.begin(), report.lost_coordinators.end()),
      report.lost_coordinators.end());
  for (const int process : hub_->deaths())
    for (const std::string& module : session_.processes[static_cast<std::size_t>(process - 1)])
      report.died.push_back(module);
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
  const bool drained = wait_drained(kStallNs);
  if (recorder_) XAUTO_TRY(recorder_->close());
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
  result.complete = drained && (!stop_.load() || session_.activations == 0);
  if (!drained)
    add_note(result.note, in_flight_.load() > 0
                              ? std::to_string(in_flight_.load()) + " activations did not end"
                              : "a module whose result was not needed did not end");
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

/// Every source at its period, on one absolute time grid, so that sources of equal period release
/// at the same instants and nothing drifts.
Status Engine::release_periodic() {
  struct Source {
    int topic;
    std::int64_t period_ns;
    std::uint64_t sequence = 0;
  };
  std::vector<Source> sources;
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    if (graph_.topics[t].source < 0) continue;
    const auto& spec = app_.sources[static_cast<std::size_t>(graph_.topics[t].source)];
    const std::int64_t period_us =
        session_.period_us > 0 ? session_.period_us : spec.period.count();
    sources.push_back({static_cast<int>(t), period_us * 1000});
  }
  std::int64_t start = now_ns() + 20'000'000;
  const std::uint64_t limit = session_.activations == 0 ? kMaxActivations : session_.activations;
  while (!stop_.load()) {
    std::int64_t due = INT64_MAX;
    for (const Source& s : sources)
      if (s.sequence < limit)
        due = std::min(due, start + static_cast<std::int64_t>(s.sequence) * s.period_ns);
    if (due == INT64_MAX) break;
    if (session_.lockstep) {
      if (!wait_drained(kStallNs))
        return fail(ErrorCode::kTimeout, "no progress for 10 s in lockstep",
                    "app '" + app_.name + "'");
      // Now, whatever the period: the time grid moves along.
      const std::int64_t now = now_ns();
      start += now - due;
      due = now;
    }
    // Messages are made before their release, so that making them does not count as latency.
    std::vector<std::pair<int, std::shared_ptr<const void>>> messages;
    std::vector<int> fed;
    std::int64_t fed_period_ns = 0;
    std::uint64_t sequence = 0;
    for (Source& s : sources) {
      if (s.sequence >= limit || start + static_cast<std::int64_t>(s.sequence) * s.period_ns > due)
        continue;
      if (interop_ && interop_->feeds(static_cast<std::size_t>(s.topic))) {
        fed.push_back(s.topic);
        fed_period_ns =
            s.sequence == 0 ? INT64_MAX : s.period_ns;  // nothing to do before the first
        sequence = s.sequence++;
        continue;
      }
      const auto& spec = app_.sources[static_cast<std::size_t>(
          graph_.topics[static_cast<std::size_t>(s.topic)].source)];
      try {
        MessageMemory* memory = publishers_[static_cast<std::size_t>(s.topic)].get();
        messages.emplace_back(s.topic, memory != nullptr && spec.make_in
                                           ? spec.make_in(s.sequence, memory)
                                           : spec.make(s.sequence));
      } catch (const std::exception& e) {
        return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(),
                    "the source of topic '" + spec.topic.name + "'");
      }
      sequence = s.sequence++;
    }
    sleep_until_ns(due);
    if (!fed.empty()) {
      take_fed(fed, fed_period_ns, messages);
      if (stop_.load()) break;
      // The next release is a period after this one: the time grid follows whoever feeds us.
      if (graph_.single_rate) start += now_ns() - due;
      if (messages.empty()) continue;
    }
    release(now_ns(), sequence, messages);
  }
  return {};
}

/// Messages that programs outside feed us. In an app of one rate a release waits for its message,
/// for up to a period; without one it is lost, and told so downstream. Otherwise there is one or
/// there is none.
void Engine::take_fed(const std::vector<int>& topics, std::int64_t period_ns,
                      std::vector<std::pair<int, std::shared_ptr<const void>>>& messages) {
  if (graph_.single_rate) {
    const std::int64_t now = now_ns();
    interop_->wait(topics, period_ns > INT64_MAX - now ? INT64_MAX : now + period_ns, stop_);
  }
  for (const int topic : topics) {
    auto message = interop_->newest(topic);
    if (message != nullptr || graph_.single_rate) messages.emplace_back(topic, std::move(message));
  }
}

void Engine::release(std::int64_t origin_ns, std::uint64_t sequence,
                     const std::vector<std::pair<int, std::shared_ptr<const void>>>& messages) {
  if (graph_.single_rate && num_sinks_ > 0) {
    const std::lock_guard lock(releases_mutex_);
    num_released_ = sequence + 1;
    while (open_base_ + open_.size() <= sequence) open_.push_back({});
    if (sequence >= open_base_)
      open_[sequence - open_base_] = {origin_ns, origin_ns, num_sinks_, false};
    in_flight_.fetch_add(1);
  }
  if (trace_)
    trace_->write(XAUTO_EV_PUBLISH, sequence, XAUTO_EV_NONE, XAUTO_EV_NONE, XAUTO_EV_NONE);
  if (recorder_) record(origin_ns, messages);
  for (const auto& [topic, message] : messages) {
    detail::Envelope envelope{message, origin_ns, sequence};
    if (!graph_.single_rate) {
      auto origins = std::make_shared<detail::Origins>();
      origins->fill(0);
      const auto source =
          static_cast<std::size_t>(graph_.topics[static_cast<std::size_t>(topic)].source);
      if (source < origins->size()) (*origins)[source] = origin_ns;
      envelope.origins = std::move(origins);
    }
    channels_[static_cast<std::size_t>(topic)].publish(envelope);
  }
}

Status Engine::open_recorder() {
  if (session_.record.empty()) return {};
  XAUTO_ASSIGN(auto recorder, record::Recorder::create(session_.record));
  recorder_.emplace(std::move(recorder));
  recorded_topic_.assign(graph_.topics.size(), 0);
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    const Graph::Topic& topic = graph_.topics[t];
    if (topic.source < 0) continue;
    if (topic.spec.encode == nullptr)
      return fail(ErrorCode::kInvalid,
                  "messages of type " + topic.spec.type_name + " cannot be recorded",
                  "topic '" + topic.spec.name + "'", "specialise xauto::Codec for it");
    XAUTO_ASSIGN(recorded_topic_[t],
                 recorder_->add_topic({topic.spec.name, topic.spec.type_name, "xauto"}));
  }
  return {};
}

/// The first failure ends the recording, not the run; the report tells.
void Engine::record(std::int64_t origin_ns,
                    const std::vector<std::pair<int, std::shared_ptr<const void>>>& messages) {
  for (const auto& [topic, message] : messages) {
    if (message == nullptr) continue;
    const auto t = static_cast<std::size_t>(topic);
    Status done;
    try {
      const std::vector<std::byte> bytes = graph_.topics[t].spec.encode(message.get());
      done = recorder_->write(recorded_topic_[t], origin_ns, bytes);
    } catch (const std::exception& e) {
      done = fail(ErrorCode::kIo, e.what(), session_.record);
    }
    if (done) continue;
    add_note(note_, "recording ended early: " + done.error().to_string());
    log::warn("recording ended early: {}", done.error().to_string());
    recorder_.reset();
    return;
  }
}

/// Releases a recording's messages: message k of each recorded source topic is release k. In
/// lockstep, or at the recorded distances in time (or `period_us`).
Status Engine::release_recorded() {
  XAUTO_ASSIGN(auto recording, record::Recording::open(session_.input));
  std::vector<int> topic_of(recording.topics().size(), -1);
  std::set<int> missing;
  for (std::size_t t = 0; t < graph_.topics.size(); ++t)
    if (graph_.topics[t].source >= 0) missing.insert(static_cast<int>(t));
  for (std::size_t r = 0; r < recording.topics().size(); ++r)
    for (const int t : std::set<int>(missing))
      if (graph_.topics[static_cast<std::size_t>(t)].spec.name == recording.topics()[r].name) {
        topic_of[r] = t;
        missing.erase(t);
      }
  const auto topic_name = [&](int t) {
    return graph_.topics[static_cast<std::size_t>(t)].spec.name;
  };
  if (!missing.empty())
    return fail(ErrorCode::kInvalid,
                "has no messages for topic '" + topic_name(*missing.begin()) + "'", session_.input,
                "record the app's own sources with `xauto run --record`");

  std::vector<std::uint64_t> sequence(graph_.topics.size(), 0);
  // Messages of one instant are one release; so are the k-th messages of all topics in a
  // single-rate app.
  std::vector<std::pair<int, std::shared_ptr<const void>>> batch;
  std::size_t num_topics = 0;
  for (const int t : topic_of) num_topics += t >= 0 ? 1 : 0;
  std::int64_t first_stamp = -1, start = 0;
  std::uint64_t releases = 0;
  while (!stop_.load() && (session_.activations == 0 || releases < session_.activations)) {
    XAUTO_ASSIGN(auto message, recording.next());
    if (!message) break;
    const int t = topic_of[message->topic];
    if (t < 0) continue;
    const detail::TopicSpec& spec = graph_.topics[static_cast<std::size_t>(t)].spec;
    if (spec.decode == nullptr)
      return fail(ErrorCode::kInvalid, "messages of type " + spec.type_name + " cannot be decoded",
                  "topic '" + spec.name + "'", "specialise xauto::Codec for it");
    try {
      batch.emplace_back(t, spec.decode(message->data));
    } catch (const std::exception& e) {
      return fail(
          ErrorCode::kInvalid,
          "message " + std::to_string(sequence[static_cast<std::size_t>(t)]) + ": " + e.what(),
          session_.input + ": topic '" + spec.name + "'");
    }
    const std::uint64_t number = sequence[static_cast<std::size_t>(t)]++;
    if (graph_.single_rate && batch.size() < num_topics) continue;
    if (first_stamp < 0) {
      first_stamp = message->timestamp_ns;
      start = now_ns() + 20'000'000;
    }
    if (session_.lockstep) {
      if (!wait_drained(kStallNs))
        return fail(ErrorCode::kTimeout, "no progress for 10 s in lockstep",
                    "app '" + app_.name + "'");
    } else if (session_.period_us > 0) {
      sleep_until_ns(start + static_cast<std::int64_t>(releases) * session_.period_us * 1000);
    } else {
      sleep_until_ns(start + (message->timestamp_ns - first_stamp));
    }
    release(now_ns(), number, batch);
    batch.clear();
    ++releases;
  }
  return {};
}

/// Every module is through with every release. Those whose result nobody waits for, since another
/// input of the same release was lost, are so later than the sinks.
bool Engine::settled() const {
  for (std::size_t m = 0; m < graph_.modules.size(); ++m)
    if (board_->module(static_cast<int>(m)).settled() < num_released_) return false;
  return true;
}

/// Single rate: until every release is accounted for. Otherwise there is nothing to count by, so:
/// until no module has ended an activation for 100 ms. False after `timeout_ns` without progress.
bool Engine::wait_drained(std::int64_t timeout_ns) {
  if (!graph_.single_rate) {
    for (std::uint64_t before = board_->settled();;) {
      sleep_until_ns(now_ns() + 100'000'000);
      const std::uint64_t now = board_->settled();
      if (now == before) return true;
      before = now;
    }
  }
  std::int64_t since = now_ns();
  std::uint64_t settled_before = 0;
  for (std::uint32_t last = in_flight_.load();;) {
    const std::uint32_t left = in_flight_.load();
    if (left == 0 && !settled()) {
      if (const std::uint64_t sum = board_->settled(); sum != settled_before) {
        settled_before = sum;
        since = now_ns();
      }
      if (now_ns() - since > timeout_ns) return false;
      sleep_until_ns(now_ns() + 20'000);
      continue;
    }
    if (left == 0) {
      // A sink's process says that it is through beside its messages, which observers here get.
      while (receiver_ && !receiver_->idle()) sleep_until_ns(now_ns() + 20'000);
      return true;
    }
    if (left != last) since = now_ns();
    last = left;
    if (now_ns() - since > timeout_ns) return false;
    futex_wait_local(in_flight_, left, 50'000'000);
  }
}

// ---- accounting
// ------------------------------------------------------------------------------------

void Engine::activate(int module) {
  Chain& chain = *chains_[static_cast<std::size_t>(module)];
  if (trace_)
    trace_->write(XAUTO_EV_ACTIVATE, chain.runtime->input().sequence(), XAUTO_EV_NONE,
                  static_cast<std::uint16_t>(module), XAUTO_EV_NONE);
  chain.nodes.front().worker->submit(0);
}

void Engine::done(int module, std::int64_t origin_ns, std::uint64_t sequence) {
  board_->module(module).activations.fetch_add(1, std::memory_order_relaxed);
  if (trace_)
    trace_->write(XAUTO_EV_DONE, sequence, XAUTO_EV_NONE, static_cast<std::uint16_t>(module),
                  XAUTO_EV_NONE);
  if (graph_.modules[static_cast<std::size_t>(module)].sink || routes_->end_at(module))
    through(module, sequence, origin_ns,
            modules_[static_cast<std::size_t>(module)]->origins().get(), now_ns(), false);
}

/// A sink module, or one where a chain ends, is through with release `sequence`; known here, or
/// told by its process.
void Engine::through(int module, std::uint64_t sequence, std::int64_t origin_ns,
                     const detail::Origins* origins, std::int64_t now, bool lost) {
  if (member_) {
    member_->tell(module, sequence, origin_ns, now, lost, origins);
    return;
  }
  if (!lost) routes_->published(module, origin_ns, origins, now);
  if (!graph_.modules[static_cast<std::size_t>(module)].sink) return;
  if (!lost) {
    Latencies& latencies = *latencies_[static_cast<std::size_t>(module)];
    const std::lock_guard lock(latencies.mutex);
    latencies.us.add((now - origin_ns) / 1000);
  }
  account(module, sequence, now, lost);
}

void Engine::dropped(int module, std::uint64_t sequence, std::uint32_t reason) {
  ModuleLine& counts = board_->module(module);
  (reason == XAUTO_DROP_FAILED ? counts.failed : counts.dropped)
      .fetch_add(1, std::memory_order_relaxed);
  if (trace_)
    trace_->write(XAUTO_EV_DROP, sequence, XAUTO_EV_NONE, static_cast<std::uint16_t>(module),
                  XAUTO_EV_NONE, reason);
  if (graph_.modules[static_cast<std::size_t>(module)].sink)
    through(module, sequence, 0, nullptr, now_ns(), true);
}

void Engine::skip(int module, std::uint64_t sequence) {
  const Chain& chain = *chains_[static_cast<std::size_t>(module)];
  for (std::size_t i = 0; i < chain.nodes.size(); ++i) chain.nodes[i].worker->skip(i, sequence);
}

/// A sink module settles its releases in order and each once; what it left out was lost with its
/// process, what comes twice was told by a process that died meanwhile.
void Engine::account(int module, std::uint64_t sequence, std::int64_t now, bool lost) {
  if (!graph_.single_rate) return;
  std::uint32_t complete = 0;
  {
    const std::lock_guard lock(releases_mutex_);
    std::uint64_t& next = sink_next_[static_cast<std::size_t>(module)];
    for (; next <= sequence && next < open_base_ + open_.size(); ++next) {
      Open& open = open_[next - open_base_];
      open.last_ns = std::max(open.last_ns, now);
      open.lost |= lost || next < sequence;
      if (--open.sinks_left > 0) continue;
      const std::int64_t latency_us = (open.last_ns - open.origin_ns) / 1000;
      releases_.push_back({next, open.origin_ns, open.lost ? -1 : latency_us});
      if (releases_.size() > kKeptReleases) releases_.pop_front();
      ++num_releases_;
      if (open.lost)
        ++lost_releases_;
      else
        release_latencies_us_.add(latency_us);
      if (session_.app.deadline_us && (open.lost || latency_us > *session_.app.deadline_us))
        deadline_misses_.fetch_add(1, std::memory_order_relaxed);
      ++complete;
    }
    for (; !open_.empty() && open_.front().sinks_left == 0; ++open_base_) open_.pop_front();
  }
  if (complete == 0) return;
  in_flight_.fetch_sub(complete);
  futex_wake_local(in_flight_, 1);
}

/// What this process has to tell, apart from counts.
void Engine::tell_notes(RunReport& result) {
  add_note(result.note, note_);
  if (interop_) {
    interop_->stop();
    for (const std::string& note : interop_->notes()) add_note(result.note, note);
  }
  add_note(result.note, threads_->note());
  for (const auto& worker : workers_) {
    add_note(result.note, worker->first_failure());
    if (worker->lost_coordinator())
      result.lost_coordinators.push_back(worker->options().xpu_id.name);
  }
  std::sort(result.lost_coordinators.begin(), result.lost_coordinators.end());
  result.lost_coordinators.erase(
      std::unique(result.lost_coordinators.begin(), result.lost_coordinators.end()),
      result.lost_coordinators.end());
  const std::lock_guard lock(hung_mutex_);
  add_note(result.note, hung_note_);
}

RunReport Engine::report() {
  RunReport result;
  tell_notes(result);
  {
    const std::lock_guard lock(releases_mutex_);
    result.releases.assign(releases_.begin(), releases_.end());
    result.num_releases = num_releases_;
    result.lost_releases = lost_releases_;
    result.latencies_us = release_latencies_us_;
  }
  std::sort(result.releases.begin(), result.releases.end(),
            [](const Release& a, const Release& b) { return a.sequence < b.sequence; });
  std::vector<std::uint64_t> lost;  // [module]
  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    const ModuleLine& counts = board_->module(static_cast<int>(m));
    ModuleReport module{graph_.modules[m].name, graph_.modules[m].sink, counts.activations,
                        counts.failed,          counts.dropped,         {}};
    const std::lock_guard lock(latencies_[m]->mutex);
    module.latencies_us = latencies_[m]->us;
    result.modules.push_back(std::move(module));
    lost.push_back(counts.failed + counts.dropped);
  }
  result.routes = routes_->report(lost);
  for (std::size_t n = 0; n < graph_.nodes.size(); ++n) {
    if (!limits_[n].any()) continue;
    const XNodeLine& line = board_->xnode(n);
    result.xnodes.push_back({graph_.nodes[n].name, limits_[n].budget_ns / 1000,
                             limits_[n].hang_ns / 1000, line.jobs, line.overruns, line.hangs,
                             line.longest_ns / 1000});
  }
  result.deadline_misses = deadline_misses_.load();
  return result;
}

}  // namespace xauto::runtime
