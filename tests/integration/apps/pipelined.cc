// SPDX-License-Identifier: Apache-2.0
// For in_flight_test.py: the Driving Case with PERIOD between releases
// and up to N activations of each module at once.
//
//   pipelined [PERIOD US] [N] [pushed EVERY US [OMIT]]
//
// With `pushed` the sensors publish by themselves, every EVERY us, from a thread that has its own
// idea of when; camera/front leaves out frame OMIT.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

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
  std::vector<xauto::Source<Frame>> cameras;
  const bool pushed = argc > 4 && argv[3] == std::string("pushed");
  for (const auto* topic : {&front, &rear, &lidar}) {
    if (pushed)
      cameras.push_back(app.add_source(*topic, xauto::pushed(period)));
    else
      app.add_source(*topic, period, frame);
  }
  std::thread driver;
  std::atomic<bool> over{false};
  if (pushed) {
    const std::chrono::microseconds every(std::atoi(argv[4]));
    const std::uint64_t omit = argc > 5 ? std::strtoull(argv[5], nullptr, 10) : UINT64_MAX;
    app.on_start([&, every, omit] {
      driver = std::thread([&, every, omit] {
        auto due = std::chrono::steady_clock::now() + every / 3;
        for (std::uint64_t k = 0; !over.load(); ++k, due += every) {
          std::this_thread::sleep_until(due);
          for (std::size_t c = 0; c < cameras.size(); ++c)
            if (c > 0 || k != omit) (void)cameras[c].publish(Frame{k});
        }
      });
    });
    app.on_stop([&] {
      over.store(true);
      driver.join();
    });
  }
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
