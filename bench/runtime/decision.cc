// SPDX-License-Identifier: Apache-2.0
// What a decision costs: START that meets nobody, START that waits for the owner's FINISH, START
// that suspends the owner (until it runs, and until the management thread of the owner is told),
// and the coordinators' share of a CPU. Beside the futex round trip between two processes.
#include <array>
#include <atomic>
#include <random>
#include <thread>

#include <sys/mman.h>
#include <unistd.h>

#include "base/futex.h"
#include "coord/port.h"

#include "bench.h"
#include "coordinator.h"
#include "peers.h"

namespace xauto::bench {
namespace {

/// Says when it was told to suspend, and does nothing.
struct Obedient {
  std::atomic<std::int64_t> suspended{0};
  ManagementThread thread;
  Obedient(coord::Port& port, int core, bool fifo)
      : thread(port, core, fifo, [this](bool suspends) {
          if (suspends) suspended.store(now_ns());
          return true;
        }) {}
};

/// 4 bytes to another process and back, both asleep in between.
Samples futex_round_trip(const Options& options, int here, int there) {
  struct Shared {
    std::atomic<std::uint32_t> ping, pong;
  };
  auto* shared = static_cast<Shared*>(
      mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  const Process peer([&] {
    (void)rt::pin_to_core(there);
    if (options.fifo) (void)rt::set_fifo(60);
    for (std::uint32_t seen = 0;;) {
      while (shared->ping.load() == seen) futex_wait(shared->ping, seen);
      seen = shared->ping.load();
      shared->pong.store(seen);
      futex_wake(shared->pong, 1);
    }
  });
  Samples samples;
  (void)rt::pin_to_core(here);
  if (options.fifo) (void)rt::set_fifo(40);
  for (std::uint32_t k = 1; k <= options.rounds; ++k) {
    const std::int64_t start = now_ns();
    shared->ping.store(k);
    futex_wake(shared->ping, 1);
    for (std::uint32_t seen; (seen = shared->pong.load()) != k;) futex_wait(shared->pong, seen);
    samples.add(now_ns() - start);
  }
  (void)rt::set_other();
  munmap(shared, sizeof(Shared));
  return samples;
}

Samples uncontended(const Options& options, int core) {
  const std::string address = next_address();
  const auto coordinator = start_coordinator(address, Discipline::kPreemptive, core, options.fifo);
  const auto port = *coord::Port::connect(address, "w", {0}, {});
  Samples samples;
  for (std::uint64_t k = 0; k < options.rounds; ++k) {
    const std::int64_t start = now_ns();
    port->start({0, k, coord::key_of_priority(1)});
    samples.add(now_ns() - start);
    port->finish();
  }
  return samples;
}

/// A parked START: from the owner's FINISH until the parked one runs; no coordinator in it.
Samples hand_over(const Options& options, int here, int there) {
  const std::string address = next_address();
  const auto coordinator = start_coordinator(address, Discipline::kGate, there, options.fifo);
  const auto owner = *coord::Port::connect(address, "a", {0}, {});
  const auto waiter = *coord::Port::connect(address, "b", {1}, {});
  std::atomic<std::uint32_t> asked{0}, ran{0};
  std::atomic<std::int64_t> when{0};
  std::atomic<bool> quit{false};
  std::thread thread([&] {
    (void)rt::pin_to_core(there);
    rt::set_timer_slack_1ns();
    if (options.fifo) (void)rt::set_fifo(40);
    for (std::uint32_t seen = 0;;) {
      while (asked.load() == seen) futex_wait(asked, seen);
      seen = asked.load();
      if (quit.load()) return;
      waiter->start({1, seen, coord::key_of_priority(1)});
      when.store(now_ns());
      waiter->finish();
      ran.store(seen);
      futex_wake(ran, 1);
    }
  });
  (void)rt::pin_to_core(here);
  if (options.fifo) (void)rt::set_fifo(39);
  Samples samples;
  for (std::uint32_t k = 1; k <= options.rounds; ++k) {
    owner->start({0, k, coord::key_of_priority(1)});
    asked.store(k);
    futex_wake(asked, 1);
    sleep_until_ns(now_ns() + 100'000);  // it is parked and asleep
    const std::int64_t start = now_ns();
    owner->finish();
    for (std::uint32_t seen; (seen = ran.load()) != k;) futex_wait(ran, seen);
    samples.add(when.load() - start);
  }
  quit.store(true);
  asked.fetch_add(1);
  futex_wake(asked, 1);
  thread.join();
  (void)rt::set_other();
  return samples;
}

/// A START that is more urgent than the owner: until it runs, and until the owner's management
/// thread has been told to suspend.
void preempting(const Options& options, int here, int there, Samples& granted, Samples& told) {
  const std::string address = next_address();
  const auto coordinator = start_coordinator(address, Discipline::kPreemptive, there, options.fifo);
  const auto low = *coord::Port::connect(address, "low", {0}, {});
  const auto high = *coord::Port::connect(address, "high", {1}, {});
  Obedient low_manager(*low, there, options.fifo), high_manager(*high, there, options.fifo);
  (void)rt::pin_to_core(here);
  if (options.fifo) (void)rt::set_fifo(40);
  for (std::uint64_t k = 1; k <= options.rounds; ++k) {
    low->start({0, k, coord::key_of_priority(1)});
    low_manager.suspended.store(0);
    const std::int64_t start = now_ns();
    high->start({1, k, coord::key_of_priority(2)});
    granted.add(now_ns() - start);
    while (low_manager.suspended.load() == 0) sleep_until_ns(now_ns() + 5'000);
    told.add(low_manager.suspended.load() - start);
    high->finish();
    sleep_until_ns(now_ns() + 100'000);  // resumed
    low->finish();
  }
  (void)rt::set_other();
}

/// CPU share of a process that is woken through a futex for each START and each FINISH, and wakes
/// back for the STARTs: the plain design, without any decision.
double bare_wake_ups(const Cores& c, int hz, const Options& options) {
  struct Shared {
    std::atomic<std::uint32_t> ping, pong;
  };
  auto* shared = static_cast<Shared*>(
      mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  double share = 0;
  {
    const Process peer([&] {
      (void)rt::pin_to_core(c.second);
      rt::set_timer_slack_1ns();
      if (options.fifo) (void)rt::set_fifo(60);
      for (std::uint32_t seen = 0;;) {
        while (shared->ping.load() == seen) futex_wait(shared->ping, seen);
        seen = shared->ping.load();
        shared->pong.store(seen);
        if (seen % 2 == 0) futex_wake(shared->pong, 1);
      }
    });
    (void)rt::pin_to_core(c.first);
    const std::int64_t start = now_ns(), before = peer.cpu_ns();
    const auto total = static_cast<std::uint32_t>(options.seconds * hz);
    for (std::uint32_t k = 1; k <= total; ++k) {
      sleep_until_ns(start + static_cast<std::int64_t>(1e9 / hz * k));
      shared->ping.store(k);
      futex_wake(shared->ping, 1);
    }
    share =
        100.0 * static_cast<double>(peer.cpu_ns() - before) / static_cast<double>(now_ns() - start);
  }
  munmap(shared, sizeof(Shared));
  return share;
}

/// 40 XNodes on 3 XPUs as 20 order pairs: the follower asks first, and is granted by its leader's FINISH.
void ordered_pairs(const Options& options, Table& table, int hz) {
  const Cores c = cores();
  constexpr std::size_t kXpus = 3, kPairs = 20;
  std::vector<std::unique_ptr<Process>> processes;
  std::vector<std::unique_ptr<coord::Port>> ports;
  for (std::size_t x = 0; x < kXpus; ++x) {
    const std::string address = next_address();
    const coord::OrderPairs order{{0, 1}};
    processes.push_back(
        start_coordinator(address, Discipline::kPreemptive, c.second, options.fifo, 64, order));
    ports.push_back(*coord::Port::connect(address, "leader", {0}, order));
    ports.push_back(*coord::Port::connect(address, "follower", {1}, order));
  }
  std::array<std::atomic<std::uint32_t>, kXpus> asked{}, ran{};
  std::atomic<bool> quit{false};
  std::vector<std::thread> threads;
  for (std::size_t x = 0; x < kXpus; ++x)
    threads.emplace_back([&, x] {
      (void)rt::pin_to_core(c.first);
      for (std::uint32_t seen = 0;;) {
        while (asked[x].load() == seen) futex_wait(asked[x], seen);
        ++seen;
        if (quit.load()) return;
        ports[2 * x + 1]->start({1, seen, coord::key_of_priority(20)});
        ports[2 * x + 1]->finish();
        ran[x].store(seen);
        futex_wake(ran[x], 1);
      }
    });
  (void)rt::pin_to_core(c.first);
  const auto cpu = [&] {
    std::int64_t ns = 0;
    for (const auto& process : processes) ns += process->cpu_ns();
    return ns;
  };
  const std::int64_t start = now_ns(), before = cpu();
  const auto total = static_cast<std::uint64_t>(options.seconds * hz * kPairs);
  for (std::uint64_t pair = 0; pair < total; ++pair) {
    sleep_until_ns(start + static_cast<std::int64_t>(static_cast<double>(pair) * 1e9 /
                                                     (hz * static_cast<double>(kPairs))));
    const std::size_t x = pair % kXpus;
    const std::uint32_t number = asked[x].fetch_add(1) + 1;
    futex_wake(asked[x], 1);
    sleep_until_ns(now_ns() + 100'000);  // it waits for its leader
    ports[2 * x]->start({0, number, coord::key_of_priority(10)});
    ports[2 * x]->finish();
    for (std::uint32_t seen; (seen = ran[x].load()) != number;) futex_wait(ran[x], seen);
  }
  table.add("coordinator", fmt::format("20 order pairs at {} Hz", hz), "share of a CPU, %",
            100.0 * static_cast<double>(cpu() - before) / static_cast<double>(now_ns() - start));
  quit.store(true);
  for (auto& word : asked) {
    word.fetch_add(1);
    futex_wake(word, 1);
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace

void decisions(const Options& options, Table& table) {
  const Cores c = cores();
  (void)rt::pin_to_core(c.first);
  auto free = uncontended(options, c.second);
  table.add("decision", "start uncontended", "xauto", free);
  for (const bool same : {true, false}) {
    const int there = same ? c.first : c.second;
    const std::string where = same ? " 1 core" : " 2 cores";
    auto futex = futex_round_trip(options, c.first, there);
    table.add("decision", "contended" + where, "futex round trip", futex);
    for (const Peer& peer : peers())
      if (peer.round_trip != nullptr)
        add_peer(table, "decision", "contended" + where, peer.name + ", 64 bytes and back",
                 [&] { return peer.round_trip(options, c.first, there); });
    auto parked = hand_over(options, c.first, there);
    table.add("decision", "contended" + where, "xauto, parked", parked);
    Samples granted, told;
    preempting(options, c.first, there, granted, told);
    table.add("decision", "contended" + where, "xauto, preempting", granted);
    table.add("decision", "suspend told" + where, "xauto", told);
  }
}

/// 40 XNodes on 3 XPUs, each with its coordinator in a process; jobs come at `hz` per XNode; a
/// third of the starts meets a job that is on the XPU, every second of them is the more urgent one.
void coordinators(const Options& options, Table& table) {
  const Cores c = cores();
  for (const int hz : {10, 100}) {
    std::vector<std::unique_ptr<Process>> processes;
    std::vector<std::unique_ptr<coord::Port>> ports;
    std::vector<std::unique_ptr<Obedient>> managers;
    constexpr int kXpus = 3, kXNodes = 40;
    for (int x = 0; x < kXpus; ++x) {
      const std::string address = next_address();
      processes.push_back(
          start_coordinator(address, Discipline::kPreemptive, c.second, options.fifo));
      for (const char* name : {"one", "two"}) {
        ports.push_back(*coord::Port::connect(address, name, {0, 1}, {}));
        managers.push_back(std::make_unique<Obedient>(*ports.back(), c.first, options.fifo));
      }
    }
    std::uint64_t before = 0, jobs = 0, contended = 0;
    for (const auto& process : processes) before += static_cast<std::uint64_t>(process->cpu_ns());
    // Pairs of jobs: the first alone, the second alone, the third meets the first.
    std::vector<std::thread> threads;
    std::array<std::atomic<std::uint32_t>, kXpus> asked{}, ran{};
    std::array<std::atomic<std::int64_t>, kXpus> urgency{};
    std::atomic<bool> quit{false};
    for (std::size_t x = 0; x < kXpus; ++x)
      threads.emplace_back([&, x] {
        (void)rt::pin_to_core(c.first);
        for (std::uint32_t seen = 0;;) {
          while (asked[x].load() == seen) futex_wait(asked[x], seen);
          seen = asked[x].load();
          if (quit.load()) return;
          ports[2 * x + 1]->start({1, seen, coord::key_of_priority(urgency[x].load())});
          ports[2 * x + 1]->finish();
          ran[x].store(seen);
          futex_wake(ran[x], 1);
        }
      });
    (void)rt::pin_to_core(c.first);
    const std::int64_t start = now_ns();
    const auto gap_ns = static_cast<std::int64_t>(1e9 / (hz * kXNodes));
    const auto total = static_cast<std::uint64_t>(options.seconds * hz * kXNodes);
    std::array<std::uint64_t, kXpus> turn{};
    for (; jobs < total; ++jobs) {
      sleep_until_ns(start + static_cast<std::int64_t>(jobs) * gap_ns);
      const std::size_t x = jobs % kXpus;
      coord::Port& port = *ports[2 * x];
      const bool meets = ++turn[x] % 2 == 0;  // two jobs in this turn, the second one contended
      port.start({0, jobs, coord::key_of_priority(10)});
      if (meets) {
        urgency[x].store(turn[x] % 4 == 0 ? 20 : 5);
        ran[x].store(0);
        const std::uint32_t number = asked[x].fetch_add(1) + 1;
        futex_wake(asked[x], 1);
        sleep_until_ns(now_ns() + 100'000);
        port.finish();
        for (std::uint32_t seen; (seen = ran[x].load()) != number;) futex_wait(ran[x], seen);
        ++jobs;
        ++contended;
      } else {
        port.finish();
      }
    }
    const std::int64_t wall = now_ns() - start;
    std::uint64_t after = 0;
    for (const auto& process : processes) after += static_cast<std::uint64_t>(process->cpu_ns());
    table.add("coordinator", fmt::format("40 XNodes at {} Hz", hz), "share of a CPU, %",
              100.0 * static_cast<double>(after - before) / static_cast<double>(wall));
    table.add("coordinator", fmt::format("40 XNodes at {} Hz", hz), "starts contended, %",
              100.0 * static_cast<double>(contended) / static_cast<double>(jobs));
    table.add("coordinator", fmt::format("40 XNodes at {} Hz", hz), "bare futex, each event, %",
              bare_wake_ups(c, hz * kXNodes * 2, options));
    quit.store(true);
    for (auto& word : asked) {
      word.fetch_add(1);
      futex_wake(word, 1);
    }
    for (std::thread& thread : threads) thread.join();
  }
  for (const int hz : {10, 100}) ordered_pairs(options, table, hz);
}

}  // namespace xauto::bench
