// SPDX-License-Identifier: Apache-2.0
// Device nodes of the drivers. NVIDIA's for Jetsons by generation: JetPack 6 first, then JetPack 5.
#pragma once

#include "kernel/kfd.h"
#include "kernel/rm.h"

namespace xauto::kernel {

inline constexpr const char* kNvgpuFolder = "/dev/nvgpu/";
inline constexpr const char* kOldTsgNode = "/dev/nvhost-tsg-gpu";
inline constexpr const char* kGpuNodes[] = {"/dev/nvgpu/igpu0/tsg", kOldTsgNode};
inline constexpr const char* kGpuSchedNodes[] = {"/dev/nvgpu/igpu0/sched", "/dev/nvhost-sched-gpu"};
inline constexpr const char* kDlaPrefixes[] = {"/dev/nvhost-ctrl-nvdla", "/dev/nvdla"};
inline constexpr const char* kDlaNodes[] = {"/dev/nvhost-ctrl-nvdla0", "/dev/nvhost-ctrl-nvdla1",
                                            "/dev/nvdla0", "/dev/nvdla1"};
/// A VIC is a device of the host1x bus, of Xavier and Orin at this address.
inline constexpr const char* kVicNodes[] = {"/sys/bus/platform/devices/15340000.vic"};
inline constexpr const char* kPvaNodes[] = {"/dev/nvhost-ctrl-pva0", "/dev/nvhost-ctrl-pva1"};
/// NVIDIA's RM driver has one for all GPUs. A Jetson's display may have it beside nvgpu.
inline constexpr const char* kRmNodes[] = {rm::kControlNode};
/// amdkfd likewise.
inline constexpr const char* kKfdNodes[] = {kfd::kNode};
/// i915's nodes look like any driver's; its integrated GPU is always this device.
inline constexpr const char* kI915Nodes[] = {"/sys/bus/pci/drivers/i915/0000:00:02.0"};

}  // namespace xauto::kernel
