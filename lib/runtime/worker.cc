// SPDX-License-Identifier: Apache-2.0
// Steps 3, 4 and 9. The management thread, step 6, is in worker_mgmt.cc.
#include "runtime/worker.h"

#include <algorithm>
#include <climits>
#include <exception>
#include <future>
#include <utility>

#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "runtime/early_start.h"
#include "xpu/levels.h"

namespace xauto::runtime {
namespace {

constexpr std::uint32_t kQuit = UINT32_MAX;
constexpr std::int64_t kDestroyNs = 10'000'000'000;  ///< patience with what `init` has made
constexpr std::int64_t kWorthTellingNs = 50'000;     ///< to the trace: shorter ones explain nothing
constexpr std::int64_t kCallNs = 1'000'000'000;      ///< ... with a call that suspends or resumes
constexpr std::uint32_t kIdle = 1, kThrough = 2;     ///< Worker::ended_

}  // namespace

Worker::Worker(WorkerOptions options, NodeRow& chain, trace::Writer* trace,
               xpu::CpuThreads& threads)
    : options_(std::move(options)),
      chain_(chain),
      trace_(trace),
      thread_(threads.add(static_cast<std::uint32_t>(options_.xpu))) {}

thread_local Worker* Worker::t_home = nullptr;

Worker::~Worker() {
  stop();
}

Status Worker::start() {
  XAUTO_ASSIGN(backend_, xpu::make_backend(options_.backend));
  if (options_.contexts != nullptr) backend_->count_in(*options_.contexts);
  if (!options_.coordinator.empty()) {
    std::vector<std::uint32_t> xnodes;
    for (const Placed& placed : chain_.nodes)
      if (placed.worker == this) xnodes.push_back(placed.task);
    XAUTO_ASSIGN(port_, coord::Port::connect(options_.coordinator, options_.name, xnodes,
                                             options_.order, options_.mgmt_fifo));
  }
  times_.set_up({options_.counts, port_.get(), options_.preempt_ns, backend_->on_thread(),
                 port_ && port_->shared()});
  if (port_) {
    XAUTO_ASSIGN(mgmt_, start_thread([this] {
                   manage();
                   managed_.store(1);
                   futex_wake_local(managed_, INT_MAX);
                 }));
  }
  std::promise<Status> ready;
  std::future<Status> started = ready.get_future();
  auto run = [this, &ready, around = xpu::Surroundings::of_this_thread()] {
    around.enter();
    Status status = init_nodes();
    const bool good = status.has_value();
    ready.set_value(std::move(status));
    if (good) execute();
    ended_.store(kIdle);
    destroy_objects(good);
    thread_->leave();
    ended_.store(kThrough);
    futex_wake_local(ended_, INT_MAX);
  };
  XAUTO_ASSIGN(exec_, start_thread(std::move(run)));
  return started.get();
}

/// On the execution thread: what `init` makes current stays current for `exec`.
Status Worker::init_nodes() {
  rt::set_thread_name(options_.name);
  rt::set_timer_slack_1ns();
  if (options_.core) XAUTO_TRY(rt::pin_to_core(*options_.core));
  XAUTO_TRY(thread_->enter(backend_->on_thread(), options_.exec_fifo));
  times_.of_this_thread();
  if (backend_->on_thread() && options_.core) given_ = rt::placement_of(times_.thread_id());
  for (Placed& placed : chain_.nodes) {
    if (placed.worker != this || std::exchange(placed.here->there, true)) continue;
    detail::Made& made = placed.here->made;
    const std::string where = "init of XNode '" + placed.name + "' on " + xpu_name();
    XAUTO_ASSIGN(const xpu::Backend::Init around, backend_->before_init());
    const xpu::TellLevels tell(levels_here());
    try {
      made.handle = placed.impl->init(options_.backend.id, chain_.activation->state(), made.object);
    } catch (const std::exception& e) {
      return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(), where);
    } catch (...) {
      return fail(ErrorCode::kUnavailable, "threw something that is no std::exception", where);
    }
    if (Status attached = backend_->attach(made.handle); !attached) {
      attached.error().where = where;
      return attached;
    }
  }
  if (crew_ != nullptr && may_share())
    crew_->join(*this);
  else
    crew_ = nullptr;
  lane_.reserve(64);
  for (auto node = chain_.nodes.rbegin(); node != chain_.nodes.rend(); ++node)
    if (node->worker == this)
      thread_->expect(node->task, node->urgency.of_release(now_ns(), 0, false));
  return {};
}

