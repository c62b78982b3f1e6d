// SPDX-License-Identifier: Apache-2.0
// GPUs of NVIDIA's RM driver, suspended by this process itself.
#include "kernel/rm_queues.h"
#include "xpu/process_door.h"

namespace xauto::xpu {

Result<std::unique_ptr<Backend>> make_rm(const XpuId& xpu) {
  if (!kernel::rm_is_watched())
    return fail(ErrorCode::kUnavailable,
                "nobody sees which channels this process has on NVIDIA's RM driver", xpu.name,
                kernel::kWatchHint);
  return over_door(xpu, kernel::QueueType::kRmGroup,
                   std::make_unique<ProcessDoor<kernel::RmQueues>>());
}

}  // namespace xauto::xpu
