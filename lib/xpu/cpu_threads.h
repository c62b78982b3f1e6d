// SPDX-License-Identifier: Apache-2.0
// How the execution threads of one process get their CPU: as XNode threads of the sched_ext
// scheduler, by SCHED_FIFO, or as ordinary threads. The worker says which job comes next, with its
// key and its priority, and does not know which of the three it is. If the scheduler goes, its threads go on under SCHED_FIFO at
// once.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"
#include "kernel/thread_slots.h"

namespace xauto::xpu {

struct CpuThreadsOptions {
  std::string run;                ///< of the maps below /sys/fs/bpf/xauto; empty: nobody observes
  std::uint32_t first_xnode = 0;  ///< number of XNode 0 in those maps
  int scheduler_pid = 0;          ///< of xauto-cpusched; 0: no sched_ext
  bool partial = false;           ///< threads must ask for SCHED_EXT
};

class CpuThreads;

struct CpuJob {
  std::uint32_t xnode = 0;
  std::uint64_t sequence = 0;
  std::int64_t key = 0;            ///< for sched_ext: what its release adds (kernel::Told)
  std::int64_t not_before_ns = 0;  ///< it asks for the CPU no earlier
  int fifo = 0;                    ///< its SCHED_FIFO priority, used without sched_ext; 0: leave it
};

/// One execution thread. `announce` by whoever hands it a job while it has none; the others by the
/// thread itself, `hold` and `release` also by its management thread.
class CpuThread {
 public:
  ~CpuThread();
  /// Begins: the calling thread is it. `scheduled`: it runs XNodes of a real CPU. `fifo`: its
  /// SCHED_FIFO priority where sched_ext does not schedule it; 0: ordinary. What was set is read
  /// back.
  [[nodiscard]] Status enter(bool scheduled, int fifo);
  void leave();

  // What follows does nothing where nobody observes and a job has no SCHED_FIFO priority.
  /// The next job, before the thread is woken for it: so that it is woken with that job's priority,
  /// not with its last one's.
  void announce(const CpuJob& job);
  /// What it will most likely run first, so that it has a key before its first job.
  void expect(std::uint32_t xnode, std::int64_t key) const;
  /// The next job, now.
  void next(const CpuJob& job);
  /// Whether anybody sees the following: without BPF, nobody.
  [[nodiscard]] bool observed() const;
  void begin(std::int64_t now_ns) const { slot_.begin(now_ns); }
  void end() const { slot_.end(); }
  void has_xpu(std::int64_t now_ns) const { slot_.has_xpu(now_ns); }
  void gave_xpu(std::int64_t now_ns) const { slot_.gave_xpu(now_ns); }

 private:
  friend class CpuThreads;
  CpuThread(CpuThreads& all, kernel::ThreadSlot slot) : all_(all), slot_(slot) {}
  void fall_back();  // by the watching thread
  [[nodiscard]] bool tell(const CpuJob& job) const;

  CpuThreads& all_;
  kernel::ThreadSlot slot_;
  std::atomic<int> tid_{0};
  std::atomic<int> fifo_wanted_{0};  ///< of the present job
  int fifo_now_ = 0;                 ///< the thread's own view
  bool scheduled_ = false;
};

class CpuThreads {
 public:
  [[nodiscard]] static Result<std::unique_ptr<CpuThreads>> create(const CpuThreadsOptions& options);
  ~CpuThreads();
  CpuThreads(const CpuThreads&) = delete;
  CpuThreads& operator=(const CpuThreads&) = delete;

  /// `xpu`: index into the platform. Must not outlive this object.
  [[nodiscard]] std::unique_ptr<CpuThread> add(std::uint32_t xpu);
  /// sched_ext schedules now.
  [[nodiscard]] bool ext() const { return ext_.load(std::memory_order_seq_cst); }
  /// For the report: that and when the scheduler went; empty if it did not.
  [[nodiscard]] std::string note() const;

 private:
  friend class CpuThread;
  CpuThreads() = default;
  void watch();

  std::atomic<bool> ext_{false};
  bool partial_ = false;
  std::uint32_t first_xnode_ = 0;
  UniqueFd scheduler_, quit_;  ///< pidfd; eventfd
  std::thread watcher_;
  mutable PiMutex mutex_;
  std::vector<CpuThread*> threads_ XAUTO_GUARDED_BY(mutex_);
  std::string note_ XAUTO_GUARDED_BY(mutex_);
  kernel::ThreadSlots slots_;
};

inline void CpuThread::expect(std::uint32_t xnode, std::int64_t key) const {
  (void)slot_.tell(all_.first_xnode_ + xnode, XAUTO_BPF_JOB_EXPECTED, {key, 0});
}

inline bool CpuThread::observed() const {
  return all_.slots_.observed();
}

}  // namespace xauto::xpu