/// What xauto::levels() says in its inits.
int Worker::levels_here() const {
  const xpu::BackendRequest& on = options_.backend;
  return on.scheduled ? xpu::levels_of(on.xpu, on.emulated) : 0;
}

/// Nothing of its jobs belongs to its thread.
bool Worker::may_share() const {
  // With order constraints a thread could wait for a job that is behind it in its own lane.
  if (!port_ || port_->discipline() != Discipline::kGate || !options_.order.empty()) return false;
  return std::none_of(chain_.nodes.begin(), chain_.nodes.end(), [this](const Placed& placed) {
    return placed.worker == this && (placed.here->made.handle.kind() != SchedHandle::Kind::kGate ||
                                     placed.here->made.object != nullptr || placed.urgency.holds());
  });
}

/// Where they were made, the last one first; not before the management thread has made its last
/// call on their handles. It has made none if there was no job.
void Worker::destroy_objects(bool ran) {
  const auto owns = [this](const Placed& placed) {
    return placed.worker == this && placed.here->made.object != nullptr;
  };
  if (std::none_of(chain_.nodes.begin(), chain_.nodes.end(), owns)) return;
  while (ran && port_ && managed_.load() == 0) futex_wait_local(managed_, 0, kLookNs);
  for (auto node = chain_.nodes.rbegin(); node != chain_.nodes.rend(); ++node)
    if (node->worker == this) node->here->made.object.reset();
}

bool Worker::stop(std::int64_t patience_ns) {
  const std::int64_t since = now_ns();
  const auto patient = [&] { return now_ns() - since < patience_ns; };
  std::uint32_t empty = 0;
  // The mailbox may still hold a job: it is taken first, then we leave.
  while (exec_.joinable() && !mailbox_.compare_exchange_weak(empty, kQuit) && patient()) {
    if (port_) port_->interrupt();
    futex_wait_local(mailbox_, empty, kLookNs);
    empty = 0;
  }
  futex_wake_local(mailbox_, INT_MAX);
  if (port_) port_->interrupt();
  while (exec_.joinable() && ended_.load() == 0 && patient()) futex_wait_local(ended_, 0, kLookNs);
  // What has made their contexts waits for the management thread, which calls what is the app's.
  const std::int64_t told_since = now_ns();
  while (mgmt_.joinable() && managed_.load() == 0 && (patient() || now_ns() - told_since < kCallNs))
    futex_wait_local(managed_, 0, kLookNs);
  const bool managed = !mgmt_.joinable() || managed_.load() != 0;
  // Weights take longer to unload than an exec may take to return.
  const std::int64_t idle_since = now_ns();
  while (managed && exec_.joinable() && ended_.load() == kIdle &&
         (patient() || now_ns() - idle_since < kDestroyNs))
    futex_wait_local(ended_, kIdle, kLookNs);
  const bool returned = !exec_.joinable() || ended_.load() == kThrough;
  if (exec_.joinable()) {
    if (returned)
      exec_.join();
    else
      exec_.detach();
  }
  if (mgmt_.joinable()) {
    if (managed)
      mgmt_.join();
    else
      mgmt_.detach();
  }
  return returned && managed;
}

std::string Worker::stuck_call() const {
  const CallWatch::Seen seen = calls_.now();
  if (seen.call == CallWatch::Call::kNone) return {};
  return std::string("the ") + (seen.call == CallWatch::Call::kSuspend ? "suspend" : "resume") +
         " of XNode '" + seen.placed->name + "' on " + xpu_name();
}

