// SPDX-License-Identifier: Apache-2.0
#include "engine/engine.h"

#include <algorithm>

#include <fmt/format.h>
#include <uapi/xauto/event.h>

#include "account/routes.h"
#include "base/log.h"
#include "model/contention.h"
#include "processes/board_account.h"
#include "processes/mode.h"
#include "processes/parameters.h"
#include "session/notes.h"

namespace xauto::runtime {
namespace {

/// Of a job in the trace: about 8, more when it is preempted.
constexpr double kEventsPerJob = 24;
constexpr std::uint64_t kMinTraceEvents = 1u << 12, kMaxTraceEvents = 1u << 22;  ///< 32 bytes each

/// Of an XNode of the app that is run by one policy.
bool counts_less_than_longest(const Session& session, const std::string& xnode) {
  const int i = session.app.find(xnode);
  if (i < 0 || session.tables || !session.keys) return false;
  const Placement& placed = session.keys->placements[static_cast<std::size_t>(i)];
  return placed.wcet_us &&
         *placed.wcet_us <
             longest_wcet(session.app.xnodes[static_cast<std::size_t>(i)],
                          session.platform.xpus[static_cast<std::size_t>(placed.xpu)].type);
}

/// Every XNode as often as the fastest source releases. In lockstep, or when an input is replayed
/// faster, the trace goes back less far than was asked for; reports say how far.
std::uint64_t trace_capacity(const detail::AppSpecErased& app, const Session& session,
                             const Graph& graph) {
  std::int64_t fastest_us = session.releases.period_us;
  if (fastest_us == 0)
    for (const auto& source : app.sources)
      if (fastest_us == 0 || source.period.floor_us() < fastest_us)
        fastest_us = source.period.floor_us();
  const double jobs_per_s = static_cast<double>(graph.nodes.size()) * 1e6 /
                            static_cast<double>(std::max<std::int64_t>(1, fastest_us));
  const double events = session.trace_keep_s * jobs_per_s * kEventsPerJob;
  return events >= static_cast<double>(kMaxTraceEvents)
             ? kMaxTraceEvents
             : std::max(kMinTraceEvents, static_cast<std::uint64_t>(events));
}

}  // namespace

// ---- building ----------------------------------------------------------------------------------

Result<std::unique_ptr<Engine>> Engine::create(const detail::AppSpecErased& app,
                                               const Session& session, std::atomic<bool>& stop) {
  XAUTO_ASSIGN(Graph graph, Graph::build(app));
  XAUTO_TRY(graph.matches(session.app));
  // One source on each side is the same one, also where app.json was written by hand.
  if (graph.sources.size() == 1 && session.app.sources.size() == 1)
    graph.sources[0].name = session.app.sources[0].name;
  if (session.app.one_at_a_time) graph.single_rate = true;  // whatever the program's rates are
  if (session.host.there()) graph.single_rate = false;      // nobody here sees all of a release
  // Releases have the numbers of app.json's grid, also those that are pushed.
  if (!session.app.sources.empty() && !session.releases.lockstep && session.releases.input.empty())
    for (Graph::Module& module : graph.modules) module.numbered = true;
  for (std::size_t m = 0; m < graph.modules.size(); ++m)
    if (!graph.single_rate && session.deployment.of(graph.modules[m].name).match_us)
      graph.match_by_origin(static_cast<int>(m));
  // With offsets a chain's release is not its component's.
  if (!session.app.sources.empty()) graph.tells_origins = true;
  auto engine = std::unique_ptr<Engine>(new Engine(app, session, std::move(graph), stop));
  Engine& e = *engine;
  XAUTO_ASSIGN(e.plan_, Plan::make(e.graph_, app, session));
  XAUTO_ASSIGN(e.grid_, Grid::make(e.graph_, session));
  XAUTO_ASSIGN(Routes routes, Routes::make(e.graph_, e.grid_, session.deployment, session.app));
  if (session.parts.process == 0)
    XAUTO_TRY(e.open_trace(true));  // before any member may attach to it
  XAUTO_ASSIGN(e.role_, RunRole::of(e.graph_, e.plan_, session, 1 + routes.size(), e.stop_));
  if (session.parts.process != 0) XAUTO_TRY(e.open_trace(false));
  Board& board = *e.role_->board();
  if (e.role_->leads())
    for (std::size_t m = 0; m < e.graph_.modules.size(); ++m) {
      ModuleLine& line = board.module(static_cast<int>(m));
      name_line(line.name, e.graph_.modules[m].name);
      if (e.plan_.process_of[m] == Plan::kElsewhere)
        name_line(line.host,
                  session.platform.hosts[static_cast<std::size_t>(e.plan_.host_of[m])].name);
    }
  if (e.role_->leads())
    for (std::size_t n = 0; n < e.graph_.nodes.size(); ++n) {
      const Graph::Node& node = e.graph_.nodes[n];
      name_line(board.xnode(n).name, node.name);
      name_line(board.xnode(n).module,
                e.graph_.modules[static_cast<std::size_t>(node.module)].name);
      board.xnode(n).kept_apart = counts_less_than_longest(session, node.name);
    }
  if (e.role_->leads())
    for (std::size_t x = 0; x < session.platform.xpus.size(); ++x) {
      if (session.elsewhere(x)) continue;
      const Xpu& xpu = session.platform.xpus[x];
      name_line(board.xpu(x).name, xpu.id);
      if (xpu.type != "cpu" && !session.emulated(static_cast<int>(x)))
        board.xpu(x).preempt_us = xpu.preempt_us;
    }
  if (e.role_->leads()) XAUTO_TRY(post_parameters(board, e.graph_, session.deployment));
  e.context_ = std::make_unique<Context>(
      Context{app, session, e.graph_, e.plan_, e.grid_, board, e.trace_.get()});
  e.ledger_ = std::make_unique<Ledger>(*e.context_, std::move(routes), *e.role_);
  e.placing_ = Placing::of(session, e.graph_);
  e.note_chain_ends();
  XAUTO_ASSIGN(e.wiring_, Wiring::build(*e.context_, e.placing_, *e.role_, e));
  e.role_->attach(*e.context_, *e.wiring_, *e.ledger_);
  if (e.role_->leads()) {
    XAUTO_ASSIGN(e.releaser_, Releaser::make(*e.context_, *e.wiring_, *e.ledger_, e.stop_));
    e.placing_.compare_with_certificate(session);
    std::string unkept;
    for (const std::string& line : e.placing_.unkept) add_note(unkept, line);
    board.tell_unkept(unkept);
    board.open_to_observers();
  }
  app.requests->bind([&board](const std::string& request) {
    return answer_error(answer_request(request, &board));
  });
  XAUTO_TRY(e.wiring_->start());
  XAUTO_ASSIGN(e.hangs_, HangWatch::make(*e.context_, *e.wiring_, *e.role_, e.placing_.limits));
  return engine;
}

/// Where chains end inside modules: their jobs tell.
void Engine::note_chain_ends() {
  placing_.ends_chain.assign(graph_.nodes.size(), 0);
  for (const Graph::Module& module : graph_.modules)
    for (const int n : module.nodes) {
      if (n == module.nodes.back() || !ledger_->ends_chain(n)) continue;
      placing_.ends_chain[static_cast<std::size_t>(n)] = 1;
      if (plan_.processes > 1)
        add_note(placing_.note, "chains that end at XNode '" +
                                    graph_.nodes[static_cast<std::size_t>(n)].name +
                                    "', inside its XModule, are measured in the hub alone");
    }
}

Engine::~Engine() {
  app_.requests->bind(nullptr);
  releaser_.reset();  // its watch looks at the workers, and at the role's board
  hangs_.reset();
  if (wiring_) wiring_->join();  // until then its threads need the role
  role_.reset();                 // and until then its threads need the wiring
}

Status Engine::open_trace(bool leads) {
  if (session_.trace_fd < 0) return {};
  if (leads) {
    XAUTO_ASSIGN(trace_,
                 trace::Writer::create(session_.trace_fd, trace_capacity(app_, session_, graph_)));
  } else {
    XAUTO_ASSIGN(trace_, trace::Writer::attach(session_.trace_fd));
  }
  return {};
}

// ---- running -----------------------------------------------------------------------------------

Result<RunReport> Engine::run() {
  thread_.check();
  auto result = role_->leads() ? run_all() : run_part();
  stop_workers();  // if there was an error
  return result;
}

/// The start that all hosts have agreed on. False: told to stop before.
Result<bool> Engine::begin_part() {
  BoardHeader& header = context_->board.header();
  const auto ready = [&](PartReady how) {
    header.part_ready.store(static_cast<std::uint32_t>(how));
  };
  ready(PartReady::kBuilt);
  constexpr std::int64_t kAskNs = 5'000'000, kAheadNs = 20'000'000, kFindNs = 3'000'000'000;
  const std::int64_t built_ns = now_ns();
  for (bool met = false; !stop_.load(); sleep_until_ns(now_ns() + kAskNs)) {
    met = met || wiring_->crossings()->met();
    if (met) ready(PartReady::kMet);
    // Who joins a run that goes on has less to lose once it has found the others, if they are there.
    if (header.part_start_ns.load() != 0 && (met || now_ns() - built_ns > kFindNs)) break;
  }
  const std::int64_t start_ns = header.part_start_ns.load();
  if (start_ns == 0) return false;
  // Who comes later begins with the next releases.
  const parts::PartStart start{start_ns, std::max<std::int64_t>(0, now_ns() + kAheadNs - start_ns)};
  releaser_->begin_with(start);
  XAUTO_TRY(wiring_->begin_part(start));
  return true;
}

Result<RunReport> Engine::run_all() {
  XAUTO_ASSIGN(bool begun, role_->begin());
  if (begun && wiring_->crossings() != nullptr) {
    XAUTO_ASSIGN(begun, begin_part());
  }
  if (!begun) {
    role_->end();
    stop_workers();
    RunReport nothing = report();
    say_not_complete("it was told to stop before it began", nothing);
    return nothing;
  }
  XAUTO_TRY(releaser_->run(placing_.fifo.sources));
  if (wiring_->crossings() != nullptr && !wiring_->crossings()->finish(releaser_->end_ns()))
    add_note(left_behind_, "messages of other hosts were waited for, for a minute");
  const bool drained = releaser_->wait_drained();
  role_->end();
  stop_workers();
  if (!drained) ledger_->give_up(waiting());
  RunReport result = report();
  std::string stuck_calls;
  role_->gather(result);
  std::vector<std::string> unscheduled;
  for (const std::string& xpu : result.lost_coordinators)
    unscheduled.push_back("the jobs of " + xpu + " went on unscheduled: its coordinator was gone");
  result.account.add("coordinator_lost", unscheduled.size(), unscheduled);
  result.recording_error = releaser_->close(result.releases);
  // A run without an end of its own is complete when it has been told to stop.
  const bool endless = session_.releases.activations == 0 && session_.releases.duration_us == 0;
  result.complete = drained && (!stop_.load() || endless);
  // Its job may have ended without having been suspended; whoever made the call waits for ever.
  for (const auto& worker : wiring_->workers())
    if (const std::string call = worker->stuck_call(); !call.empty()) {
      result.complete = false;
      add_note(stuck_calls, call + " never returned");
    }
  std::string why = drained ? std::string() : ledger_->what_did_not_end();
  add_note(why, stuck_calls);
  if (!result.complete)
    say_not_complete(why.empty() ? "it was told to stop before its end" : why, result);
  for (const std::string& note : releaser_->notes()) add_note(result.note, note);
  note_lockstep(result);
  XAUTO_TRY(detail::call(app_.on_end, "on_end", app_.name));
  return result;
}

void Engine::say_not_complete(const std::string& why, RunReport& into) {
  into.account.add("run_not_complete", 1, "the run is not complete: " + why);
  add_note(into.note, why);
}

/// [module] messages that wait for it here.
std::vector<std::size_t> Engine::waiting() const {
  std::vector<std::size_t> waiting;
  for (std::size_t m = 0; m < graph_.modules.size(); ++m)
    waiting.push_back(wiring_->module(m) == nullptr ? 0 : wiring_->module(m)->waiting());
  return waiting;
}

/// What has no time in a report, and why.
void Engine::note_lockstep(RunReport& into) const {
  if (!session_.releases.lockstep || grid_.one_at_a_time ||
      (graph_.single_rate && !grid_.periodic) || into.account.chains.empty())
    return;
  std::uint64_t untimed = 0;
  for (const ChainAccount& chain : into.account.chains) untimed += chain.not_measured;
  add_note(into.note, "time between releases means nothing in lockstep: no age is measured" +
                          (untimed == 0 ? std::string()
                                        : ", nor the latency of " + std::to_string(untimed) +
                                              " results that waited for another release"));
}

/// A member's: the counts are on the board, so only notes are left to tell.
Result<RunReport> Engine::run_part() {
  XAUTO_ASSIGN(const bool begun, role_->begin());
  if (begun) XAUTO_TRY(role_->wait_stop());
  role_->end();
  stop_workers();
  RunReport result;
  tell_notes(result);
  role_->hand_over(result);
  return result;
}

void Engine::stop_workers() {
  for (const std::string& text : wiring_->stop()) {
    stuck_ = true;
    log::error("{}", text);
    add_note(left_behind_, text);
  }
  hangs_->stop();
  if (releaser_) releaser_->stop_watch();
}

/// What this process has to tell, apart from counts.
void Engine::tell_notes(RunReport& into) {
  into.note = placing_.note;
  wiring_->report(into);
  add_note(into.note, hangs_->note());
  hangs_->report(into);
  add_note(into.note, left_behind_);
}

void Engine::tell_preemptions(RunReport& into) const {
  for (std::size_t x = 0; x < context_->session.platform.xpus.size(); ++x) {
    const XpuLine& line = context_->board.xpu(x);
    if (line.suspensions == 0 || line.preempt_us < 0) continue;
    into.preemptions.push_back({line_name(line.name), line.suspensions,
                                line.longest_suspend_ns / 1000, line.longest_resume_ns / 1000,
                                line.preempt_us});
  }
}

/// What the kernel took from the threads of XNodes on cores.
void Engine::tell_cores(Account& into) const {
  for (std::size_t n = 0; n < graph_.nodes.size(); ++n) {
    const XNodeLine& line = context_->board.xnode(n);
    if (line.waited_ns > 0)
      into.taken.push_back(
          {fmt::format("XNode '{}' of XModule '{}' could have run for {:.2f} ms on its core, and "
                       "the kernel ran neither it nor another XNode there",
                       line_name(line.name), line_name(line.module),
                       static_cast<double>(line.waited_ns) * 1e-6),
           line.waited_ns / 1000});
  }
}

/// Who knows more goes before the board.
void Engine::tell_assumptions(RunReport& into) {
  Account& account = into.account;
  account.add("set_up", placing_.unkept.size(), placing_.unkept);
  if (context_->session.keys && wiring_->lost_scheduler())
    account.add("scheduler_gone", 1,
                "nobody kept keys on real CPUs after the sched_ext scheduler had ended");
  if (releaser_) releaser_->report(into);
  add_assumptions(context_->board, account);
}

RunReport Engine::report() {
  RunReport result;
  tell_notes(result);
  ledger_->report(placing_.limits, result);
  tell_preemptions(result);
  tell_cores(result.account);
  tell_assumptions(result);
  add_note(result.note, changed_parameters(context_->board));
  return result;
}

// ---- what the modules tell ---------------------------------------------------------------------

/// Where one activation ends before the next begins, without a locked access.
void Engine::count_in_flight(int module, int change) {
  std::atomic<std::uint32_t>& count = context_->board.module(module).in_flight;
  if (wiring_->module(static_cast<std::size_t>(module))->one_at_a_time())
    count.store(change > 0 ? 1 : 0, std::memory_order_release);
  else
    count.fetch_add(static_cast<std::uint32_t>(change));
}

void Engine::activate(int module, Activation& activation) {
  const NodeRow& chain = wiring_->chain(static_cast<std::size_t>(module), activation.index());
  count_in_flight(module, 1);
  if (trace_) {
    trace_->write(XAUTO_EV_ACTIVATE, activation.sequence(), XAUTO_EV_NONE,
                  static_cast<std::uint16_t>(module), XAUTO_EV_NONE);
    if (!graph_.single_rate || grid_.periodic) trace_inputs(module, activation);
  }
  chain.chain()->worker->submit(0);
}

void Engine::proceed(int module, Activation& activation, std::size_t node) {
  const NodeRow& chain = wiring_->chain(static_cast<std::size_t>(module), activation.index());
  chain.chain()[node].worker->submit(node);
}

/// Numbers of releases mean nothing across sources of several rates: what an activation was made of
/// is told by origins.
void Engine::trace_inputs(int module, Activation& activation) {
  const std::vector<int>& inputs = graph_.modules[static_cast<std::size_t>(module)].inputs;
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    trace_->write(XAUTO_EV_TAKE, static_cast<std::uint64_t>(activation.origin_of(i)), XAUTO_EV_NONE,
                  static_cast<std::uint16_t>(module), XAUTO_EV_NONE,
                  publisher_of(inputs[i]) | (activation.is_urgent(i) ? XAUTO_RELEASE_URGENT : 0));
  }
}

