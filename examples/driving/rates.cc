// SPDX-License-Identifier: Apache-2.0
// The Driving Case as a vehicle runs it: cameras at 30 Hz, a LiDAR at 10 Hz on a clock of its own, a
// control loop at 50 Hz. Rates meet where a module samples: it reads the newest and waits for
// nobody. rates.json is this app, with the clocks, jitters and deadlines that a program cannot
// know.
//
//   front 30 Hz ─┬─► LA ╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌┐
//                ├─► TD ──► TC ╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌┤        ──► fires
//                └─► FCD ─┐                   ┊        ╌╌► is sampled
//   rear  30 Hz ───► RCD ─┴─► TR ──► PR ╌╌╌╌╌╌┤
//   lidar 10 Hz ───► LD ╌╌╌╌╌╌┘               ▼
//   tick  50 Hz ─────────────────────────────► CTL control
#include "modules.h"

using namespace std::chrono_literals;
using namespace xauto::literals;
using driving::Frame;
using driving::make_module;
using driving::State;

int main(int argc, char** argv) {
  const xauto::Topic<Frame> front("front"), rear("rear"), lidar("lidar"), tick("tick");
  const xauto::Topic<Frame> lanes("lanes"), lights("lights"), signals("signals");
  const xauto::Topic<Frame> ahead("obstacles/front"), behind("obstacles/rear"),
      around("obstacles/lidar");
  const xauto::Topic<Frame> tracks("tracks"), paths("paths"), steering("steering");

  xauto::App app("driving-rates");
  const auto frame = [](std::uint64_t number) { return Frame{number}; };
  app.add_source(front, 30_hz, frame).add_source(rear, 30_hz, frame);
  app.add_source(lidar, 10_hz, frame).add_source(tick, 50_hz, frame);
  app.clock(lidar, "lidar", 5000);  // its motor: 3 rpm of 600 (docs/clocks.md)
  app.deadline(front, steering, 100ms).deadline(rear, steering, 100ms);
  app.deadline(lidar, steering, 150ms).deadline(tick, steering, 10ms);

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
                     .add_sampled_topic(around)
                     .add_output_topic(tracks, out));
  app.add_module(make_module("PR").add_input_topic(tracks).add_output_topic(paths, out));
  app.add_module(make_module("CTL")
                     .add_input_topic(tick)
                     .add_sampled_topic(lanes)
                     .add_sampled_topic(signals)
                     .add_sampled_topic(paths)
                     .add_output_topic(steering, out));
  return app.main(argc, argv);
}
