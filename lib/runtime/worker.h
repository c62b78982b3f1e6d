// SPDX-License-Identifier: Apache-2.0
// Life of a job, steps 3, 4, 6, 9: the worker of one (XModule, XPU instance). Its execution thread
// runs the jobs of that module's XNodes on that XPU; its management thread suspends and resumes
// what the execution thread has queued, when a more urgent job or the coordinator says so.
//
// Consecutive XNodes on one XPU run in the same execution thread without a hand-over. A worker serves
// one activation at a time, so at most one job waits: the mailbox is one word. A module that may have
// several in flight has so many workers on an XPU, each with what its inits made.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/rt.h"
#include "coord/port.h"
#include "coord/rule.h"
#include "processes/board.h"
#include "runtime/call_watch.h"
#include "runtime/crew.h"
#include "runtime/job_times.h"
#include "runtime/placed.h"
#include "runtime/xmodule.h"
#include "trace/trace.h"
#include "xpu/cpu_threads.h"
#include "xpu/kind.h"

namespace xauto::runtime {

class EarlyStart;
class HeldUp;

struct WorkerOptions {
  std::string name;             ///< "fcd@gpu0"
  int xpu = -1;                 ///< index into Platform::xpus
  xpu::BackendRequest backend;  ///< how its work is suspended
  std::int64_t preempt_ns = 0;  ///< what the platform says that taking the XPU from another costs
  std::optional<int> core;      ///< pin the execution thread here
  int exec_fifo = 0;            ///< SCHED_FIFO priority of the execution thread; 0: SCHED_OTHER
  int mgmt_fifo = 0;
  std::string coordinator;  ///< abstract socket; empty: nobody schedules
  coord::OrderPairs order;
  ContextCounts* contexts = nullptr;  ///< on the board, which outlives the worker
  XpuLine* counts = nullptr;          ///< likewise, of its XPU; null: nobody can look at it
  const HeldUp* held_up = nullptr;    ///< null: nobody looks at what its jobs hold up
  EarlyStart* early = nullptr;        ///< null: holds are waited for to their end
};

class Worker {
 public:
  /// `trace` may be null. The chain and `threads` must outlive the worker.
  Worker(WorkerOptions options, NodeRow& chain, trace::Writer* trace, xpu::CpuThreads& threads);
  ~Worker();
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  /// Where its XPU takes one job at a time: the threads that may run its jobs. Before `start`.
  void share(Crew& crew) { crew_ = &crew; }
  /// Starts both threads, registers with the coordinator, and runs `init` of each XNode placed
  /// here, on the execution thread. Errors name the XNode.
  [[nodiscard]] Status start();
  /// Waits for the running job, ends both threads. Idempotent. False: its exec has not returned
  /// within `patience_ns`, or what an `init` has made is not destroyed 10 s later. Nothing can end
  /// it but the end of the process, so its thread is left behind; this object must then outlive the
  /// process. So it is with a call that suspends or resumes, which may be the app's, a second later.
  bool stop(std::int64_t patience_ns = INT64_MAX);

  /// It still takes jobs, or is at one.
  [[nodiscard]] bool in_exec() const { return ended_.load() == 0; }
  /// Of one that has stopped, or did not in time: a call that suspends or resumes and does not return, for people;
  /// empty: there is none.
  [[nodiscard]] std::string stuck_call() const;
  /// Of one that did not stop in time: what does not return, likewise.
  [[nodiscard]] std::string stuck_in() const;

  /// How long its jobs have had their XPU.
  [[nodiscard]] JobTimes& times() { return times_; }
  /// Counts a call that suspends or resumes as failed that has not returned for a second. One thread.
  void tell_stuck_call(std::int64_t now_ns);
  /// Tells the board if its thread, on a core, has other CPUs or another scheduling policy than it was given.
  /// Any thread.
  void tell_moved() const;
  /// The work of its jobs is its execution thread.
  [[nodiscard]] bool on_core() const { return backend_ && backend_->on_thread(); }
  /// On its XPU jobs of other runs are admitted, too.
  [[nodiscard]] bool shares() const { return port_ && port_->shared(); }
  [[nodiscard]] coord::Neighbours neighbours() const { return port_->neighbours(); }
  /// Index into Graph::modules.
  [[nodiscard]] int module() const { return chain_.module; }