/// Who publishes a topic, as events name it.
std::uint32_t Engine::publisher_of(int topic) const {
  const Graph::Topic& of = graph_.topics[static_cast<std::size_t>(topic)];
  if (of.source < 0) return static_cast<std::uint32_t>(of.module);
  return XAUTO_TAKE_SOURCE | grid_.sources[static_cast<std::size_t>(of.source)].number;
}

void Engine::sampled(int module, std::span<const detail::Envelope> messages) {
  if (!trace_) return;
  const std::vector<int>& samples = graph_.modules[static_cast<std::size_t>(module)].samples;
  for (std::size_t i = 0; i < messages.size(); ++i)
    trace_->write(
        XAUTO_EV_SAMPLE, messages[i].message != nullptr ? messages[i].sequence : XAUTO_SAMPLE_NONE,
        XAUTO_EV_NONE, static_cast<std::uint16_t>(module), XAUTO_EV_NONE, publisher_of(samples[i]));
}

void Engine::done(int module, const Activation& activation) {
  ledger_->done(module, activation.origin_ns(), activation.sequence(), activation.origins().get(),
                activation.urgent());
}

void Engine::left(int module) {
  count_in_flight(module, -1);
}

void Engine::dropped(int module, std::uint64_t sequence, std::uint32_t reason) {
  ledger_->dropped(module, sequence, reason);
}

void Engine::passed(int module, const Activation& activation, int node) {
  static_cast<void>(module);
  ledger_->passed(node, activation.origin_ns(), activation.sequence(), activation.origins().get(),
                  activation.urgent());
}

void Engine::skip(int module, std::uint64_t sequence) {
  wiring_->skip(module, sequence);
}

}  // namespace xauto::runtime