std::string Worker::stuck_in() const {
  if (std::string call = stuck_call(); !call.empty()) return call;
  return ended_.load() == 0 ? "an exec of " + options_.name
                            : "a destructor of what an init of " + options_.name + " made";
}

void Worker::submit(std::size_t node) {
  if (!chain_.runtime->enter(*chain_.activation)) return;  // whoever is in the way submits it again
  const std::uint64_t sequence = chain_.activation->sequence();
  const Placed& placed = chain_.chain()[node];
  record(XAUTO_EV_READY, placed, sequence);
  if (crew_ != nullptr) {
    const Ready job{this, node, key_of(placed)};
    if (t_home != nullptr && t_home->crew_ == crew_)
      t_home->lane_.push(job);
    else
      crew_->submit(job);
    return;
  }
  if (thread_->observed() || placed.fifo_priority > 0) thread_->announce(cpu_job(placed));
  wake(static_cast<std::uint32_t>(node) + 1);
}

void Worker::take(const Ready& job) {
  lane_.take(job);
  wake(1);
}

/// The mailbox is empty, or it says that the run is over.
void Worker::wake(std::uint32_t mail) {
  std::uint32_t empty = 0;
  if (mailbox_.compare_exchange_strong(empty, mail)) futex_wake_local(mailbox_, 1);
}

void Worker::skip(std::size_t position, std::uint64_t sequence) {
  if (port_) port_->skip(chain_.nodes[position].task, sequence);
  tell_ended(chain_.nodes[position], sequence);
}

void Worker::execute() {
  t_home = this;
  times_.before_jobs();
  for (;;) {
    const std::uint32_t mail = mailbox_.load(std::memory_order_acquire);
    if (mail == kQuit) return tell_moved();
    if (mail == 0) {
      times_.tell_cpu_time();
      futex_wait_local(mailbox_, 0);
      continue;
    }
    mailbox_.store(0, std::memory_order_release);
    if (crew_ == nullptr)
      run_chain(mail - 1, false);
    else
      execute_crew_job();
  }
}

void Worker::execute_crew_job() {
  for (std::optional<Ready> job = lane_.taken(); job;) {
    job->worker->run_chain(job->node, job->begun);
    run_lane();
    job = std::exchange(lane_.asked, false) ? std::nullopt : crew_->next(*this);
  }
}

/// A job of the last XNode of a module without outputs is over, and what is left is to account for it.
/// Whoever hears of that may bring the next job at once, and take this core for it: it is to find
/// this thread free, not to wake another one.
void Worker::ask_early() {
  Worker& home = *t_home;
  if (crew_ == nullptr || !home.lane_.empty()) return;
  if (const auto job = crew_->next(home))
    home.lane_.push(*job);
  else
    home.lane_.asked = true;
}

/// It has something to do after all. If it was chosen meanwhile, that job joins what waits here.
void Worker::withdraw() {
  lane_.asked = false;
  if (crew_->leave(*this)) return;
  std::uint32_t mail = 0;
  while ((mail = mailbox_.load(std::memory_order_acquire)) == 0) futex_wait_local(mailbox_, 0);
  if (mail == kQuit) return;
  mailbox_.store(0, std::memory_order_release);
  lane_.push(lane_.taken());
}

void Worker::run_lane() {
  while (!lane_.empty()) {
    if (lane_.asked) withdraw();
    const Ready job = lane_.pop();
    job.worker->run_chain(job.node, job.begun);
  }
}

/// Before the XPU is given away: whoever gets it next must be more urgent than what waits here. Which
/// of them that will be nobody knows, so from here on each has a thread of its own.
void Worker::show_lane() {
  for (const Ready& job : lane_.all()) {
    job.worker->begin(job.worker->chain_.chain()[job.node]);
    crew_->submit({job.worker, job.node, job.key, true});
  }
  lane_.clear();
}

