// SPDX-License-Identifier: Apache-2.0
// The modules of the Driving Case: every stage keeps an emulated XPU busy for its time (times.h).
#pragma once

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

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

/// An implementation that keeps `xpu` busy for `us`.
inline void add_emulated(Node& node, const xauto::XPU& xpu, int us) {
  using xauto::emu::Context;
  node.add_impl(
      xpu,
      [](const xauto::XpuId& id) {
        auto opened = Context::open(id);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        const xauto::SchedHandle handle = opened->handle();
        return xauto::own(std::make_unique<Context>(std::move(*opened)), handle);
      },
      [us](Context& context, State& state, const xauto::Input& input) {
        state.result.number = input.sequence();
        return context.run(std::chrono::microseconds(us));
      });
}

/// The module with all its stages of times.h, in their order.
inline Module make_module(const std::string& name) {
  Module module(name);
  const auto add = [&](const Stage& stage) {
    if (stage.module != name) return;
    Node node(stage.xnode);
    if (stage.cpu_us > 0) add_emulated(node, xauto::XPU::CPU, stage.cpu_us);
    if (stage.gpu_us > 0) add_emulated(node, xauto::XPU::GPU, stage.gpu_us);
    if (stage.dla_us > 0) add_emulated(node, xauto::XPU::DLA, stage.dla_us);
    module.add_node(node);
  };
  for (const Stage& stage : kStages) add(stage);
  for (const Stage& stage : kControlStages) add(stage);
  return module;
}

}  // namespace driving
