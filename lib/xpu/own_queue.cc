// SPDX-License-Identifier: Apache-2.0
// GPUs and DLAs of nvgpu and nvdla, suspended by this process itself: without xauto.ko, so nobody
// resumes what a process has suspended that hangs.
#include "kernel/own_queues.h"
#include "xpu/driver_queues.h"

namespace xauto::xpu {
namespace {

class Own final : public QueueDoor {
 public:
  Result<Handle> take(const kernel::QueueFile& file) override { return queues_.take(file); }
  void give_back(Handle handle) override { queues_.give_back(handle); }
  Status suspend(const std::vector<Handle>& handles) override {
    for (const Handle handle : handles) XAUTO_TRY(queues_.suspend(handle));
    return {};
  }
  /// All of them: nobody else would resume the rest.
  Status resume(const std::vector<Handle>& handles) override {
    Status done;
    for (const Handle handle : handles)
      if (Status one = queues_.resume(handle); !one) done = std::move(one);
    return done;
  }
  bool gated(Handle handle) override { return queues_.gated(handle); }
  Status still_wanted() override {
    queues_.again();
    return {};
  }
  int again_ms() const override { return kernel::OwnQueues::kAgainMs; }
  bool owes() const override { return queues_.owes(); }

 private:
  kernel::OwnQueues queues_;
};

}  // namespace

Result<std::unique_ptr<Backend>> make_own_queue(const XpuId& xpu) {
  return over_door(xpu, std::make_unique<Own>());
}

}  // namespace xauto::xpu
