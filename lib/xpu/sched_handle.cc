// SPDX-License-Identifier: Apache-2.0
#include "xpu/callbacks.h"
#include "xpu/contexts.h"

namespace xauto {

SchedHandle SchedHandle::custom(std::function<Status()> suspend, std::function<Status()> resume) {
  SchedHandle handle{Kind::kCustom, 0};
  handle.callbacks_ =
      std::make_shared<const Callbacks>(Callbacks{std::move(suspend), std::move(resume), {}});
  return handle;
}

SchedHandle SchedHandle::on_levels(std::function<Status(int)> take) {
  SchedHandle handle{Kind::kLevels, 0};
  handle.callbacks_ = std::make_shared<const Callbacks>(Callbacks{{}, {}, std::move(take)});
  return handle;
}

const char* SchedHandle::kind_name() const {
  switch (kind_) {
    case Kind::kGate:
      return "gate";
    case Kind::kThread:
      return "thread";
    case Kind::kCudaContext:
      return "cuda_context";
    case Kind::kCudlaDevice:
      return "cudla_device";
    case Kind::kEmulated:
      return "emulated";
    case Kind::kCustom:
      return "custom";
    case Kind::kLevels:
      return "on_levels";
  }
  return "?";
}

SchedHandle make_context(const std::function<SchedHandle()>& make) {
  xpu::Contexts::Making making(xpu::Contexts::of_this_process());
  SchedHandle handle = make();
  // Without a driver nothing has appeared. What failed here fails in `init`, which can say so.
  if (handle.kind() == SchedHandle::Kind::kCudaContext)
    for (const kernel::QueueType type : kernel::kGpuQueues)
      (void)making.made({type, -1}, handle.value());
  if (handle.kind() == SchedHandle::Kind::kCudlaDevice)
    for (const int instance : {0, 1})  // as kernel/device_nodes.h has them
      (void)making.made({kernel::QueueType::kDla, instance}, handle.value());
  return handle;
}

}  // namespace xauto
