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

#include <time.h>

#include <xauto/result.h>

#include "base/rt.h"
#include "coord/port.h"
#include "coord/rule.h"
#include "graph/graph.h"
#include "processes/board.h"
#include "runtime/crew.h"
#include "runtime/stopwatch.h"
#include "runtime/urgency.h"
#include "runtime/xmodule.h"
#include "session/limits.h"
#include "trace/trace.h"
#include "xpu/cpu_threads.h"
#include "xpu/kind.h"

namespace xauto::runtime {

class EarlyStart;
class HeldUp;

/// What an XNode's init has made on one XPU, shared by all tables that place it there. Of the worker's
/// execution thread.
struct Instance {
  detail::Made made;
  bool there = false;     ///< init has run
  bool ran_once = false;  ///< exec has
};

/// One XNode as a table places it: everything that its job needs, looked up once. What each job asks
/// for is in the first cache line.
struct alignas(64) Placed {
  Worker* worker = nullptr;
  const detail::ImplSpec* impl = nullptr;
  std::shared_ptr<Instance> here = std::make_shared<Instance>();
  std::uint32_t task = 0;   ///< as coordinators and BPF maps know it, see Session::task
  std::uint32_t table = 0;  ///< that places it so
  int fifo_priority = 0;    ///< SCHED_FIFO priority on a real CPU; 0: leave as it is
  bool limited = false;     ///< see `limit`
  bool watched = false;     ///< how long its jobs take decides which table is next
  bool ends_chain = false;  ///< a chain ends here, and not at the module's end
  Urgency urgency;
  std::uint32_t xnode = 0;  ///< index into app.json's xnodes
  int node = -1;            ///< index into the graph's nodes
  Limits limits;
  XNodeLine* line = nullptr;  ///< of the board
  std::string name;

  /// Its jobs are timed if they have limits, or are watched.
  void limit(const Limits& by, bool watch, XNodeLine& on) {
    limits = by;
    watched = watch;
    line = &on;
    limited = limits.any() || watched;
  }
};

/// The chain of one module as one of its activations runs through it, shared by its workers.
struct NodeRow {
  int module = -1;
  ModuleRuntime* runtime = nullptr;
  Activation* activation = nullptr;
  std::vector<Placed> nodes;  ///< the chain as the first table places it, then as the next one does
  std::size_t tables = 1;
  [[nodiscard]] std::size_t length() const { return nodes.size() / tables; }
  /// As the activation's table places it.
  [[nodiscard]] const Placed* chain() const {
    return tables == 1 ? nodes.data() : nodes.data() + activation->table() * length();
  }
};

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

  /// A job that has run past its hang limit, each once. One thread.
  struct Hung {
    const Placed* placed;
    std::uint64_t sequence;
    int module;
  };
  [[nodiscard]] std::optional<Hung> find_hung(std::int64_t now_ns);
  /// Counts a call that suspends or resumes as failed that has not returned for a second. Likewise.
  void tell_stuck_call(std::int64_t now_ns);
  /// Tells the board of the job that runs that it is past its WCET, if it is: it may never end. The thread of
  /// find_hung.
  void tell_past_wcet(std::int64_t now_ns);
  /// Tells the board if its thread, on a core, has other CPUs or another scheduling policy than it was given.
  /// Any thread.
  void tell_moved() const;
  /// Of its execution thread, from `start` on.
  [[nodiscard]] pid_t thread_id() const { return tid_; }
  /// The work of its jobs is that thread.
  [[nodiscard]] bool on_core() const { return backend_ && backend_->on_thread(); }
  /// Tells the board for how long the job that runs has had its XPU, if that is watched. Any thread.
  void tell_time(std::int64_t now_ns) const;

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
  [[nodiscard]] Status suspend(const Placed& placed);
  [[nodiscard]] Status resume(const Placed& placed, const SchedHandle& handle);
  void tell_failed(const Placed& placed, bool suspend, const std::string& why);
  void tell_held_up(const Placed& placed, std::uint64_t sequence, std::uint32_t who);
  [[nodiscard]] Status init_nodes();
  [[nodiscard]] bool may_share() const;
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
  void take_level(const Placed& placed);
  void write(std::uint16_t kind, const Placed& placed, std::uint64_t sequence, std::uint32_t arg);
  void note_failure(const Placed& placed, const std::string& what);
  void begin_timed(const Placed& placed, std::uint64_t sequence);
  [[nodiscard]] std::int64_t on_core_ns(const Placed& placed, std::int64_t wall_ns);
  void tell_waited(std::int64_t without_core_ns, XNodeLine& line);
  [[nodiscard]] std::int64_t so_far_ns(const Stopwatch::Look& seen, std::int64_t now_ns) const;
  [[nodiscard]] std::int64_t own_ns(std::int64_t ran_ns, std::int64_t now_ns) const;
  bool end_timed(const Placed& placed);
  void tell_cpu_time();

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
  bool holds_ = false;  ///< its XPU is held by jobs, and no CPU: for how long is counted
  /// 0: empty; kQuit; else chain position + 1, or anything if it belongs to a crew.
  std::atomic<std::uint32_t> mailbox_{0};
  std::vector<Ready> lane_;  ///< what became ready on its execution thread, and stays with it
  Ready taken_;              ///< of its execution thread, if it belongs to a crew
  bool asked_ = false;       ///< see ask_early
  std::thread exec_, mgmt_;
  std::atomic<bool> lost_{false};
  std::atomic<std::uint32_t> managed_{0};  ///< 1: the management thread is through; a futex
  /// What its backend is told to do, and for whom; null: nothing.
  std::atomic<const char*> call_{nullptr};
  std::atomic<const Placed*> call_for_{nullptr};
  std::atomic<std::int64_t> call_since_ns_{0};
  std::int64_t told_call_ns_ =
      0;  ///< of the thread of find_hung: the last one that was stuck began then
  /// 1: the execution thread takes no job any more; 2: it is through, too, with what its inits have
  /// made; a futex.
  std::atomic<std::uint32_t> ended_{0};
  Stopwatch watch_;                            ///< of the job that runs
  std::atomic<const Placed*> timed_{nullptr};  ///< whose job that is
  std::int64_t overslept_ns_ =
      0;  ///< for how long it slept after its hold; of real XPUs that it queues on
  std::atomic<std::uint64_t> hung_job_{0};  ///< the last one that find_hung found
  /// The last job that was told to be past its WCET while it ran; one more than a job: that one has ended.
  std::atomic<std::uint64_t> past_job_{0};
  std::atomic<std::int64_t> cpu_since_ns_{0};  ///< of the execution thread's CPU time
  /// At the begin of the job that runs; below 0: nobody counts it.
  std::atomic<std::int64_t> without_core_since_ns_{-1};
  std::int64_t cpu_told_ns_ = 0;  ///< ... what is on the board
  /// At the end of the job before: for how long it had waited for its core, and others had run there.
  std::int64_t waited_before_ns_ = 0, others_before_ns_ = 0;
  rt::Placement given_;                    ///< what it was given; set before its first init
  clockid_t cpu_clock_ = CLOCK_MONOTONIC;  ///< of the execution thread; set before its first job
  pid_t tid_ = 0;                          ///< likewise
  mutable PiMutex failure_mutex_;
  std::string failure_ XAUTO_GUARDED_BY(failure_mutex_);
};

}  // namespace xauto::runtime
