// SPDX-License-Identifier: Apache-2.0
// For urgent_test.py: two sources of 20 ms on one emulated GPU. The camera's stage takes 3 ms, the
// lidar's 8 ms. Every Nth release of the camera is urgent:
//
//   urgentapp N [polled]      without the word both are pushed
//   urgentapp N marks         the camera's messages go through "lookM", which marks every Nth; all are polled
//
// It prints to stderr what publish says first of an urgent release that it refuses.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>

#include <xauto/emu.h>
#include <xauto/xauto.h>

namespace {

using namespace std::chrono_literals;

struct State {
  int done = 0;
};

/// `marks`: every so many of its results are marked.
void add(xauto::App& app, const std::string& name, const xauto::Topic<int>& in,
         std::chrono::microseconds work, int marks = 0) {
  const xauto::Topic<int> out(name + "/out");
  xauto::XNode<State> node(name + ".run");
  auto context = std::make_shared<std::optional<xauto::emu::Context>>();
  node.add_impl(
      xauto::XPU("gpu"),
      [context](const xauto::XpuId& xpu) {
        auto opened = xauto::emu::Context::open(xpu);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        context->emplace(std::move(*opened));
        return (*context)->handle();
      },
      [context, work](State& state, const xauto::Input&) {
        ++state.done;
        return (*context)->run(work);
      });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  if (marks > 0) module.urgent_if([marks](const State& state) { return state.done % marks == 0; });
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  const int every = argc > 1 ? std::atoi(argv[1]) : 2;
  xauto::App app("urgentapp");
  const xauto::Topic<int> camera("camera"), lidar("lidar");
  if (argc > 2 && argv[2] == std::string("marks")) {
    const auto number = [](std::uint64_t k) { return static_cast<int>(k); };
    app.add_source(camera, 20ms, number);
    app.add_source(lidar, 20ms, number);
    add(app, "look", camera, 1ms, every);
    add(app, "camera", xauto::Topic<int>("look/out"), 3ms);
    add(app, "lidar", lidar, 8ms);
    return app.main(argc, argv);
  }
  if (argc > 2) {
    const auto number = [](std::uint64_t k) { return static_cast<int>(k); };
    app.add_source(camera, 20ms, number, [every](int k, std::uint64_t) { return k % every == 0; });
    app.add_source(lidar, 20ms, number);
    add(app, "camera", camera, 3ms);
    add(app, "lidar", lidar, 8ms);
    return app.main(argc, argv);
  }
  const xauto::Source<int> cameras = app.add_source(camera, xauto::pushed(20ms));
  const xauto::Source<int> lidars = app.add_source(lidar, xauto::pushed(20ms));
  add(app, "camera", camera, 3ms);
  add(app, "lidar", lidar, 8ms);
  std::atomic<bool> stop{false};
  std::thread driver;
  app.on_start([&, cameras, lidars] {
    stop = false;
    driver = std::thread([&stop, cameras, lidars, every] {
      bool told = false;
      auto next = std::chrono::steady_clock::now() + 50ms;
      for (int k = 0; !stop; ++k, next += 20ms) {
        std::this_thread::sleep_until(next);
        (void)lidars.publish(k);
        const auto release = k % every == 0 ? xauto::Release::urgent : xauto::Release::ordinary;
        const xauto::Status status = cameras.publish(k, release);
        if (!status && !told) std::cerr << status.error().to_string() << "\n";
        told = told || !status;
      }
    });
  });
  app.on_stop([&] {
    stop = true;
    driver.join();
  });
  return app.main(argc, argv);
}
