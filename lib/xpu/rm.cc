// SPDX-License-Identifier: Apache-2.0
// GPUs of NVIDIA's RM driver, suspended by this process itself; like own_queue.cc, so nobody resumes
// what a process has suspended that hangs.
#include "kernel/rm_queues.h"
#include "xpu/driver_queues.h"

namespace xauto::xpu {
namespace {

class Rm final : public QueueDoor {
 public:
  Result<Handle> take(const kernel::QueueFile& file) override { return queues_.take(file); }
  void give_back(Handle handle) override { queues_.give_back(handle); }
  Status suspend(const std::vector<Handle>& handles) override { return queues_.suspend(handles); }
  Status resume(const std::vector<Handle>& handles) override { return queues_.resume(handles); }
  bool gated(Handle handle) override { return queues_.gated(handle); }
  Status still_wanted() override {
    queues_.again();
    return {};
  }
  int again_ms() const override { return 50; }
  bool owes() const override { return queues_.owes(); }

 private:
  kernel::RmQueues queues_;
};

}  // namespace

Result<std::unique_ptr<Backend>> make_rm(const XpuId& xpu) {
  if (!kernel::rm_is_watched())
    return fail(ErrorCode::kUnavailable,
                "nobody sees which channels this process has on NVIDIA's RM driver", xpu.name,
                "start it with LD_PRELOAD=libxauto_watch.so, or link it with -lxauto_watch");
  return over_door(xpu, kernel::QueueType::kRmGroup, std::make_unique<Rm>());
}

}  // namespace xauto::xpu
