// SPDX-License-Identifier: Apache-2.0
#include "runtime/wiring.h"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "session/notes.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kPatienceNs = 1'000'000'000;  ///< with an exec, once the run is over

/// What an observer throws is the user's fault, and no reason to end the publisher.
void show(const detail::ObserverSpec& observer, const detail::Envelope& envelope) {
  if (envelope.message == nullptr) return;
  try {
    observer.callback(envelope.message.get(), envelope.sequence);
  } catch (const std::exception& e) {
    log::warn("on_message of topic '{}' threw: {}", observer.topic.name, e.what());
  } catch (...) {
    log::warn("on_message of topic '{}' threw", observer.topic.name);
  }
}

}  // namespace

Result<std::unique_ptr<Wiring>> Wiring::build(const Context& context, const Placing& placing,
                                              Role& role, ModuleHost& host) {
  auto wiring = std::unique_ptr<Wiring>(new Wiring(context, placing, role));
  Wiring& w = *wiring;
  const Session& session = context.session;
  XAUTO_ASSIGN(w.threads_, xpu::CpuThreads::create({.run = session.cpu.run,
                                                    .first_xnode = session.cpu.first_xnode,
                                                    .scheduler_pid = session.cpu.scheduler_pid,
                                                    .partial = session.cpu.partial}));
  if (context.scheduled() && !session.coordinators.empty())
    w.held_up_ = std::make_unique<HeldUp>(context, placing);
  const std::size_t modules = context.graph.modules.size(), topics = context.graph.topics.size();
  if (EarlyStart::may_be(context)) {
    std::vector<bool> shared;
    for (const Xpu& xpu : session.platform.xpus) shared.push_back(session.shares(xpu.id));
    XAUTO_ASSIGN(w.early_, EarlyStart::make(session.app, session.platform, *session.keys, shared));
  }
  w.crews_ = std::vector<Crew>(session.platform.xpus.size());
  for (std::size_t m = 0; m < modules; ++m) {
    w.chains_.emplace_back();
    for (int i = 0; context.hosts(m) && i < context.grid.in_flight[m]; ++i)
      XAUTO_TRY(w.place_module(m, i));
  }
  w.channels_.resize(topics);
  XAUTO_TRY(w.open_topics());
  XAUTO_ASSIGN(w.crossings_, parts::Crossings::open(context, placing.carriers));
  XAUTO_ASSIGN(w.interop_, Interop::open(context.graph, context.plan, session));
  w.modules_.resize(modules);
  for (std::size_t m = 0; m < modules; ++m)
    if (context.hosts(m)) XAUTO_TRY(w.make_module(m, host));
  for (std::size_t t = 0; t < topics; ++t) w.connect(t);
  return wiring;
}

Wiring::~Wiring() {
  join();
}

void Wiring::join() {
  close_inputs();
  for (const auto& worker : workers_) worker->stop();
}

/// The module's chain, and a worker per XPU that it uses; for one of the activations in flight.
Status Wiring::place_module(std::size_t module, int index) {
  chains_[module].push_back(std::make_unique<NodeRow>());
  NodeRow& chain = *chains_[module].back();
  chain.module = static_cast<int>(module);
  chain.tables = context_.session.num_tables();
  std::vector<std::pair<int, Worker*>> here;                            // by XPU
  std::map<std::tuple<int, int, int>, std::shared_ptr<Instance>> made;  // by node, XPU and variant
  for (std::size_t table = 0; table < chain.tables; ++table)
    for (const int n : context_.graph.modules[module].nodes) {
      XAUTO_ASSIGN(Placed placed, place_node(module, table, n));
      const int xpu = placing_.xpu[table][static_cast<std::size_t>(n)];
      auto at =
          std::find_if(here.begin(), here.end(), [&](const auto& h) { return h.first == xpu; });
      if (at == here.end()) {
        XAUTO_ASSIGN(WorkerOptions options, placing_.worker(context_, module, index, xpu));
        options.contexts = &context_.board.contexts();
        if (context_.session.board_fd >= 0)
          options.counts = &context_.board.xpu(static_cast<std::size_t>(xpu));
        options.held_up = held_up_.get();
        options.early = early_.get();
        workers_.push_back(
            std::make_unique<Worker>(std::move(options), chain, context_.trace, *threads_));
        workers_.back()->share(crews_[static_cast<std::size_t>(xpu)]);
        at = here.insert(here.end(), {xpu, workers_.back().get()});
      }
      placed.worker = at->second;
      placed.here =
          made.try_emplace({n, xpu, context_.session.variant_of(table, placed.xnode)}, placed.here)
              .first->second;
      chain.nodes.push_back(std::move(placed));
    }
  return {};
}