/// Runs XNodes from `node` on as long as they are placed here and no older activation is in the way;
/// then hands over, or ends the activation.
void Worker::run_chain(std::size_t node, bool begun) {
  ModuleRuntime& module = *chain_.runtime;
  Activation& activation = *chain_.activation;
  const Placed* chain = chain_.chain();
  const std::size_t length = chain_.length();
  for (;; begun = false) {
    if (!run_job(chain, node, begun)) return module.finish(activation, false);
    if (++node == length) {
      if (!chain[length - 1].urgency.by_release()) {
        if (module.ends_inside()) ask_early();
        return module.finish(activation, true);
      }
      const std::int64_t due_ns = key_of(chain[length - 1]);
      const std::uint64_t sequence = activation.sequence();
      module.finish(activation, true);
      tell_ended(chain[length - 1], sequence);  // what it publishes is there
      if (const std::int64_t now = now_ns(); now > due_ns) module.missed(sequence, now - due_ns);
      return;
    }
    tell_ended(chain[node - 1], activation.sequence());
    module.pass(activation);
    Worker& next = *chain[node].worker;
    if (&next != this) return next.submit(node);
    if (!module.enter(activation)) return;
    if (crew_ != nullptr && !t_home->lane_.empty())
      return t_home->lane_.push({this, node, key_of(chain[node])});
  }
}

/// START, without waiting for what comes of it.
void Worker::begin(const Placed& placed, std::uint32_t held_us) {
  const std::uint64_t sequence = chain_.activation->sequence();
  const auto place = static_cast<std::uint64_t>(&placed - chain_.nodes.data());
  current_.store(place << kSequenceBits | sequence, std::memory_order_release);
  record(XAUTO_EV_START, placed, sequence, held_us);
  port_->begin({placed.task, sequence, key_of(placed)});
}

coord::Key Worker::key_of(const Placed& placed) const {
  if (placed.line != nullptr)
    if (const std::int64_t asked = placed.line->asked.load(std::memory_order_relaxed);
        asked != XNodeLine::kAsPlanned)
      return placed.urgency.asked(chain_.activation->origin_ns(), asked);
  return placed.urgency.key(chain_.activation->origin_ns(), chain_.activation->sequence(),
                            chain_.activation->urgent());
}

xpu::CpuJob Worker::cpu_job(const Placed& placed) const {
  const std::int64_t nominal = chain_.activation->origin_ns();
  const std::uint64_t n = chain_.activation->sequence();
  const bool urgent = chain_.activation->urgent();
  return {placed.task, n, key_of(placed) - placed.urgency.constant(),
          placed.urgency.holds() ? placed.urgency.hold(nominal, n, urgent) : 0,
          placed.fifo_priority};
}

/// Returns when the job's hold is over; or its planned start has come, or is not needed. And how long it slept, in us.
std::uint32_t Worker::hold_back(const Placed& placed) {
  const std::int64_t until = placed.urgency.hold(
      chain_.activation->origin_ns(), chain_.activation->sequence(), chain_.activation->urgent());
  const std::int64_t since = now_ns();
  const bool slept = options_.early == nullptr
                         ? sleep_until_ns(until)
                         : options_.early->wait(placed.xnode, {key_of(placed), until});
  if (!slept) return 0;
  const std::int64_t now = now_ns();
  if (!options_.backend.emulated && !backend_->on_thread())
    times_.overslept(std::max<std::int64_t>(0, now - until));
  return static_cast<std::uint32_t>(
      std::min<std::int64_t>((std::min(now, until) - since) / 1000, UINT32_MAX));
}

/// To those that may start when it has, before their planned start.
void Worker::tell_ended(const Placed& placed, std::uint64_t sequence) {
  if (options_.early != nullptr) options_.early->ended(placed.xnode, sequence);
}

