// SPDX-License-Identifier: Apache-2.0
// The Driving Case: three sensors, eight modules, from camera and LiDAR to the predicted paths of
// what moves around the car. Every stage is a duration on an emulated XPU (times.h), so that an
// Orin fits a laptop; the graph, its scheduling and all that runs it are real.
//
//   front ─┬─► LA  lane detection
//          ├─► TD  traffic light detection ──► TC  their classification
//          └─► FCD front obstacle detection ──┐
//   rear  ───► RCD rear obstacle detection ───┼──► TR tracking ──► PR prediction
//   lidar ───► LD  LiDAR obstacle detection ──┘
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>

#include <xauto/emu.h>
#include <xauto/xauto.h>

#include "times.h"

namespace {

using namespace std::chrono_literals;

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
void add_emulated(Node& node, const xauto::XPU& xpu, int us) {
  auto context = std::make_shared<std::optional<xauto::emu::Context>>();
  node.add_impl(
      xpu,
      [context](const xauto::XpuId& id) {
        auto opened = xauto::emu::Context::open(id);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        *context = std::move(*opened);
        return (*context)->handle();
      },
      [context, us](State& state, const xauto::Input& input) {
        state.result.number = input.sequence();
        return (*context)->run(std::chrono::microseconds(us));
      });
}

/// The module with all its stages of times.h, in their order.
Module make_module(const std::string& name) {
  Module module(name);
  for (const driving::Stage& stage : driving::kStages) {
    if (stage.module != name) continue;
    Node node(stage.xnode);
    if (stage.cpu_us > 0) add_emulated(node, xauto::XPU::CPU, stage.cpu_us);
    if (stage.gpu_us > 0) add_emulated(node, xauto::XPU::GPU, stage.gpu_us);
    if (stage.dla_us > 0) add_emulated(node, xauto::XPU::DLA, stage.dla_us);
    module.add_node(node);
  }
  return module;
}

}  // namespace

int main(int argc, char** argv) {
  const xauto::Topic<Frame> front("camera/front"), rear("camera/rear"), lidar("lidar/top");
  const xauto::Topic<Frame> lanes("lanes"), lights("lights"), signals("signals");
  const xauto::Topic<Frame> ahead("obstacles/front"), behind("obstacles/rear"),
      around("obstacles/lidar");
  const xauto::Topic<Frame> tracks("tracks"), paths("paths");

  xauto::App app("driving");
  const auto frame = [](std::uint64_t number) { return Frame{number}; };
  app.add_source(front, 60ms, frame).add_source(rear, 60ms, frame).add_source(lidar, 60ms, frame);

  const auto out = &State::result;
  app.add_module(make_module("LA").add_input_topic(front).add_output_topic(lanes, out));
  app.add_module(make_module("TD").add_input_topic(front).add_output_topic(lights, out));
  app.add_module(make_module("TC").add_input_topic(lights).add_output_topic(signals, out));
  app.add_module(make_module("FCD").add_input_topic(front).add_output_topic(ahead, out));
  app.add_module(make_module("RCD").add_input_topic(rear).add_output_topic(behind, out));
  app.add_module(make_module("LD").add_input_topic(lidar).add_output_topic(around, out));
  app.add_module(make_module("TR")
                     .add_input_topic(ahead)
                     .add_input_topic(behind)
                     .add_input_topic(around)
                     .add_output_topic(tracks, out));
  app.add_module(make_module("PR").add_input_topic(tracks).add_output_topic(paths, out));
  return app.main(argc, argv);
}