/// Node `n` of the graph as `table` places it, but for its worker.
Result<Placed> Wiring::place_node(std::size_t module, std::size_t table, int n) {
  const Session& session = context_.session;
  const auto at_node = static_cast<std::size_t>(n);
  const Graph::Node& node = context_.graph.nodes[at_node];
  const int xpu = placing_.xpu[table][at_node];
  const std::string where = "XNode '" + node.name + "'";
  if (xpu < 0)
    return fail(ErrorCode::kInvalid,
                "has no implementation for any XPU of platform '" + session.platform.name + "'",
                where);
  const Xpu& x = session.platform.xpus[static_cast<std::size_t>(xpu)];
  Placed placed;
  placed.name = node.name;
  placed.xnode = placing_.xnode[at_node];
  placed.task = session.task(table, placed.xnode);
  placed.table = static_cast<std::uint32_t>(table);
  const int variant = session.variant_of(table, placed.xnode);
  const std::string named =
      variant < 0
          ? ""
          : session.app.xnodes[placed.xnode].variants[static_cast<std::size_t>(variant)].name;
  placed.impl = find_impl(*node.spec, x.type, named);
  if (placed.impl == nullptr)
    return fail(
        ErrorCode::kInvalid,
        "is assigned to " + x.id + " but has no implementation for '" + x.type + "'" +
            (named.empty() ? "" : " in variant '" + named + "'"),
        where,
        "add one with add_impl (add_variant), or solve again with the app.json of this program");
  placed.limit(placing_.limits[table][at_node], session.tables.has_value(),
               context_.board.xnode(at_node));
  placed.node = n;
  placed.ends_chain = placing_.ends_chain[at_node] != 0;
  if (!context_.scheduled()) return placed;
  if (session.keys) {
    const Placement& key = session.keys_of(table).placements[placed.xnode];
    placed.urgency = Urgency::of_keys(key.key_us, key.hold_us, context_.grid.urgent_by_us[module]);
    if (early_)
      placed.urgency.plan_starts(early_->planned_us().ordinary[placed.xnode],
                                 early_->planned_us().urgent[placed.xnode]);
  } else {
    placed.urgency =
        Urgency::of_priority(session.of_table(table).placements[placed.xnode].priority);
  }
  if (!session.emulated(xpu) && x.type == "cpu" && !session.cpu.regulated)
    placed.fifo_priority =
        session.cpu.by_keys ? kCpuAsks : placing_.fifo_by_xnode[table][placed.xnode];
  tell_order(placed, xpu);
  return placed;
}

/// By what its jobs are ordered, where people look and ask for something else (processes/prio.h). What one of several
/// tables does not let them ask for, they may not.
void Wiring::tell_order(const Placed& placed, int xpu) {
  const Session& session = context_.session;
  XNodeLine& line = *placed.line;
  const bool keys = session.keys.has_value();
  Ordered order = keys ? Ordered::kKey : Ordered::kPriority;
  const bool real_core =
      !session.emulated(xpu) && session.platform.xpus[static_cast<std::size_t>(xpu)].type == "cpu";
  // Coordinators and sched_ext are told with each job; SCHED_FIFO's ranks are the policy's, and know no keys.
  if (real_core && !session.cpu.by_keys && session.cpu.sched != CpuSched::kExt)
    order = placed.fifo_priority > 0 && !keys ? Ordered::kRank : Ordered::kNobody;
  if (placed.table == 0) {
    const std::vector<std::int64_t>* key_us =
        keys ? &session.keys_of(0).placements[placed.xnode].key_us : nullptr;
    line.keys.store(keys ? static_cast<std::uint32_t>(key_us->size()) : 0);
    line.planned.store(keys ? key_us->front() : coord::priority_of_key(placed.urgency.constant()));
  }
  const bool asked_for = order == Ordered::kKey || order == Ordered::kPriority;
  if (placed.table == 0 || !asked_for) line.ordered.store(static_cast<std::uint32_t>(order));
}

