// SPDX-License-Identifier: Apache-2.0
// GPUs and DLAs of nvgpu and nvdla, suspended by this process itself: without xauto.ko.
#include "kernel/own_queues.h"
#include "xpu/process_door.h"

namespace xauto::xpu {

Result<std::unique_ptr<Backend>> make_own_queue(const XpuId& xpu) {
  return over_door(xpu, std::make_unique<ProcessDoor<kernel::OwnQueues>>());
}

}  // namespace xauto::xpu
