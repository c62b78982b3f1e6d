// SPDX-License-Identifier: Apache-2.0
// An app that breaks the rule of docs/api.md: what C's exec waits for is in the queue of P's next job.
//
//   tick ─► P ─► p ─► C        P: p.work on the GPU, the least urgent
//        └► M                  C: c.meet on a CPU, c.work on the DLA or the GPU, the most urgent
//                              M: m.meet on a CPU, m.work on the GPU
//
//   heldup FILE [polite]
//
// Of each two releases k and k + 1: P's job k + 1 runs until M or C takes the GPU from it; M's job
// lasts until C's job k is over; and C's job k waits for P's job k + 1. So nobody ever ends unless
// P's job gets on. FILE is shared by the processes of a run. Each wait is given up after 20 s. At the end
// a line on stderr: "rounds N stuck N", of C's jobs. polite: C does not wait.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <xauto/emu.h>
#include <xauto/xauto.h>

using namespace std::chrono_literals;

namespace {

/// Numbers of releases, plus one.
struct Shared {
  std::atomic<std::uint64_t> p_begun{}, p_done{}, m_begun{}, c_begun{}, c_done{}, stuck{};
};
Shared* g_shared = nullptr;

template <class Done>
bool wait_until(Done done) {
  const auto limit = std::chrono::steady_clock::now() + 20s;
  while (!done()) {
    if (std::chrono::steady_clock::now() > limit) return false;
    std::this_thread::sleep_for(500us);
  }
  return true;
}

struct State {
  std::uint64_t k = 0;
};

using Context = xauto::emu::Context;

void run(Context& context) {
  if (const xauto::Status done = context.run(1ms); !done)
    throw std::runtime_error(done.error().to_string());
}

template <class Exec>
void add(xauto::XNode<State>& node, xauto::XPU xpu, Exec exec) {
  node.add_impl(
      xpu,
      [](const xauto::XpuId& id) {
        auto opened = Context::open(id);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        auto context = std::make_unique<Context>(std::move(*opened));
        const xauto::SchedHandle handle = context->handle();
        return xauto::own(std::move(context), handle);
      },
      [exec](Context& context, State& state, const xauto::Input& in) {
        state.k = in.sequence() + 1;
        exec(context, state.k, state.k % 2 == 0);  // the second of two
      });
}

}  // namespace

int main(int argc, char** argv) {
  const bool polite = argc > 2 && std::string(argv[2]) == "polite";
  const int fd = open(argc > 1 ? argv[1] : "/dev/null", O_RDWR | O_CREAT, 0600);
  if (fd < 0 || ftruncate(fd, sizeof(Shared)) != 0) return 2;
  void* memory = mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  if (memory == MAP_FAILED) return 2;
  g_shared = static_cast<Shared*>(memory);

  const xauto::Topic<std::uint64_t> tick("tick"), p("p");
  xauto::XNode<State> p_work("p.work"), c_meet("c.meet"), c_work("c.work"), m_meet("m.meet"),
      m_work("m.work");
  const Shared& s = *g_shared;
  add(p_work, xauto::XPU::GPU, [&s](Context& context, std::uint64_t k, bool second) {
    g_shared->p_begun = k;
    if (second)
      wait_until([&] {
        run(context);
        return s.m_begun >= k || s.c_begun + 1 >= k;
      });
    for (int i = 0; i < 5; ++i) run(context);
    g_shared->p_done = k;
  });
  add(c_meet, xauto::XPU::CPU, [&s](Context&, std::uint64_t k, bool second) {
    if (!second) wait_until([&] { return s.p_begun > k; });
  });
  const auto c = [&s, polite](Context&, std::uint64_t k, bool second) {
    g_shared->c_begun = k;
    if (!second && !polite && !wait_until([&] { return s.p_done > k; })) ++g_shared->stuck;
    g_shared->c_done = k;
  };
  add(c_work, xauto::XPU::DLA, c);
  add(c_work, xauto::XPU::GPU, c);
  add(m_meet, xauto::XPU::CPU, [&s](Context&, std::uint64_t k, bool second) {
    if (second) wait_until([&] { return s.p_begun >= k; });
  });
  add(m_work, xauto::XPU::GPU, [&s](Context& context, std::uint64_t k, bool second) {
    g_shared->m_begun = k;
    if (second)
      wait_until([&] {
        run(context);
        return s.c_done + 1 >= k;
      });
  });

  xauto::App app("heldup");
  app.add_source(tick, 20ms, [](std::uint64_t k) { return k; });
  xauto::XModule<State> P("P"), C("C"), M("M");
  P.add_node(p_work).add_input_topic(tick).add_output_topic(p, &State::k);
  C.add_node(c_meet).add_node(c_work).add_input_topic(p);
  M.add_node(m_meet).add_node(m_work).add_input_topic(tick);
  app.add_module(P).add_module(C).add_module(M);
  const int status = app.main(argc, argv);
  if (s.c_done > 0 && s.p_done > 0)
    std::fprintf(stderr, "rounds %llu stuck %llu\n", static_cast<unsigned long long>(s.c_done / 2),
                 static_cast<unsigned long long>(s.stuck.load()));
  return status;
}