/// What this process publishes to others.
Status Wiring::open_topics() {
  publishers_.resize(context_.graph.topics.size());
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    const Plan::Remote& remote = context_.plan.topics[t];
    if (remote.readers.empty() || remote.publisher != context_.session.parts.process) continue;
    ringers_.push_back(std::make_unique<BoardRinger>(role_.board(), remote.readers));
    XAUTO_ASSIGN(publishers_[t],
                 role_.link(t).publisher(context_.graph.topics[t].spec, ringers_.back().get()));
  }
  return {};
}

Status Wiring::make_module(std::size_t index, ModuleHost& host) {
  const Graph::Module& module = context_.graph.modules[index];
  std::vector<const transport::Channel*> outputs;
  std::vector<detail::MessageMemory*> memories;
  for (const int t : module.outputs) {
    outputs.push_back(&channels_[static_cast<std::size_t>(t)]);
    memories.push_back(publisher(static_cast<std::size_t>(t)));
  }
  try {
    modules_[index] = std::make_unique<ModuleRuntime>(context_.graph, static_cast<int>(index), host,
                                                      std::move(outputs), std::move(memories),
                                                      context_.grid.in_flight[index]);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnavailable, std::string("the state's constructor threw: ") + e.what(),
                "XModule '" + module.name + "'");
  }
  ModuleRuntime& made = *modules_[index];
  for (std::size_t i = 0; i < chains_[index].size(); ++i) {
    chains_[index][i]->runtime = &made;
    chains_[index][i]->activation = &made.activation(i);
  }
  const ModuleDeployment said = context_.session.deployment.of(module.name);
  made.read_parameters(ParameterReader(context_.board, context_.graph, static_cast<int>(index)));
  made.shift_origins(context_.grid.shift_ns[index]);
  // Who runs the app in another way and claims nothing (lockstep) takes what is marked for ordinary.
  if (!context_.session.releases.lockstep && context_.session.mode == Mode::kRun)
    made.let_mark(
        context_.session.keys && context_.scheduled() ? context_.grid.marks_apart[index] : 0,
        context_.board.module(static_cast<int>(index)));
  if (said.overload)
    made.set_overload(*said.overload);
  else if (context_.grid.periodic)  // within its keys nothing is lost at a module's door
    made.set_overload({Overload::Kind::kQueue, context_.grid.depth[index]});
  if (said.match_us) made.match_within(*said.match_us * 1000);
  if (said.on_hang == OnHang::kDrop) made.watch();
  if (context_.session.tables) {
    std::vector<char> off;  // [table]
    for (const Table& table : context_.session.tables->tables)
      off.push_back(table.loss.is_off(module.name) ? 1 : 0);
    if (std::count(off.begin(), off.end(), 1) == 0) off.clear();
    made.read_tables(context_.board, std::move(off));
  }
  return {};
}

/// Who hears a message of this topic, in this order.
void Wiring::connect(std::size_t topic) {
  const Graph::Topic& spec = context_.graph.topics[topic];
  transport::Channel& channel = channels_[topic];
  // Other processes first: they have a longer way.
  if (publisher(topic) != nullptr) channel.subscribe(publisher(topic)->sender());
  if (crossings_)
    if (auto sender = crossings_->sender(topic)) channel.subscribe(std::move(sender));
  if (role_.leads())
    for (const detail::ObserverSpec& observer : context_.app.observers)
      if (observer.topic.name == spec.spec.name)
        channel.subscribe(
            [&observer](const detail::Envelope& envelope) { show(observer, envelope); });
  for (const Graph::Subscriber& subscriber : spec.subscribers)
    if (const auto m = static_cast<std::size_t>(subscriber.module); context_.hosts(m))
      channel.subscribe(
          [module = module(m), input = subscriber.input](const detail::Envelope& envelope) {
            module->receive(input, envelope);
          });
  if (interop_ && interop_->publisher(topic) != nullptr)
    channel.subscribe(interop_->publisher(topic)->sender());
}

