// SPDX-License-Identifier: Apache-2.0
// For in_flight_test.py and bench/runtime/sustain.py: the Driving Case with PERIOD between releases
// and up to N activations of each module at once.
//
//   pipelined [PERIOD US] [N]
#include <cstdlib>
#include <string>

#include "../../../examples/driving/modules.h"

using driving::Frame;
using driving::make_module;
using driving::State;

int main(int argc, char** argv) {
  const std::chrono::microseconds period(argc > 1 ? std::atoi(argv[1]) : 60'000);
  const int in_flight = argc > 2 ? std::atoi(argv[2]) : 3;
  const xauto::Topic<Frame> front("camera/front"), rear("camera/rear"), lidar("lidar/top");
  const xauto::Topic<Frame> lanes("lanes"), lights("lights"), signals("signals");
  const xauto::Topic<Frame> ahead("obstacles/front"), behind("obstacles/rear"),
      around("obstacles/lidar");
  const xauto::Topic<Frame> tracks("tracks"), paths("paths");

  xauto::App app("driving-pipelined");
  const auto frame = [](std::uint64_t number) { return Frame{number}; };
  for (const auto* topic : {&front, &rear, &lidar}) app.add_source(*topic, period, frame);
  const auto out = &State::result;
  const auto add = [&](const char* name, std::initializer_list<xauto::Topic<Frame>> inputs,
                       const xauto::Topic<Frame>& output) {
    auto module = make_module(name).add_output_topic(output, out).in_flight(in_flight);
    for (const auto& input : inputs) module.add_input_topic(input);
    app.add_module(module);
  };
  add("LA", {front}, lanes);
  add("TD", {front}, lights);
  add("TC", {lights}, signals);
  add("FCD", {front}, ahead);
  add("RCD", {rear}, behind);
  add("LD", {lidar}, around);
  add("TR", {ahead, behind, around}, tracks);
  add("PR", {tracks}, paths);
  return app.main(argc, argv);
}
