// SPDX-License-Identifier: Apache-2.0
// The Driving Case at its rates (examples/driving/rates.cc) with real work: its nets are the kernel of kernels.cu for as
// long as times.h says of a GPU, in blocks of BLOCK_US; its other stages compute on a CPU. No GPU of the RM driver but
// Thor has a DLA beside it, so those are emulated. run.sh builds and runs it.
//
//   KERNELS=kernels.ptx driving
#include <memory>
#include <string>

#include <time.h>

#include "../../examples/driving/modules.h"
#include "stage.h"

namespace driving {

/// By hand: what hears of obstacles first, what comes seldom last.
inline int level_of(const std::string& module) {
  return module == "FCD" || module == "RCD" ? 2 : module == "LD" ? 0 : 1;
}

inline std::int64_t cpu_ns() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec * 1'000'000'000 + now.tv_nsec;
}

inline void add_cpu(Node& node, const Stage& stage) {
  node.add_impl(
      xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [stage](State& state, const xauto::Input& input) {
        state.result.number = input.sequence();
        const std::chrono::nanoseconds time = time_of(stage.xnode, input.sequence(), stage.cpu_us);
        for (const std::int64_t until = cpu_ns() + time.count(); cpu_ns() < until;) {
        }
        return xauto::Status();
      });
}

inline void add_gpu(Node& node, const Stage& stage) {
  node.add_impl(
      xauto::XPU::GPU,
      [by_hand = level_of(stage.module)](const xauto::XpuId& xpu) {
        auto made = std::make_unique<nvidia::Stage>(xpu, by_hand);
        const xauto::SchedHandle handle = made->handle();
        return xauto::own(std::move(made), handle);
      },
      [stage](nvidia::Stage& on, State& state, const xauto::Input& input) {
        state.result.number = input.sequence();
        const auto us = time_of(stage.xnode, input.sequence(), stage.gpu_us).count();
        return on.work(static_cast<unsigned long long>(us) * nvidia::kPerMs / 1000);
      });
}

inline Module make_real(const std::string& name) {
  return module_of(name, [](Node& node, const Stage& stage) {
    if (stage.cpu_us > 0) add_cpu(node, stage);
    if (stage.gpu_us > 0) add_gpu(node, stage);
    if (stage.dla_us > 0) add_emulated(node, stage.xnode, xauto::XPU::DLA, stage.dla_us);
  });
}

}  // namespace driving

// The app is the example's: it makes its modules of these stages.
#define make_module make_real
#include "../../examples/driving/rates.cc"  // NOLINT(bugprone-suspicious-include)
