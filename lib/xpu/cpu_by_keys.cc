// SPDX-License-Identifier: Apache-2.0
// A real CPU core in a run by keys. Linux has fixed priorities, and a key is none; so the core is
// like any other preemptive XPU: one job is admitted, the others wait or are lowered.
//
//   asks      who says START or FINISH, so that a running job cannot keep it from that
//   admitted  the one that has the core
//   lowered   who had it; runs only while nobody else on this core wants to
#include <cerrno>
#include <cstring>
#include <string>

#include <sched.h>
#include <unistd.h>

#include "base/pi_mutex.h"
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

class CpuByKeys final : public Backend {
 public:
  Status attach(const SchedHandle& handle) override {
    XAUTO_TRY(check_thread(handle));
    tid_ = gettid();
    return {};
  }
  Status preempt(const SchedHandle&) override {
    const Guard lock(mutex_);
    lowered_ = true;
    return runs_ ? set(kCpuLowered) : Status();
  }
  Status restore(const SchedHandle&) override {
    const Guard lock(mutex_);
    lowered_ = false;
    return runs_ ? set(kCpuAdmitted) : Status();
  }
  /// From asking to running, unless somebody has taken the core meanwhile.
  void admitted(const SchedHandle&, bool) override {
    const Guard lock(mutex_);
    runs_ = true;
    (void)set(lowered_ ? kCpuLowered : kCpuAdmitted);
  }
  /// What follows is short, and others wait for it: the result, the next XNode's START.
  void finishing(const SchedHandle&, bool) override {
    const Guard lock(mutex_);
    runs_ = false;
    (void)set(kCpuAsks);
  }
  bool on_thread() const override { return true; }

 private:
  Status set(int priority) const {
    sched_param wanted{};
    wanted.sched_priority = priority;
    return sched_setscheduler(tid_, SCHED_FIFO, &wanted) == 0
               ? Status()
               : fail(ErrorCode::kUnavailable,
                      std::string("sched_setscheduler: ") + strerror(errno));
  }

  pid_t tid_ = 0;  ///< by the execution thread, before any command
  PiMutex mutex_;  ///< a lowered thread must not hold up the management thread
  bool lowered_ XAUTO_GUARDED_BY(mutex_) = false;
  bool runs_ XAUTO_GUARDED_BY(mutex_) = false;  ///< a job that was admitted
};

}  // namespace

Result<std::unique_ptr<Backend>> make_cpu_by_keys(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<CpuByKeys>());
}

}  // namespace xauto::xpu
