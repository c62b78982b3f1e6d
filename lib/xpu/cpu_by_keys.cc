// SPDX-License-Identifier: Apache-2.0
// A real CPU core in a run by keys. Linux has fixed priorities, and a key is none; so the core is
// like any other preemptive XPU: one job is admitted, at a high SCHED_FIFO priority, and the thread
// of the one that it takes the core from is lowered below all that are admitted. It so runs only
// while nobody else on this core wants to.
#include <cerrno>
#include <cstring>
#include <string>

#include <sched.h>
#include <unistd.h>

#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

class CpuByKeys final : public Backend {
 public:
  Status attach(const SchedHandle& handle) override {
    using Kind = SchedHandle::Kind;
    if (handle.kind() != Kind::kThread && handle.kind() != Kind::kGate)
      return fail(ErrorCode::kInvalid, "the scheduling handle is no thread's", {},
                  "a CPU implementation computes in `exec` and returns SchedHandle::thread()");
    tid_ = gettid();
    return {};
  }
  /// The execution thread's own priority, whatever that is now, is what `restore` gives back.
  Status preempt(const SchedHandle&) override {
    sched_param now{};
    if (sched_getparam(tid_, &now) != 0) return failed("sched_getparam");
    if (now.sched_priority <= kSuspended) return {};  // said twice
    admitted_ = now.sched_priority;
    return set(kSuspended);
  }
  Status restore(const SchedHandle&) override { return admitted_ > 0 ? set(admitted_) : Status(); }
  bool on_thread() const override { return true; }

 private:
  static constexpr int kSuspended = 1;

  Status set(int priority) const {
    sched_param wanted{};
    wanted.sched_priority = priority;
    return sched_setscheduler(tid_, SCHED_FIFO, &wanted) == 0 ? Status()
                                                              : failed("sched_setscheduler");
  }
  static Status failed(const char* call) {
    return fail(ErrorCode::kUnavailable, std::string(call) + ": " + strerror(errno));
  }

  pid_t tid_ = 0;     ///< by the execution thread, before any command
  int admitted_ = 0;  ///< of the management thread
};

}  // namespace

Result<std::unique_ptr<Backend>> make_cpu_by_keys(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<CpuByKeys>());
}

}  // namespace xauto::xpu
