// SPDX-License-Identifier: Apache-2.0
// GPUs and DLAs of nvgpu and nvdla, suspended by xauto.ko: whatever becomes of this process.
#include "kernel/queue_control.h"
#include "xpu/driver_queues.h"

namespace xauto::xpu {
namespace {

class Module final : public QueueDoor {
 public:
  explicit Module(kernel::QueueControl control) : control_(std::move(control)) {}

  Result<Handle> take(const kernel::QueueFile& file) override {
    XAUTO_ASSIGN(const kernel::RegisteredQueue queue, control_.register_queue(file.type, file.fd));
    return queue.handle;
  }
  void give_back(Handle handle) override { (void)control_.unregister(handle); }
  Status suspend(const std::vector<Handle>& handles) override {
    return all(handles, XAUTO_ACTION_SUSPEND);
  }
  Status resume(const std::vector<Handle>& handles) override {
    return all(handles, XAUTO_ACTION_RESUME);
  }
  bool gated(Handle handle) override {
    const auto info = control_.query(handle);
    return info && info->gated;
  }
  Status still_wanted() override { return control_.feed_watchdog(); }

 private:
  Status all(const std::vector<Handle>& handles, xauto_action action) {
    ops_.clear();
    for (const Handle handle : handles) ops_.push_back({action, handle, 0});
    return control_.control(ops_);
  }

  kernel::QueueControl control_;
  std::vector<kernel::QueueOp> ops_;
};

}  // namespace

Result<std::unique_ptr<Backend>> make_kernel_queue(const XpuId& xpu) {
  XAUTO_ASSIGN(kernel::QueueControl control, kernel::QueueControl::open());
  return over_door(xpu, std::make_unique<Module>(std::move(control)));
}

}  // namespace xauto::xpu
