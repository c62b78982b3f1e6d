// SPDX-License-Identifier: Apache-2.0
// An app that can do with less.
//
//   camera ─► see ─► act           see.infer: 10 ms on the GPU; its variants small and tiny 4 and 2 ms
//                └─► show ─► log   both optional; show.draw 8 ms on the GPU
//
//   lossapp FILE [rates]    one line per activation: "see 7 small", "act 7", "show 7", "log 7"
//   rates: beside them a loop of 20 ms, which reads what see saw last: "steer 21"
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>

#include <fcntl.h>
#include <unistd.h>

#include <xauto/emu.h>
#include <xauto/xauto.h>

using namespace std::chrono_literals;
using std::chrono::microseconds;

namespace {

using Context = xauto::emu::Context;

int g_file = -1;

/// One write, so that lines of several processes do not mix.
void tell(const std::string& line) {
  const std::string text = line + "\n";
  if (write(g_file, text.data(), text.size()) < 0) std::abort();
}

struct State {
  std::uint64_t frame = 0;
};
using Node = xauto::XNode<State>;

auto open_context(const xauto::XpuId& id) {
  auto opened = Context::open(id);
  if (!opened) throw std::runtime_error(opened.error().to_string());
  const xauto::SchedHandle handle = opened->handle();
  return xauto::own(std::make_unique<Context>(std::move(*opened)), handle);
}

/// Keeps the XPU busy for `us`, then says `what`.
auto work(microseconds us, const std::string& what, const std::string& with = {}) {
  return [us, what, with](Context& context, State& state, const xauto::Input& in) {
    state.frame = in.sequence();
    xauto::Status done = context.run(us);
    tell(what + " " + std::to_string(in.sequence()) + with);
    return done;
  };
}

}  // namespace

int main(int argc, char** argv) {
  g_file = open(argc > 1 ? argv[1] : "/dev/null", O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (g_file < 0) return 2;
  const xauto::Topic<std::uint64_t> camera("camera"), objects("objects"), picture("picture");

  Node infer("see.infer"), act("act.go"), draw("show.draw"), log("log.write");
  infer.add_impl(xauto::XPU::GPU, open_context, work(10ms, "see", " full"))
      .add_variant("small", 60, xauto::XPU::GPU, open_context, work(4ms, "see", " small"))
      .add_variant("tiny", 30, xauto::XPU::GPU, open_context, work(2ms, "see", " tiny"));
  act.add_impl(xauto::XPU::CPU, open_context, work(1ms, "act"));
  draw.add_impl(xauto::XPU::GPU, open_context, work(8ms, "show"));
  log.add_impl(xauto::XPU::CPU, open_context, work(1ms, "log"));

  xauto::App app("lossapp");
  app.add_source(camera, 60ms, [](std::uint64_t k) { return k; });
  xauto::XModule<State> see("see"), go("act"), show("show"), write_log("log");
  see.add_node(infer).add_input_topic(camera).add_output_topic(objects, &State::frame);
  go.add_node(act).add_input_topic(objects);
  show.add_node(draw).add_input_topic(objects).add_output_topic(picture, &State::frame).optional();
  write_log.add_node(log).add_input_topic(picture).optional();
  app.add_module(see).add_module(go).add_module(show).add_module(write_log);
  const xauto::Topic<std::uint64_t> tick("tick");
  Node steer("steer.go");
  steer.add_impl(xauto::XPU::CPU, open_context, work(1ms, "steer"));
  xauto::XModule<State> loop("steer");
  loop.add_node(steer).add_input_topic(tick).add_sampled_topic(objects);
  if (argc > 2 && std::string_view(argv[2]) == "rates") {
    app.add_source(tick, 20ms, [](std::uint64_t k) { return k; });
    app.add_module(loop);
  }
  return app.main(argc, argv);
}