bool Worker::run_job(const Placed* chain, std::size_t position, bool begun) {
  const Placed& placed = chain[position];
  Instance& here = *placed.here;
  const Input& input = chain_.activation->input();
  const bool observed = thread_->observed();
  if (placed.urgency.by_release())
    chain_.activation->set_due(key_of(placed), key_of(chain[chain_.length() - 1]));
  if (observed || placed.fifo_priority > 0) thread_->next(cpu_job(placed));
  // Told before: after the hold it is woken with this job's key.
  times_.overslept(0);
  const std::uint32_t held_us = placed.urgency.holds() ? hold_back(placed) : 0;
  if (port_) {
    if (!begun) begin(placed, held_us);
    port_->wait();
    if (port_->discipline() == Discipline::kLevels) take_level(placed);
    backend_->admitted(here.made.handle, !here.ran_once);
  }
  if (observed) {
    const std::int64_t since = now_ns();
    thread_->begin(since);
    thread_->has_xpu(since);
  }
  if (position == 0 && chain_.runtime->looks_first())
    chain_.runtime->begin(*chain_.activation, chain_.runtime->samples() ? now_ns() : 0);
  record(XAUTO_EV_RUN, placed, chain_.activation->sequence());
  const bool timed = times_.times(placed);
  if (timed) times_.begin(placed, chain_.activation->sequence());
  bool succeeded = false;
  try {
    if (Status status =
            placed.impl->exec(here.made.object.get(), chain_.activation->state(), input);
        status)
      succeeded = true;
    else
      note_failure(placed, status.error().to_string());
  } catch (const std::exception& e) {
    note_failure(placed, std::string("threw: ") + e.what());
  } catch (...) {
    note_failure(placed, "threw something that is no std::exception");
  }
  // The next job's key sets it again: nobody would see it later.
  if (!given_.cpus.empty() && sched_getscheduler(0) != given_.policy) tell_moved();
  if (timed) tell_without_core(placed, times_.end(placed));
  if (placed.limited && chain_.activation->abandoned()) succeeded = false;
  if (port_) {
    backend_->finishing(here.made.handle, !here.ran_once);
    here.ran_once = true;
    if (crew_ != nullptr && !t_home->lane_.empty() && port_->contended()) t_home->show_lane();
    port_->finish();
  }
  if (observed) {
    thread_->end();
    thread_->gave_xpu(now_ns());
  }
  record(XAUTO_EV_FINISH, placed, chain_.activation->sequence(), succeeded ? 0 : 1);
  if (succeeded && placed.ends_chain) chain_.runtime->passed(*chain_.activation, placed.node);
  return succeeded;
}

void Worker::tell_without_core(const Placed& placed, std::int64_t ns) {
  if (ns >= kWorthTellingNs)
    record(XAUTO_EV_NO_CORE, placed, chain_.activation->sequence(),
           static_cast<std::uint32_t>(std::min<std::int64_t>(ns / 1000, UINT32_MAX)));
}

/// Of the hardware, before anything is queued. The order is lost where that fails: it is counted.
void Worker::take_level(const Placed& placed) {
  const int level = port_->level();
  const Status taken = backend_->level(placed.here->made.handle, level);
  if (taken || options_.contexts == nullptr) return;
  if (options_.contexts->misplaced.fetch_add(1) > 0) return;
  log::warn("'{}' on {} cannot have priority level {}: {} (activation {}; more are only counted)",
            placed.name, xpu_name(), level, taken.error().to_string(),
            chain_.activation->sequence());
}

void Worker::write(std::uint16_t kind, const Placed& placed, std::uint64_t sequence,
                   std::uint32_t arg) {
  trace_->write(kind, sequence, static_cast<std::uint16_t>(placed.xnode),
                static_cast<std::uint16_t>(chain_.module), static_cast<std::uint16_t>(options_.xpu),
                arg);
}

void Worker::note_failure(const Placed& placed, const std::string& what) {
  const Guard lock(failure_mutex_);
  if (!failure_.empty()) return;  // counted by the engine; one is enough to read
  failure_ = "exec of XNode '" + placed.name + "' on " + xpu_name() + ": " + what;
  log::warn("{} (activation {} dropped; further failures here are only counted)", failure_,
            chain_.activation->sequence());
}

std::string Worker::first_failure() const {
  const Guard lock(failure_mutex_);
  return failure_;
}

}  // namespace xauto::runtime