  /// Hands over the activation: run from chain position `node` on. Any thread; must not be
  /// called again before that job has left this worker.
  void submit(std::size_t node);

  /// The crew's choice: this thread, which has nothing to do, runs the job.
  void take(const Ready& job);

  /// Activations of XNode `position` of the chain up to `sequence` will not come.
  void skip(std::size_t position, std::uint64_t sequence);

  [[nodiscard]] bool lost_coordinator() const { return lost_.load(std::memory_order_relaxed); }
  [[nodiscard]] const WorkerOptions& options() const { return options_; }
  /// "gpu0"
  [[nodiscard]] const std::string& xpu_name() const { return options_.backend.id.name; }
  /// The first failure of an exec here, for the report; empty if none.
  [[nodiscard]] std::string first_failure() const;

 private:
  void execute();
  void execute_crew_job();
  void ask_early();
  void withdraw();
  void manage();
  struct Suspended;
  void carry_out_suspend(std::optional<Suspended>& suspended);
  void carry_out_resume(std::optional<Suspended>& suspended);
  void look_at_suspended(std::optional<Suspended>& suspended, int again_ms);
  void let_run_alone(std::optional<Suspended>& suspended);
  [[nodiscard]] Status suspend(const Placed& placed);
  [[nodiscard]] Status resume(const Placed& placed, const SchedHandle& handle);
  void tell_failed(const Placed& placed, bool suspend, const std::string& why);
  void tell_held_up(const Placed& placed, std::uint64_t sequence, std::uint32_t who);
  [[nodiscard]] Status init_nodes();
  [[nodiscard]] bool may_share() const;
  [[nodiscard]] int levels_here() const;
  void destroy_objects(bool ran);
  void run_chain(std::size_t node, bool begun);
  bool run_job(const Placed* chain, std::size_t position, bool begun);
  [[nodiscard]] std::uint32_t hold_back(const Placed& placed);
  void tell_ended(const Placed& placed, std::uint64_t sequence);
  void begin(const Placed& placed, std::uint32_t held_us = 0);
  [[nodiscard]] coord::Key key_of(const Placed& placed) const;
  [[nodiscard]] xpu::CpuJob cpu_job(const Placed& placed) const;
  void wake(std::uint32_t mail);
  void run_lane();
  void show_lane();
  void record(std::uint16_t kind, const Placed& placed, std::uint64_t sequence,
              std::uint32_t arg = 0) {
    if (trace_ != nullptr) write(kind, placed, sequence, arg);
  }
  void tell_without_core(const Placed& placed, std::int64_t ns);
  void take_level(const Placed& placed);
  void write(std::uint16_t kind, const Placed& placed, std::uint64_t sequence, std::uint32_t arg);
  void note_failure(const Placed& placed, const std::string& what);

  static thread_local Worker* t_home;  ///< whose execution thread this is

  WorkerOptions options_;
  // Each job asks for these.
  alignas(64) Crew* crew_ = nullptr;  ///< who may run its jobs; null: its own thread alone
  NodeRow& chain_;
  trace::Writer* trace_;
  std::unique_ptr<xpu::CpuThread> thread_;  ///< how the execution thread gets its CPU
  std::unique_ptr<coord::Port> port_;
  std::unique_ptr<xpu::Backend> backend_;
  /// The job whose queue the management thread acts on, in one word: its place in NodeRow::nodes above
  /// kSequenceBits, its activation's number below.
  std::atomic<std::uint64_t> current_{0};
  static constexpr int kSequenceBits = 48;
  /// 0: empty; kQuit; else chain position + 1, or anything if it belongs to a crew.
  std::atomic<std::uint32_t> mailbox_{0};
  Lane lane_;  ///< of its execution thread, if it belongs to a crew
  std::thread exec_, mgmt_;
  std::atomic<bool> lost_{false};
  std::atomic<std::uint32_t> managed_{0};  ///< 1: the management thread is through; a futex
  CallWatch calls_;
  /// 1: the execution thread takes no job any more; 2: it is through, too, with what its inits have
  /// made; a futex.
  std::atomic<std::uint32_t> ended_{0};
  JobTimes times_;
  rt::Placement given_;  ///< what it was given; set before its first init
  mutable PiMutex failure_mutex_;
  std::string failure_ XAUTO_GUARDED_BY(failure_mutex_);
};

}  // namespace xauto::runtime
