// SPDX-License-Identifier: Apache-2.0
// AMD GPUs of amdkfd, suspended by this process itself.
#include "kernel/kfd_queues.h"
#include "xpu/process_door.h"

namespace xauto::xpu {

Result<std::unique_ptr<Backend>> make_kfd(const XpuId& xpu) {
  if (!kernel::kfd_is_watched())
    return fail(ErrorCode::kUnavailable, "nobody sees which queues this process has on amdkfd",
                xpu.name, kernel::kWatchHint);
  return over_door(xpu, kernel::QueueType::kKfdQueue,
                   std::make_unique<ProcessDoor<kernel::KfdQueues>>());
}

}  // namespace xauto::xpu
