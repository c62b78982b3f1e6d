// SPDX-License-Identifier: Apache-2.0
#include "xpu/cpu_threads.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <poll.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/first_line.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "kernel/bpf_sys.h"
#include "kernel/run_maps.h"

#ifndef SCHED_EXT
#define SCHED_EXT 7
#endif

namespace xauto::xpu {
namespace {

/// From any thread, for any thread.
bool set_fifo_of(int tid, int priority) {
  sched_param wanted{};
  wanted.sched_priority = priority;
  return sched_setscheduler(tid, SCHED_FIFO, &wanted) == 0;
}

std::string scx_state() {
  return first_line("/sys/kernel/sched_ext/state");
}

}  // namespace

// ---- one thread ---------------------------------------------------------------------------------

CpuThread::~CpuThread() {
  const Guard lock(all_.mutex_);
  std::erase(all_.threads_, this);
}

Status CpuThread::enter(bool scheduled, int fifo) {
  scheduled_ = scheduled;
  if (scheduled && (fifo > 0 || all_.ext())) rt::leave_huge_pages();
  fifo_wanted_.store(fifo);
  tid_.store(gettid());
  if (!(scheduled && all_.ext())) {
    if (fifo > 0) XAUTO_TRY(rt::set_fifo(fifo));
    fifo_now_ = fifo;
  } else {
    // Full mode: an ordinary thread is the scheduler's. Partial mode: only one that asks is.
    const int wanted = all_.partial_ ? SCHED_EXT : SCHED_OTHER;
    const sched_param none{};
    if (syscall(SYS_sched_setscheduler, 0, wanted, &none) != 0 || sched_getscheduler(0) != wanted)
      return fail(ErrorCode::kUnavailable,
                  std::string("SCHED_EXT was not set: ") + strerror(errno));
    if (const std::string state = scx_state(); state != "enabled" && all_.ext())
      return fail(ErrorCode::kUnavailable, "sched_ext is '" + state + "', not enabled");
  }
  return all_.slots_.enter(slot_);
}

void CpuThread::leave() {
  tid_.store(0);
  all_.slots_.leave(slot_);
}

/// Only sched_ext looks at more than the job, so the clock is read for nobody else.
bool CpuThread::tell(const CpuJob& job) const {
  const std::uint32_t xnode = all_.first_xnode_ + job.xnode;
  if (!(scheduled_ && all_.ext())) return slot_.tell(xnode, job.sequence);
  const std::int64_t asked = std::max(now_ns(), job.not_before_ns);
  return slot_.tell(xnode, job.sequence, {job.key, static_cast<std::uint64_t>(asked)});
}

void CpuThread::announce(const CpuJob& job) {
  if (job.fifo > 0) fifo_wanted_.store(job.fifo, std::memory_order_seq_cst);
  (void)tell(job);
  const int tid = tid_.load();
  if (tid == 0 || job.fifo <= 0 || (scheduled_ && all_.ext()) || job.fifo == fifo_now_) return;
  // The thread is idle, and its wake-up comes after this: fifo_now_ is ours meanwhile.
  if (set_fifo_of(tid, job.fifo)) fifo_now_ = job.fifo;
}

void CpuThread::next(const CpuJob& job) {
  const int fifo = job.fifo;
  if (fifo > 0) fifo_wanted_.store(fifo, std::memory_order_seq_cst);
  const bool waited_for = tell(job);
  if (scheduled_ && all_.ext()) {
    // Somebody waits for this CPU who may now be more urgent; the kernel compares.
    if (waited_for) sched_yield();
    return;
  }
  if (fifo > 0 && fifo != fifo_now_ && rt::set_fifo(fifo)) fifo_now_ = fifo;
}

void CpuThread::fall_back() {
  const int tid = tid_.load();
  if (tid == 0 || !scheduled_) return;
  // The thread may go to its next job meanwhile and set that one's priority: then ours was too
  // late.
  int wanted = fifo_wanted_.load();
  for (int again = 0; again < 8 && wanted > 0; ++again) {
    if (!set_fifo_of(tid, wanted)) return;
    const int now = fifo_wanted_.load();
    if (now == wanted) return;
    wanted = now;
  }
}

// ---- all of them --------------------------------------------------------------------------------

Result<std::unique_ptr<CpuThreads>> CpuThreads::create(const CpuThreadsOptions& options) {
  auto threads = std::unique_ptr<CpuThreads>(new CpuThreads());
  threads->slots_ = kernel::ThreadSlots::unobserved();
  if (options.run.empty()) return threads;
  const std::string folder = kernel::RunMaps::folder(options.run);
  auto slots = kernel::open_pinned_map(folder + "/slots");
  auto entries = kernel::open_pinned_map(folder + "/threads");
  Result<kernel::ThreadSlots> observed =
      !slots     ? tl::unexpected<Error>(slots.error())
      : !entries ? tl::unexpected<Error>(entries.error())
                 : kernel::ThreadSlots::attach(std::move(*slots), std::move(*entries));
  if (!observed) {
    // Tracing is a convenience, scheduling is not.
    if (options.scheduler_pid != 0) return tl::unexpected<Error>(observed.error());
    log::debug("not observed: {}", observed.error().to_string());
    return threads;
  }
  threads->slots_ = std::move(*observed);
  threads->first_xnode_ = options.first_xnode;
  if (options.scheduler_pid == 0) return threads;
  threads->partial_ = options.partial;
  threads->scheduler_.reset(static_cast<int>(syscall(SYS_pidfd_open, options.scheduler_pid, 0)));
  threads->quit_.reset(eventfd(0, EFD_CLOEXEC));
  threads->ext_.store(static_cast<bool>(threads->scheduler_));
  if (!threads->ext()) {
    const Guard lock(threads->mutex_);
    threads->note_ = "the sched_ext scheduler had ended before the app began: SCHED_FIFO instead";
    return threads;
  }
  XAUTO_ASSIGN(threads->watcher_, start_thread([all = threads.get()] { all->watch(); }));
  return threads;
}

CpuThreads::~CpuThreads() {
  if (watcher_.joinable()) {
    const std::uint64_t one = 1;
    (void)!write(quit_.get(), &one, sizeof one);
    watcher_.join();
  }
}

std::unique_ptr<CpuThread> CpuThreads::add(std::uint32_t xpu) {
  const Guard lock(mutex_);
  auto thread = std::unique_ptr<CpuThread>(new CpuThread(*this, slots_.take(xpu)));
  threads_.push_back(thread.get());
  return thread;
}

std::string CpuThreads::note() const {
  const Guard lock(mutex_);
  return note_;
}

/// Sleeps until the loader ends. Its end is also the scheduler's, whichever came first.
void CpuThreads::watch() {
  rt::set_thread_name("xauto/cpusched");
  constexpr int kAboveJobs = 55;
  (void)rt::set_fifo_up_to(kAboveJobs);
  pollfd fds[2] = {{scheduler_.get(), POLLIN, 0}, {quit_.get(), POLLIN, 0}};
  while (poll(fds, 2, -1) < 0 && errno == EINTR) {
  }
  if ((fds[1].revents & POLLIN) != 0) return;
  ext_.store(false, std::memory_order_seq_cst);
  const Guard lock(mutex_);
  for (CpuThread* thread : threads_) thread->fall_back();
  note_ = "the sched_ext scheduler ended: CPU XNodes went on under SCHED_FIFO";
  log::warn("{}", note_);
}

}  // namespace xauto::xpu
