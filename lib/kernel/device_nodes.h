// SPDX-License-Identifier: Apache-2.0
// NVIDIA's device nodes, by driver generation: JetPack 6 first, then JetPack 5.
#pragma once

namespace xauto::kernel {

inline constexpr const char* kGpuNodes[] = {"/dev/nvgpu/igpu0/tsg", "/dev/nvhost-tsg-gpu"};
inline constexpr const char* kGpuSchedNodes[] = {"/dev/nvgpu/igpu0/sched",
                                                 "/dev/nvhost-sched-gpu"};
inline constexpr const char* kDlaNodes[] = {"/dev/nvhost-ctrl-nvdla0", "/dev/nvhost-ctrl-nvdla1",
                                            "/dev/nvdla0", "/dev/nvdla1"};

}  // namespace xauto::kernel
