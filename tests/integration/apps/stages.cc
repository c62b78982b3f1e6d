// SPDX-License-Identifier: Apache-2.0
// An app as one is while it is being written: of three stages one is done, and computes on a CPU,
// the others are stand-ins still.
//
//   image ─► M ─► out
//            m.prep   a stand-in on a CPU
//            m.work   computes
//            m.infer  a stand-in on the GPU
//
//   stages FILE [hang N XPU | once N MS | each K MS | holds MB 0]
//
// FILE gets, at the end, a line per message of out: its number and what m.work made of it; then
// "cores" and the cores that m.work's thread was bound to, if it was bound to one.
// hang: m.work's Nth exec on an XPU of that name never returns; once: its Nth takes so much longer;
// each: every one for release K does; holds: what m.work's init makes has so many MB. A line on stderr tells of m.work's 20th exec.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <sched.h>

#include <xauto/emu.h>
#include <xauto/xauto.h>

using namespace std::chrono_literals;

namespace {

struct State {
  std::uint64_t value = 0;
};

class StandIn {
 public:
  xauto::SchedHandle open(const xauto::XpuId& xpu) {
    auto opened = xauto::emu::Context::open(xpu);
    if (!opened) throw std::runtime_error(opened.error().to_string());
    context_ = std::move(*opened);
    return context_->handle();
  }
  xauto::Status work(std::chrono::microseconds time) { return context_->run(time); }

 private:
  std::optional<xauto::emu::Context> context_;
};

std::uint64_t compute(std::uint64_t x) {
  for (int i = 0; i < 300'000; ++i) {
    x ^= x >> 30;
    x *= 0xbf58476d1ce4e5b9u;
    x += 1;
  }
  return x;
}

/// The one core that this thread is bound to, or -1.
int bound_to() {
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof set, &set) != 0 || CPU_COUNT(&set) != 1) return -1;
  for (int core = 0; core < CPU_SETSIZE; ++core)
    if (CPU_ISSET(core, &set)) return core;
  return -1;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "/dev/null";
  const std::string fault = argc > 4 ? argv[2] : "";
  const std::uint64_t at = argc > 4 ? std::strtoull(argv[3], nullptr, 10) : 0;
  const std::string what = argc > 4 ? argv[4] : "";
  const std::chrono::milliseconds extra(std::atoi(what.c_str()));

  const xauto::Topic<std::uint64_t> image("image"), out("out");
  StandIn prep, infer;
  std::string here;
  std::uint64_t execs = 0;
  std::set<int> cores;

  xauto::XNode<State> m_prep("m.prep"), m_work("m.work"), m_infer("m.infer");
  m_prep.add_impl(
      xauto::XPU::CPU, [&](const xauto::XpuId& xpu) { return prep.open(xpu); },
      [&](State&, const xauto::Input&) { return prep.work(1000us); });
  m_work.add_impl(
      xauto::XPU::CPU,
      [&](const xauto::XpuId& xpu) {
        here = xpu.name;
        auto held = std::make_unique<std::vector<char>>();
        if (fault == "holds") held->assign(at << 20, 1);
        return xauto::own(std::move(held), xauto::SchedHandle::thread());
      },
      [&](std::vector<char>&, State& state, const xauto::Input& input) {
        cores.insert(bound_to());
        state.value = compute(input.get(image));
        if (++execs == 20) std::fputs("stages: m.work has run 20 times\n", stderr);
        if (fault == "hang" && execs >= at && here == what)
          for (;;) std::this_thread::sleep_for(1h);
        if ((fault == "once" && execs == at) || (fault == "each" && input.sequence() == at))
          std::this_thread::sleep_for(extra);
      });
  m_infer.add_impl(
      xauto::XPU::GPU, [&](const xauto::XpuId& xpu) { return infer.open(xpu); },
      [&](State&, const xauto::Input&) { return infer.work(3000us); });

  xauto::XModule<State> module("M");
  module.add_node(m_prep).add_node(m_work).add_node(m_infer);
  module.add_input_topic(image);
  module.add_output_topic(out, &State::value);

  std::vector<std::string> lines;
  xauto::App app("stages");
  app.add_source(image, 30ms, [](std::uint64_t k) { return k; });
  app.add_module(module);
  app.on_message(out, [&](const std::uint64_t& value, std::uint64_t k) {
    lines.push_back(std::to_string(k) + " " + std::to_string(value));
  });
  app.on_end([&] {
    std::ofstream result(file);
    for (const std::string& line : lines) result << line << "\n";
    result << "cores";
    for (const int core : cores) result << " " << core;
    result << "\n";
  });
  return app.main(argc, argv);
}