Status Wiring::start() {
  thread_.check();
  for (const auto& worker : workers_) XAUTO_TRY(worker->start());
  return {};
}

Status Wiring::open_inputs() {
  thread_.check();
  const int process = context_.session.parts.process;
  if (context_.plan.processes == 1) return {};
  receiver_ = std::make_unique<transport::Receiver>(context_.board.process(process).doorbell);
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    const int reader = context_.plan.topics[t].reader(process);
    if (reader < 0) continue;
    XAUTO_ASSIGN(auto subscriber, role_.link(t).subscriber(context_.graph.topics[t].spec,
                                                           static_cast<std::uint32_t>(reader)));
    receiver_->add(-1, std::move(subscriber), false,
                   [channel = &channels_[t]](const detail::Envelope& envelope) {
                     channel->publish(envelope);
                   });
  }
  return receiver_->start([priority = placing_.fifo.sources] {
    rt::set_thread_name("xauto/topics");
    rt::set_timer_slack_1ns();
    if (priority > 0) (void)rt::set_fifo(priority);
  });
}

Status Wiring::begin_part(const parts::PartStart& start) {
  thread_.check();
  XAUTO_ASSIGN(const auto releases,
               parts::releases_of_modules(context_.graph, context_.session.app));
  for (std::size_t m = 0; m < modules_.size(); ++m) {
    const std::uint64_t first = start.first(releases[m]);
    if (modules_[m] == nullptr || first == 0) continue;
    modules_[m]->begin_at(first);
    skip(static_cast<int>(m), first - 1);
  }
  return crossings_->start(
      start,
      [this](std::size_t topic, const detail::Envelope& envelope) {
        channels_[topic].publish(envelope);
      },
      [priority = placing_.fifo.sources] {
        rt::set_thread_name("xauto/crossings");
        rt::set_timer_slack_1ns();
        if (priority > 0) (void)rt::set_fifo(priority);
      });
}

void Wiring::close_inputs() {
  thread_.check();
  if (receiver_) receiver_->stop();
  if (crossings_) crossings_->stop();
}

std::vector<std::string> Wiring::stop() {
  thread_.check();
  std::vector<std::string> stuck;
  const std::int64_t limit = now_ns() + kPatienceNs;
  for (const auto& worker : workers_)
    if (!worker->stop(std::max<std::int64_t>(kPatienceNs / 5, limit - now_ns())))
      stuck.push_back(worker->stuck_in() + " never returned; its thread was left behind");
  return stuck;
}

void Wiring::skip(int module, std::uint64_t sequence) {
  // The words are common to all of the module's workers on an XPU.
  const NodeRow& chain = *chains_[static_cast<std::size_t>(module)].front();
  for (std::size_t i = 0; i < chain.nodes.size(); ++i) chain.nodes[i].worker->skip(i, sequence);
}

bool Wiring::lost_scheduler() const {
  return context_.session.cpu.scheduler_pid != 0 && !threads_->ext();
}

void Wiring::report(RunReport& into) {
  if (crossings_) {
    crossings_->stop();
    crossings_->report(into);
  }
  if (interop_) {
    interop_->stop();
    for (const std::string& note : interop_->notes()) add_note(into.note, note);
  }
  if (early_) {
    const EarlyStart::Count early = early_->count();
    into.early_starts = {true, early.jobs, early.sum_ns / 1000};
  }
  add_note(into.note, threads_->note());
  std::set<std::string> lost;
  for (const auto& worker : workers_) {
    add_note(into.note, worker->first_failure());
    if (worker->lost_coordinator()) lost.insert(worker->xpu_name());
  }
  into.lost_coordinators.assign(lost.begin(), lost.end());
}

}  // namespace xauto::runtime
