// SPDX-License-Identifier: Apache-2.0
#include "xpu/kind.h"

#include "kernel/device_nodes.h"

namespace xauto::xpu {
namespace {

/// Of what only xauto.ko can suspend.
Discipline by_module() {
  return kernel::module_is_loaded() ? Discipline::kPreemptive : Discipline::kGate;
}
Discipline by_kernel() {
  return Discipline::kKernel;
}
Discipline by_coordinator() {
  return Discipline::kPreemptive;
}

template <std::size_t N>
std::vector<std::string> nodes(const char* const (&list)[N]) {
  return {list, list + N};
}

}  // namespace

const std::vector<Kind>& kinds() {
  // Preemption costs and time slices are those of the paper's measurements on a Jetson Orin.
  static const std::vector<Kind> table = {
      {.type = "cpu",
       .discipline = by_kernel,
       .backend = make_cpu_thread,
       .backend_by_keys = make_cpu_by_keys},
      {.type = "gpu",
       .nodes = nodes(kernel::kGpuNodes),
       .discipline = by_module,
       .backend = make_kernel_queue,
       .preempt_us = 275,
       .timeslice_us = 1000,
       .what = "a Jetson's GPU",
       .driver = "nvgpu",
       .advice = "needs a Jetson with NVIDIA's kernel"},
      {.type = "dla",
       .nodes = nodes(kernel::kDlaNodes),
       .discipline = by_module,
       .backend = make_kernel_queue,
       .preempt_us = 132,
       .timeslice_us = 1000,
       .what = "a Jetson's DLA",
       .driver = "nvdla",
       .advice = "needs a Jetson Xavier or Orin with NVIDIA's kernel"},
      {.type = "", .discipline = by_coordinator, .backend = make_custom},
  };
  return table;
}

std::vector<kernel::Device> devices(const std::vector<Kind>& table) {
  std::vector<kernel::Device> devices;
  for (const Kind& kind : table)
    if (!kind.nodes.empty())
      devices.push_back({kind.type, kind.nodes, kind.what, kind.driver, kind.advice});
  return devices;
}

const Kind& kind_of(const std::string& type, const std::vector<Kind>& table) {
  const Kind* own = nullptr;
  for (const Kind& kind : table) {
    if (kind.type == type) return kind;
    if (kind.type.empty()) own = &kind;
  }
  return *own;
}

Discipline discipline_of(const Xpu& xpu, bool emulated, bool by_keys,
                         const std::vector<Kind>& table) {
  if (!xpu.preemptive) return Discipline::kGate;
  if (emulated) return Discipline::kPreemptive;
  const Kind& kind = kind_of(xpu.type, table);
  if (by_keys && kind.backend_by_keys != nullptr) return Discipline::kPreemptive;
  return kind.discipline();
}

Result<std::unique_ptr<Backend>> make_backend(const BackendRequest& request,
                                              const std::vector<Kind>& table) {
  const Kind& kind = kind_of(request.xpu.type, table);
  const bool driver = !kind.nodes.empty() && request.xpu.preemptive;
  if (request.emulated && !(request.emulator_modules && driver))
    return make_emulated(request.scheduled);
  const bool gated =
      discipline_of(request.xpu, request.emulated, false, table) == Discipline::kGate;
  if (!request.scheduled || gated) return make_gate();
  return request.by_keys && kind.backend_by_keys != nullptr ? kind.backend_by_keys(request.id)
                                                            : kind.backend(request.id);
}

}  // namespace xauto::xpu
