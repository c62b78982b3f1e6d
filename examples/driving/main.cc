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
#include "modules.h"

using namespace std::chrono_literals;
using driving::Frame;
using driving::make_module;
using driving::State;

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
