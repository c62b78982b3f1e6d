// SPDX-License-Identifier: Apache-2.0
// An app whose stages are not all where they say they are, or share something that no profile of one
// stage alone can show.
//
//   image ─► M ─► out
//            m.infer  on a DLA; with `fallback` a part of it runs on the GPU: what TensorRT does with
//                     layers that the DLA does not know
//            m.plain  on the GPU, and nowhere else
//            m.work   on a CPU, as a thread; takes longer while m.engine runs
//            m.engine on an "npu" of the app's own, as a thread
//
//   fallback FILE [fallback US] [background US PERIOD_US] [fails]
//
// background: somebody else keeps the GPU busy for US at a time, at intervals of PERIOD_US on average.
// FILE is locked (flock) while m.engine runs, in whatever process: that is what m.work waits for.
// fails: m.engine's exec fails in every process but the first one of this FILE.
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <xauto/emu.h>
#include <xauto/xauto.h>

using std::chrono::microseconds;
using namespace std::chrono_literals;

namespace {

struct State {
  int value = 0;
};

xauto::emu::Context open(const xauto::XpuId& xpu) {
  auto opened = xauto::emu::Context::open(xpu);
  if (!opened) throw std::runtime_error(opened.error().to_string());
  return std::move(*opened);
}

const xauto::XpuId kGpu{"gpu0", xauto::XPU::GPU, 0};

/// Until `stop`: the GPU's other user.
void load_gpu(const std::atomic<bool>& stop, microseconds busy, microseconds period) {
  auto context = open(kGpu);
  std::mt19937 random(1);
  std::exponential_distribution<double> wait(1.0 / static_cast<double>(period.count()));
  while (!stop.load()) {
    std::this_thread::sleep_for(microseconds(static_cast<std::int64_t>(wait(random))));
    if (!context.run(busy)) return;
  }
}

}  // namespace

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "/dev/null";
  microseconds falls_back{0}, busy{0}, period{0};
  bool fails = false;
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "fallback") falls_back = microseconds(std::atoi(argv[++i]));
    if (word == "background") {
      busy = microseconds(std::atoi(argv[++i]));
      period = microseconds(std::atoi(argv[++i]));
    }
    fails = fails || word == "fails";
  }
  const int engine = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  bool first = false;

  const xauto::Topic<int> image("image"), out("out");
  std::optional<xauto::emu::Context> dla, gpu, plain;
  xauto::XNode<State> m_infer("m.infer"), m_plain("m.plain"), m_work("m.work"),
      m_engine("m.engine");
  m_infer.add_impl(
      xauto::XPU::DLA,
      [&](const xauto::XpuId& xpu) {
        dla = open(xpu);
        gpu = open(kGpu);
        return dla->handle();
      },
      [&](State&, const xauto::Input&) -> xauto::Status {
        if (auto done = dla->run(4000us - falls_back); !done) return done;
        return falls_back > 0us ? gpu->run(falls_back) : xauto::Status();
      });
  m_plain.add_impl(
      xauto::XPU::GPU,
      [&](const xauto::XpuId& xpu) {
        plain = open(xpu);
        return plain->handle();
      },
      [&](State&, const xauto::Input&) { return plain->run(2000us); });
  m_work.add_impl(
      xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [&](State& state, const xauto::Input&) {
        // A neighbour that is at work makes it slower.
        if (flock(engine, LOCK_EX | LOCK_NB) != 0) std::this_thread::sleep_for(20ms);
        flock(engine, LOCK_UN);
        ++state.value;
      });
  m_engine.add_impl(
      xauto::XPU("npu"), [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
      [&](State&, const xauto::Input&) -> xauto::Status {
        if (fails) {
          char mark = 0;
          first = first || pread(engine, &mark, 1, 0) == 0;
          if (!first) return xauto::fail(xauto::ErrorCode::kUnavailable, "the engine has one user");
          if (pwrite(engine, "x", 1, 0) != 1) std::abort();
        }
        flock(engine, LOCK_EX);
        std::this_thread::sleep_for(1ms);
        flock(engine, LOCK_UN);
        return {};
      });

  xauto::XModule<State> module("M");
  module.add_node(m_infer).add_node(m_plain).add_node(m_work).add_node(m_engine);
  module.add_input_topic(image);
  module.add_output_topic(out, &State::value);

  std::atomic<bool> stop{false};
  std::thread background;
  xauto::App app("fallback");
  app.add_source(image, 30ms, [](std::uint64_t k) { return static_cast<int>(k); });
  app.add_module(module);
  app.on_message(out, [](const int&, std::uint64_t) {});
  app.on_start([&] {
    if (busy > 0us) background = std::thread([&] { load_gpu(stop, busy, period); });
  });
  app.on_stop([&] {
    stop.store(true);
    if (background.joinable()) background.join();
  });
  return app.main(argc, argv);
}
