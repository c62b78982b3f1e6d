// SPDX-License-Identifier: Apache-2.0
// The modules of the Driving Case: every stage keeps an emulated XPU busy for 60 to 95 % of its time (times.h), as a
// stage takes less than its WCET on an ordinary day, and leaves the emulator 0.3 ms to wake up in: a short one takes
// less, 30 % at least. With DRIVING_TIMES=worst in the environment each job takes all of it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>

#include <xauto/emu.h>
#include <xauto/xauto.h>

#include "times.h"

namespace driving {

/// A frame or point cloud, and what the modules make of it: here only which one it is.
struct Frame {
  std::uint64_t number = 0;
};

/// What a module's stages share.
struct State {
  Frame result;
};

using Node = xauto::XNode<State>;
using Module = xauto::XModule<State>;

/// How long job `number` of a stage takes; the same in each run, whatever the policy.
inline std::chrono::microseconds time_of(const char* stage, std::uint64_t number, int worst_us) {
  static const char* const times = std::getenv("DRIVING_TIMES");
  static const bool worst = times != nullptr && std::string_view(times) == "worst";
  if (worst) return std::chrono::microseconds(worst_us);
  std::uint64_t mixed = std::hash<std::string_view>()(stage) + number * 0x9e3779b97f4a7c15;
  mixed = (mixed ^ mixed >> 31) * 0xbf58476d1ce4e5b9;
  const auto pct = static_cast<int>(60 + (mixed >> 32) % 36);
  const int most_us = std::max(worst_us * 30 / 100, worst_us - 300);
  return std::chrono::microseconds(std::min(worst_us * pct / 100, most_us));
}

/// An implementation that keeps `xpu` busy for at most `us`.
inline void add_emulated(Node& node, const char* stage, const xauto::XPU& xpu, int us) {
  using xauto::emu::Context;
  node.add_impl(
      xpu,
      [](const xauto::XpuId& id) {
        auto opened = Context::open(id);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        const xauto::SchedHandle handle = opened->handle();
        return xauto::own(std::make_unique<Context>(std::move(*opened)), handle);
      },
      [stage, us](Context& context, State& state, const xauto::Input& input) {
        state.result.number = input.sequence();
        return context.run(time_of(stage, input.sequence(), us));
      });
}

/// The module with all its stages of times.h, in their order; `add_impls` gives a node its implementations.
template <class AddImpls>
Module module_of(const std::string& name, AddImpls add_impls) {
  Module module(name);
  const auto add = [&](const Stage& stage) {
    if (stage.module != name) return;
    Node node(stage.xnode);
    add_impls(node, stage);
    module.add_node(node);
  };
  for (const Stage& stage : kStages) add(stage);
  for (const Stage& stage : kControlStages) add(stage);
  return module;
}

inline Module make_module(const std::string& name) {
  return module_of(name, [](Node& node, const Stage& stage) {
    if (stage.cpu_us > 0) add_emulated(node, stage.xnode, xauto::XPU::CPU, stage.cpu_us);
    if (stage.gpu_us > 0) add_emulated(node, stage.xnode, xauto::XPU::GPU, stage.gpu_us);
    if (stage.dla_us > 0) add_emulated(node, stage.xnode, xauto::XPU::DLA, stage.dla_us);
  });
}

}  // namespace driving
