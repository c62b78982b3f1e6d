// SPDX-License-Identifier: Apache-2.0
// From the START of a more urgent job until the other one is suspended, per backend: the decision,
// the management thread, and what the backend does. What the hardware takes for it comes on top:
// the emulator's cost of a switch is 0 here.
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <thread>

#include <xauto/emu.h>

#include "base/futex.h"
#include "coord/port.h"
#include "emu/client.h"
#include "emu/server.h"
#include "xpu/backend.h"

#include "bench.h"
#include "coordinator.h"

namespace xauto::bench {
namespace {

/// A context of xauto-emud that is at work all the time.
void emulated(const Options& options, const Cores& c, Table& table) {
  const std::string address = next_address();
  Platform platform{"bench", {Xpu{.id = "gpu0", .type = "gpu"}}};
  const Process emulator([&] {
    (void)rt::pin_to_core(c.second);
    rt::set_timer_slack_1ns();
    if (options.fifo) (void)rt::set_fifo(70);
    auto server = emu::Server::create(platform, {.address = address});
    const int never = eventfd(0, EFD_CLOEXEC);
    if (server) (void)(*server)->run(never);
  });
  for (int i = 0; i < 500 && !connect_abstract(address); ++i) usleep(10'000);
  setenv(emu::kEmudVariable, address.c_str(), 1);
  auto context = emu::Context::open({"gpu0", XPU::GPU, 0});
  auto backend = xpu::make_emulated();
  if (!context || !backend) {
    fmt::print(stderr, "bench: no emulator: suspension through it was not measured\n");
    return;
  }
  std::atomic<bool> quit{false};
  std::thread busy([&] {
    while (!quit.load() && context->run(std::chrono::milliseconds(5))) {
    }
  });
  const std::string xpu = next_address();
  const auto coordinator = start_coordinator(xpu, Discipline::kPreemptive, c.second, options.fifo);
  const auto low = *coord::Port::connect(xpu, "low", {0}, {});
  const auto high = *coord::Port::connect(xpu, "high", {1}, {});
  Samples suspended, resumed;
  {
    std::atomic<std::int64_t> suspended_at{0}, resumed_at{0};
    const ManagementThread manager(*low, c.second, options.fifo, [&](bool suspends) {
      const SchedHandle handle = context->handle();
      const Status done = suspends ? (*backend)->preempt(handle) : (*backend)->restore(handle);
      (suspends ? suspended_at : resumed_at).store(done ? now_ns() : -1);
      return done.has_value();
    });
    (void)rt::pin_to_core(c.first);
    if (options.fifo) (void)rt::set_fifo(40);
    for (std::uint64_t k = 1; k <= options.rounds; ++k) {
      low->start({0, k, coord::key_of_priority(1)});
      suspended_at.store(0);
      std::int64_t start = now_ns();
      high->start({1, k, coord::key_of_priority(2)});
      while (suspended_at.load() == 0) sleep_until_ns(now_ns() + 5'000);
      suspended.add(suspended_at.load() - start);
      resumed_at.store(0);
      start = now_ns();
      high->finish();
      while (resumed_at.load() == 0) sleep_until_ns(now_ns() + 5'000);
      resumed.add(resumed_at.load() - start);
      low->finish();
      sleep_until_ns(now_ns() + 100'000);
    }
  }
  (void)rt::set_other();
  quit.store(true);
  busy.join();
  table.add("suspend", "START to suspended", "emulated", suspended);
  table.add("suspend", "FINISH to resumed", "emulated", resumed);
}

/// A real core under SCHED_FIFO: the kernel takes it from the less urgent thread when the other one
/// is woken, here from another core.
void cpu(const Options& options, const Cores& c, Table& table) {
  std::atomic<std::uint32_t> round{0}, over{0};
  std::atomic<std::int64_t> start{0};
  std::atomic<bool> quit{false};
  Samples samples;
  std::thread low([&] {
    (void)rt::pin_to_core(c.second);
    if (options.fifo) (void)rt::set_fifo(20);
    for (std::uint32_t k = 0; !quit.load(); ++k) {
      while (round.load() == k) futex_wait_local(round, k);
      while (over.load() == k && !quit.load()) {
      }
    }
  });
  std::atomic<std::uint32_t> go{0};
  std::thread high([&] {
    (void)rt::pin_to_core(c.second);
    if (options.fifo) (void)rt::set_fifo(30);
    for (std::uint32_t k = 0;; ++k) {
      while (go.load() == k) futex_wait_local(go, k);
      if (quit.load()) return;
      samples.add(now_ns() - start.load());
      over.fetch_add(1);
    }
  });
  (void)rt::pin_to_core(c.first);
  if (options.fifo) (void)rt::set_fifo(40);
  for (std::uint64_t k = 0; k < options.rounds; ++k) {
    round.fetch_add(1);
    futex_wake_local(round, 1);
    sleep_until_ns(now_ns() + 200'000);  // it has the core
    start.store(now_ns());
    go.fetch_add(1);
    futex_wake_local(go, 1);
    while (over.load() == k) sleep_until_ns(now_ns() + 20'000);
  }
  quit.store(true);
  round.fetch_add(1);
  futex_wake_local(round, 1);
  go.fetch_add(1);
  futex_wake_local(go, 1);
  low.join();
  high.join();
  (void)rt::set_other();
  table.add("suspend", "START to suspended", "cpu, SCHED_FIFO", samples);
}

}  // namespace

void suspensions(const Options& options, Table& table) {
  const Cores c = cores();
  emulated(options, c, table);
  // On one core the waker would have to be more urgent than both, and sleep.
  if (options.fifo && c.first != c.second) cpu(options, c, table);
}

}  // namespace xauto::bench
