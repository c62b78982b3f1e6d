// SPDX-License-Identifier: Apache-2.0
// A real CPU core: the work of an XNode is its thread, and Linux suspends a thread by running a
// more urgent one (cpu_threads.h gives it the job's priority). So the coordinator admits every job
// at once, and nobody has a reason to call preempt.
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

class CpuThreadBackend final : public Backend {
 public:
  Status attach(const SchedHandle& handle) override { return check_thread(handle); }
  Status preempt(const SchedHandle&) override {
    return fail(ErrorCode::kUnavailable, "the kernel preempts threads, nobody else");
  }
  bool on_thread() const override { return true; }
  Status restore(const SchedHandle&) override { return {}; }
};

}  // namespace

Status check_thread(const SchedHandle& handle) {
  using Kind = SchedHandle::Kind;
  if (handle.kind() == Kind::kThread || handle.kind() == Kind::kGate) return {};
  return fail(ErrorCode::kInvalid, "the scheduling handle is no thread's", {},
              "a CPU implementation computes in `exec` and returns SchedHandle::thread()");
}

Result<std::unique_ptr<Backend>> make_cpu_thread(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<CpuThreadBackend>());
}

}  // namespace xauto::xpu
