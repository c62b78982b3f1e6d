// SPDX-License-Identifier: Apache-2.0
// A worker's side of the run's maps (include/uapi/xauto/bpf.h): how an execution thread tells which
// job it runs, by stores into mapped memory. Without BPF the same stores go to ordinary memory and
// nobody looks, so that callers need not ask.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include <uapi/xauto/bpf.h>

#include <xauto/result.h>

#include "kernel/bpf_sys.h"

namespace xauto::kernel {

/// Of a job, for the scheduler.
struct Told {
  std::int64_t key = 0;        ///< what its release adds to its XNode's in the table
  std::uint64_t asked_ns = 0;  ///< 0: when the scheduler takes it up
};

/// One execution thread's slot. Who may call what is said at each; all are wait-free.
class ThreadSlot {
 public:
  ThreadSlot() = default;
  explicit ThreadSlot(xauto_bpf_slot* slot) : slot_(slot) {}

  /// The job that the thread runs next. By the thread itself between two jobs, or by whoever wakes
  /// it for its next one, before the wake-up. True: somebody waits for this CPU who may be more
  /// urgent than the new job, so the thread itself should yield.
  bool tell(std::uint32_t xnode, std::uint64_t sequence, const Told& told = {}) const {
    const __u64 word = XAUTO_BPF_JOB(xnode, sequence);
    // Whoever handed the job over has told it: it asked then.
    if (std::atomic_ref(slot_->job).load(std::memory_order_relaxed) != word) {
      std::atomic_ref(slot_->key).store(told.key, std::memory_order_relaxed);
      std::atomic_ref(slot_->asked_ns).store(told.asked_ns, std::memory_order_relaxed);
      // The exchange orders the store before the look; the scheduler does it the other way round.
      std::atomic_ref(slot_->job).store(word, std::memory_order_seq_cst);
    }
    return std::atomic_ref(slot_->waiting).load(std::memory_order_seq_cst) != 0;
  }
  /// For the accounting of trace and top; the thread itself.
  void begin(std::int64_t now_ns) const {
    std::atomic_ref(slot_->since_ns).store(static_cast<__u64>(now_ns), std::memory_order_relaxed);
    std::atomic_ref jobs(slot_->jobs);
    jobs.store(jobs.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }
  /// exec() has returned. The thread keeps the job's priority until it tells another one.
  void end() const {
    std::atomic_ref(slot_->job).fetch_or(XAUTO_BPF_JOB_ENDED, std::memory_order_release);
  }
  /// The job has the XPU, or no longer has it: by the execution or the management thread.
  void has_xpu(std::int64_t now_ns) const {
    std::atomic_ref(slot_->held_ns).store(static_cast<__u64>(now_ns), std::memory_order_relaxed);
  }
  void gave_xpu(std::int64_t now_ns) const {
    const __u64 since = std::atomic_ref(slot_->held_ns).exchange(0, std::memory_order_relaxed);
    if (since != 0 && static_cast<__u64>(now_ns) > since)
      std::atomic_ref(slot_->busy_ns)
          .fetch_add(static_cast<__u64>(now_ns) - since, std::memory_order_relaxed);
  }
  [[nodiscard]] std::uint32_t tid() const {
    return std::atomic_ref(slot_->tid).load(std::memory_order_acquire);
  }
  /// XNode of the job told last; -1: none yet.
  [[nodiscard]] int xnode() const {
    return static_cast<int>(std::atomic_ref(slot_->job).load(std::memory_order_acquire) >>
                            XAUTO_BPF_JOB_SHIFT) -
           1;
  }

 private:
  friend class ThreadSlots;
  xauto_bpf_slot* slot_ = nullptr;
};

class ThreadSlots {
 public:
  /// `slots_fd`, `threads_fd`: the run's maps.
  [[nodiscard]] static Result<ThreadSlots> attach(UniqueFd slots_fd, UniqueFd threads_fd);
  /// Memory of our own, for a run without BPF.
  [[nodiscard]] static ThreadSlots unobserved();

  /// One that nobody has, of any process of the run; when there are no more, one that nobody looks
  /// at.
  [[nodiscard]] ThreadSlot take(std::uint32_t xpu);
  /// The calling thread is the one of `slot` from now on: scheduler and tracer know it. Before its first
  /// job is told: the scheduler sees it without one, and so takes that job for no job of the slot's last
  /// thread, which may have had the same word.
  [[nodiscard]] Status enter(const ThreadSlot& slot) const;
  /// ... and no longer, before it ends. The slot may then be taken again.
  void leave(const ThreadSlot& slot) const;
  [[nodiscard]] bool observed() const { return static_cast<bool>(map_); }
  /// Number of the slot in the map; -1: it is not there.
  [[nodiscard]] int index(const ThreadSlot& slot) const;

 private:
  MappedMap map_;
  UniqueFd threads_;
  std::vector<std::unique_ptr<xauto_bpf_slot>> own_;
};

}  // namespace xauto::kernel
