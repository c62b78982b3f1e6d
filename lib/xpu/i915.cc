// SPDX-License-Identifier: Apache-2.0
// Intel GPUs of i915: nobody suspends their work, this process says on which level it is.
#include "kernel/i915_contexts.h"
#include "xpu/driver_queues.h"

namespace xauto::xpu {
namespace {

class Levels final : public QueueDoor {
 public:
  Result<Handle> take(const kernel::QueueFile& file) override { return contexts_.take(file); }
  void give_back(Handle handle) override { contexts_.give_back(handle); }
  Status suspend(const std::vector<Handle>&) override {
    return fail(ErrorCode::kUnavailable, "i915 suspends nothing");
  }
  Status resume(const std::vector<Handle>&) override { return {}; }
  Status level(const std::vector<Handle>& handles, int level) override {
    for (const Handle handle : handles) XAUTO_TRY(contexts_.level(handle, level));
    return {};
  }
  bool gated(Handle) override { return false; }
  Status still_wanted() override { return {}; }

 private:
  kernel::I915Contexts contexts_;
};

}  // namespace

Result<std::unique_ptr<Backend>> make_i915(const XpuId& xpu) {
  if (kernel::i915_levels() < 2) return make_gate();
  if (!kernel::i915_is_watched())
    return fail(ErrorCode::kUnavailable, "nobody sees which contexts this process has on i915",
                xpu.name, kernel::kWatchHint);
  return over_door(xpu, kernel::QueueType::kI915Context, std::make_unique<Levels>());
}

}  // namespace xauto::xpu
