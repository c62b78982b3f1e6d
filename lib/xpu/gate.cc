// SPDX-License-Identifier: Apache-2.0
// XPUs without preemption: the coordinator's gate discipline admits one job at a time, so nobody
// has a reason to call this.
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

class Gate final : public Backend {
 public:
  Status preempt(const SchedHandle&) override {
    return fail(ErrorCode::kUnavailable, "this XPU cannot be preempted");
  }
  Status restore(const SchedHandle&) override { return {}; }
};

}  // namespace

Result<std::unique_ptr<Backend>> make_gate() {
  return std::unique_ptr<Backend>(std::make_unique<Gate>());
}

}  // namespace xauto::xpu
