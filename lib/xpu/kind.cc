// SPDX-License-Identifier: Apache-2.0
#include "xpu/kind.h"

#include <algorithm>

#include <sys/stat.h>

#include "kernel/cuda_levels.h"
#include "kernel/device_nodes.h"
#include "kernel/i915_contexts.h"

namespace xauto::xpu {
namespace {

bool any_there(const std::string& root, const std::vector<std::string>& nodes) {
  return std::any_of(nodes.begin(), nodes.end(), [&](const std::string& node) {
    struct stat status {};
    return stat((root + node).c_str(), &status) == 0;
  });
}

template <std::size_t N>
std::vector<std::string> nodes(const char* const (&list)[N]) {
  return {list, list + N};
}

constexpr const char* kByItself =
    "suspended by each process itself: one that hangs resumes nobody until it is killed";

/// A Jetson's GPU or DLA.
Way by_module() {
  return {.name = "xauto.ko", .backend = make_kernel_queue, .there = kernel::module_is_loaded};
}
Way by_itself() {
  return {.name = "own", .backend = make_own_queue, .caveat = kByItself};
}

/// Where the platform states levels: by the app's CUDA streams, on NVIDIA's GPUs.
Way streams() {
  return {.name = "streams",
          .discipline = Discipline::kLevels,
          .backend = make_on_levels,
          .one_process = true,
          .ask = [] { return kernel::cuda_stream_levels(); },
          .caveat =
              "put on stream priorities by the app itself, which CUDA calls a hint: a more urgent "
              "job waits for the blocks that run, and copies have no priority"};
}

}  // namespace

const std::vector<Kind>& kinds() {
  // Preemption costs and time slices are those of the paper's measurements on a Jetson Orin.
  static const std::vector<Kind> table = {
      {.type = "cpu",
       .ways = {{.name = "", .discipline = Discipline::kKernel, .backend = make_cpu_thread}},
       .backend_by_keys = make_cpu_by_keys},
      {.type = "gpu",
       .nodes = nodes(kernel::kGpuNodes),
       .ways = {by_module(), by_itself(), streams()},
       .preempt_us = 275,
       .timeslice_us = 1000,
       .what = "a Jetson's GPU",
       .driver = "nvgpu",
       .advice = "needs a Jetson with NVIDIA's kernel"},
      // Nobody has measured these costs: a preemption waits for blocks, or is a message to the GPU's GSP.
      {.type = "gpu",
       .nodes = nodes(kernel::kRmNodes),
       .ways = {streams(),
                {.name = "rm", .backend = make_rm, .watched = true, .caveat = kByItself}},
       .preempt_us = 1000,
       .timeslice_us = 1000,
       .measured = false,
       .what = "a GPU of NVIDIA's RM driver",
       .driver = "nvidia",
       .advice = "needs NVIDIA's driver"},
      {.type = "gpu",
       .nodes = nodes(kernel::kKfdNodes),
       .ways = {{.name = "kfd", .backend = make_kfd, .watched = true, .caveat = kByItself}},
       .preempt_us = 1000,
       .timeslice_us = 1000,
       .measured = false,
       .what = "an AMD GPU under ROCm",
       .driver = "amdkfd",
       .advice = "needs amdgpu with amdkfd"},
      // Nobody has measured these costs either. i915 reads a context's priority when it queues.
      {.type = "gpu",
       .nodes = nodes(kernel::kI915Nodes),
       .ways = {{.name = "i915",
                 .discipline = Discipline::kLevels,
                 .backend = make_i915,
                 .levels = kernel::i915_levels,
                 .watched = true,
                 .caveat = "put on priority levels by each process itself, and preempted by the "
                           "hardware: other programs' contexts have levels, too"}},
       .preempt_us = 1000,
       .timeslice_us = 1000,
       .measured = false,
       .what = "an Intel GPU",
       .driver = "i915",
       .advice = "needs an Intel processor's GPU under i915"},
      {.type = "dla",
       .nodes = nodes(kernel::kDlaNodes),
       .node_each = true,
       .ways = {by_module(), by_itself()},
       .preempt_us = 132,
       .timeslice_us = 1000,
       .what = "a Jetson's DLA",
       .driver = "nvdla",
       .advice = "needs a Jetson Xavier or Orin with NVIDIA's kernel"},
      // Whoever wants them queues through VPI (xauto/vpi.h), and nobody can take work off again.
      {.type = "vic",
       .nodes = nodes(kernel::kVicNodes),
       .what = "a Jetson's Video Image Compositor",
       .driver = "VIC",
       .advice = "needs a Jetson Xavier or Orin with NVIDIA's kernel"},
      {.type = "pva",
       .nodes = nodes(kernel::kPvaNodes),
       .what = "a Jetson's Programmable Vision Accelerator",
       .driver = "PVA",
       .advice = "needs a Jetson Xavier or Orin with NVIDIA's kernel"},
      {.type = "",
       .ways = {{.name = "custom", .backend = make_custom},
                {.name = "levels",
                 .discipline = Discipline::kLevels,
                 .backend = make_on_levels,
                 .one_process = true}}},
  };
  return table;
}

namespace {

const Way* asked_way(const Kind& kind) {
  const auto way = std::ranges::find_if(kind.ways, [](const Way& w) { return w.ask != nullptr; });
  return way == kind.ways.end() ? nullptr : &*way;
}

/// What a platform file may say instead.
std::string or_by_levels(const Kind& kind, const std::string& root) {
  const Way* way = asked_way(kind);
  const int levels = way == nullptr || !root.empty() ? 0 : way->ask();
  return levels == 0 ? std::string()
                     : "; or with \"levels\": " + std::to_string(levels) +
                           " in the platform file, " + way->caveat;
}

}  // namespace

int levels_to_state(const Kind& kind) {
  if (const Way* way = way_of(kind); way != nullptr && way->levels != nullptr) return way->levels();
  if (kind.ways.empty() || kind.ways.front().ask == nullptr) return 0;
  return kind.ways.front().ask();
}

std::vector<kernel::Device> devices(const std::vector<Kind>& table) {
  std::vector<kernel::Device> devices;
  for (const Kind& kind : table)
    if (!kind.nodes.empty())
      devices.push_back({kind.type, kind.nodes, kind.what, kind.driver, kind.advice,
                         [kind](const std::string& root) {
                           const Way* way = way_of(kind, root);
                           if (way == nullptr || (way->levels != nullptr && way->levels() < 2))
                             return std::string("gated: nobody can suspend its work");
                           return (way->caveat.empty() ? "suspended by " + way->name
                                                       : way->caveat) +
                                  or_by_levels(kind, root);
                         }});
  return devices;
}

const Kind& kind_of(const std::string& type, const std::vector<Kind>& table) {
  const Kind *own = nullptr, *first = nullptr;
  for (const Kind& kind : table) {
    if (kind.type.empty()) own = &kind;
    if (kind.type != type) continue;
    if (kind.nodes.empty() || any_there({}, kind.nodes)) return kind;
    if (first == nullptr) first = &kind;
  }
  return first != nullptr ? *first : *own;
}

const Way* way_of(const Kind& kind, const std::string& root, bool levels) {
  const bool here = kind.nodes.empty() || any_there(root, kind.nodes);
  const Way* first = nullptr;
  for (const Way& way : kind.ways) {
    if (!(way.there == nullptr ? here : way.there(root))) continue;
    const bool has_levels = way.discipline == Discipline::kLevels;
    if (levels && has_levels) return &way;
    if (first == nullptr && (!has_levels || way.levels != nullptr)) first = &way;
  }
  return first;
}

namespace {

const Way* way_to(const Xpu& xpu, const std::vector<Kind>& table) {
  return way_of(kind_of(xpu.type, table), {}, xpu.levels > 0);
}

}  // namespace

Discipline discipline_of(const Xpu& xpu, bool emulated, bool by_keys,
                         const std::vector<Kind>& table) {
  if (!xpu.preemptive) return Discipline::kGate;
  if (emulated) return xpu.levels > 0 ? Discipline::kLevels : Discipline::kPreemptive;
  const Kind& kind = kind_of(xpu.type, table);
  if (by_keys && kind.backend_by_keys != nullptr) return Discipline::kPreemptive;
  const Way* way = way_to(xpu, table);
  if (way == nullptr) return Discipline::kGate;
  return way->levels != nullptr && way->levels() < 2 ? Discipline::kGate : way->discipline;
}

namespace {

const Way* way_in_use(const Xpu& xpu, bool emulated, const std::vector<Kind>& table) {
  return emulated || !xpu.preemptive ? nullptr : way_to(xpu, table);
}

}  // namespace

int levels_of(const Xpu& xpu, bool emulated, const std::vector<Kind>& table) {
  if (discipline_of(xpu, emulated, false, table) != Discipline::kLevels) return 0;
  if (emulated) return xpu.levels;
  const Way* way = way_to(xpu, table);
  if (way->levels == nullptr) return xpu.levels;
  const int there = way->levels();
  return xpu.levels > 0 ? std::min(xpu.levels, there) : there;
}

bool orders_one_process(const Xpu& xpu, bool emulated, const std::vector<Kind>& table) {
  const Way* way = way_in_use(xpu, emulated, table);
  return way != nullptr && way->one_process;
}

std::string caveat_of(const Xpu& xpu, bool emulated, const std::vector<Kind>& table) {
  const Way* way = way_in_use(xpu, emulated, table);
  return way == nullptr ? std::string() : way->caveat;
}

bool is_watched(const Xpu& xpu, bool emulated, const std::vector<Kind>& table) {
  const Way* way = way_in_use(xpu, emulated, table);
  return way != nullptr && way->watched;
}

bool is_by_modules(const Xpu& xpu, const std::vector<Kind>& table) {
  return xpu.preemptive && !kind_of(xpu.type, table).nodes.empty();
}

Result<std::unique_ptr<Backend>> make_backend(const BackendRequest& request,
                                              const std::vector<Kind>& table) {
  if (request.emulated && !(request.emulator_modules && is_by_modules(request.xpu, table)))
    return make_emulated(request.scheduled);
  const Kind& kind = kind_of(request.xpu.type, table);
  const Way* way = way_to(request.xpu, table);
  if (!request.scheduled || !request.xpu.preemptive || way == nullptr) return make_gate();
  return request.by_keys && kind.backend_by_keys != nullptr ? kind.backend_by_keys(request.id)
                                                            : way->backend(request.id);
}

}  // namespace xauto::xpu
