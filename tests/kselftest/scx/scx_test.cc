// SPDX-License-Identifier: Apache-2.0
// The scheduler by itself: order, preemption, and the traps that each cost somebody a failing run.
// KTAP; run as root on a kernel with sched_ext and at least two CPUs. Asserts orders and generous
// shares, never short times: it runs in an emulator.
//   scx_test [NAME]      all tests, or those whose name contains NAME
#include <algorithm>
#include <random>

#include <sched.h>
#include <sys/wait.h>

#include "kernel/tracer.h"

#include "tests.h"

namespace xauto::test {
namespace {

constexpr int kCpu = 1;

// ---- order and preemption -----------------------------------------------------------------------

void two_spinners() {
  World& world = loaded_world();
  for (const bool high_first : {false, true}) {
    std::atomic<bool> both{false}, stop{false};
    // Who comes first would have the CPU alone until the other is there.
    const auto body = [&](const kernel::ThreadSlot&) {
      while (!both) usleep(1000);
      spin(stop);
    };
    XNodeThread first(world, high_first ? 1 : 0, body), second(world, high_first ? 0 : 1, body);
    both = true;
    XNodeThread& high = high_first ? first : second;
    XNodeThread& low = high_first ? second : first;
    sleep_ms(1500);
    stop = true;
    first.join();
    second.join();
    ksft_test_result(
        high.cpu() > 1.1 && low.cpu() < 0.3,
        "of two spinners on a CPU the more urgent has it, %s first: %.2f and %.2f s of 1.5\n",
        high_first ? "it" : "the other", high.cpu(), low.cpu());
  }
}

void order_of_eight() {
  constexpr int kThreads = 8;
  const int rounds = full() ? 1000 : 300;
  World& world = loaded_world();
  std::vector<int> order;  // only the thread that has the CPU writes
  std::atomic<bool> open{false}, holding{false};
  std::vector<std::unique_ptr<Waiter>> waiters;
  for (int i = 0; i < kThreads; ++i)
    waiters.push_back(
        std::make_unique<Waiter>(world, static_cast<std::uint32_t>(i),
                                 [&order, i](const kernel::ThreadSlot&) { order.push_back(i); }));
  Waiter gate(world, kThreads, [&](const kernel::ThreadSlot&) {
    holding = true;
    spin(open);
  });
  std::mt19937 random(7);
  int wrong = 0, stuck = 0;
  std::vector<int> shuffled(kThreads);
  for (int i = 0; i < kThreads; ++i) shuffled[static_cast<std::size_t>(i)] = i;
  for (int round = 0; round < rounds && stuck == 0; ++round) {
    order.clear();
    open = false;
    holding = false;
    gate.wake();
    if (!wait_for([&] { return holding.load(); })) ++stuck;
    std::shuffle(shuffled.begin(), shuffled.end(), random);
    for (const int i : shuffled) waiters[static_cast<std::size_t>(i)]->wake();
    for (const auto& waiter : waiters)
      if (!wait_for([&] { return queued(world, waiter->index()); })) ++stuck;
    open = true;
    const auto target = static_cast<std::uint32_t>(round + 1);
    for (const auto& waiter : waiters)
      if (!wait_for([&] { return waiter->done() == target; })) ++stuck;
    for (int i = 0; i < kThreads; ++i)
      if (order.size() != kThreads || order[static_cast<std::size_t>(i)] != kThreads - 1 - i) {
        ++wrong;
        break;
      }
  }
  open = true;
  ksft_test_result(
      wrong == 0 && stuck == 0,
      "eight priorities run in exact order in each of %d rounds, woken in any order (%d wrong)\n",
      rounds, wrong);
}

// Nothing but the rule takes the CPU, and the rule is asked often.
const std::vector<std::string> kShortSlices = {"--slice", "1ms",   "--floor-permille",
                                               "0",       "--age", "20s"};

void equal_priorities() {
  constexpr int kThreads = 6;
  World& world = loaded_world(kShortSlices);
  for (int i = 0; i < kThreads; ++i) world.rows[static_cast<std::size_t>(i)].key = -30;
  world.put_rows();
  std::vector<int> order;
  std::atomic<bool> open{false}, holding{false};
  std::vector<std::unique_ptr<Waiter>> waiters;
  for (int i = 0; i < kThreads; ++i)
    waiters.push_back(std::make_unique<Waiter>(
        world, static_cast<std::uint32_t>(i), [&order, i](const kernel::ThreadSlot&) {
          burn_us(15'000);  // several slices: nobody equal may come between
          order.push_back(i);
        }));
  Waiter gate(world, kThreads, [&](const kernel::ThreadSlot&) {
    holding = true;
    spin(open);
  });
  gate.wake();
  wait_for([&] { return holding.load(); });
  const int arrival[kThreads] = {3, 0, 5, 1, 4, 2};
  for (const int i : arrival) {
    // A new job each: arrival is the job's, not the thread's.
    waiters[static_cast<std::size_t>(i)]->wake();
    wait_for([&] { return queued(world, waiters[static_cast<std::size_t>(i)]->index()); });
  }
  open = true;
  wait_for([&] {
    return std::all_of(waiters.begin(), waiters.end(), [](auto& w) { return w->done() == 1; });
  });
  // The threads' jobs were latched when they entered, in the order 0, 1, 2, ...
  ksft_test_result(
      order == std::vector<int>({0, 1, 2, 3, 4, 5}),
      "equal priorities keep the order in which their jobs arrived, over many slices\n");
}

void preemption() {
  World world(2, kCpu);
  world.load();
  auto tracer = kernel::Tracer::attach(world.maps, {});
  if (!tracer) ksft_exit_fail_msg("tracer: %s\n", tracer.error().to_string().c_str());
  std::atomic<bool> stop{false};
  std::atomic<std::uint32_t> low_tid{0}, high_tid{0};
  std::vector<double> latencies;
  std::atomic<std::int64_t> woken{0};
  const auto now_us = [] {
    return std::chrono::duration_cast<std::chrono::microseconds>(Clock::now().time_since_epoch())
        .count();
  };
  {
    XNodeThread low(world, 0, [&](const kernel::ThreadSlot& slot) {
      low_tid = slot.tid();
      spin(stop);
    });
    Waiter high(world, 1, [&](const kernel::ThreadSlot& slot) {
      high_tid = slot.tid();
      latencies.push_back(static_cast<double>(now_us() - woken.load()));
    });
    for (std::uint32_t i = 0; i < 200; ++i) {
      sleep_ms(2);
      woken = now_us();
      high.wake();
      wait_for([&] { return high.done() == i + 1; });
    }
    stop = true;
  }
  int preemptions = 0;
  const auto sink = [&](const xauto_bpf_event& e) {
    preemptions += e.kind == XAUTO_BPF_EV_PREEMPT && e.tid == low_tid && e.arg == high_tid ? 1 : 0;
  };
  while (tracer->read(0, sink).value_or(0) > 0) {
  }
  std::sort(latencies.begin(), latencies.end());
  ksft_print_msg("wake-up of the urgent job over the running one, us: p50 %.0f p99 %.0f max %.0f\n",
                 latencies[100], latencies[197], latencies[199]);
  ksft_test_result(latencies[100] < 3000,
                   "a waking urgent job runs at once, median of 200 below 3 ms\n");
  ksft_test_result(
      preemptions >= 190 && tracer->losses().events == 0,
      "the trace shows the running job preempted by it: %d of 200 times, %llu records lost\n",
      preemptions, static_cast<unsigned long long>(tracer->losses().events));
}

void placement() {
  World& world = loaded_world();
  world.rows[0].cpu = 0;
  world.rows[1].cpu = 1;
  world.put_rows();
  int wrong = 0, jobs = 0;
  std::uint32_t wanted = 0;
  {
    Waiter waiter(world, 0, [&](const kernel::ThreadSlot&) {
      wrong += sched_getcpu() != static_cast<int>(wanted) ? 1 : 0;
    });
    waiter.wake();
    for (std::uint32_t done = 1; done <= 200; ++done) {
      if (!wait_for([&] { return waiter.done() == done; })) break;
      wanted = done % 2;
      waiter.submit(wanted, done);
      ++jobs;
    }
    wait_for([&] { return waiter.done() == 201; });
  }
  ksft_test_result(wrong == 0 && jobs == 200,
                   "each job runs on the CPU of its table entry: %d of %d did not\n", wrong, jobs);
}

void lowered_by_store() {
  World& world = loaded_world();
  // No memory is taken: who waits for a page is overtaken.
  char order[4] = {};
  std::atomic<std::size_t> ended{0};
  {
    std::atomic<bool> runs{false}, go{false};
    XNodeThread changing(world, 2, [&](const kernel::ThreadSlot& slot) {
      runs = true;
      spin(go);
      order[ended++] = '0';
      if (slot.tell(0, 1)) sched_yield();  // from 30 to 10, while 20 waits
      order[ended++] = '2';
    });
    Waiter waiting(world, 1, [&](const kernel::ThreadSlot&) { order[ended++] = '1'; });
    wait_for([&] { return runs.load(); });  // else the one to wait would have the CPU at once
    // Asleep first: it could enter by its age alone, and might have the rest of that turn.
    waiting.submit(1, 1);
    wait_for([&] { return queued(world, waiting.index()); });
    go = true;
    changing.join();
    wait_for([&] { return waiting.done() == 1; });
  }
  ksft_test_result(
      strcmp(order, "012") == 0,
      "a job less urgent than one that waits, told by a store, yields to it at once: %s\n", order);
  std::atomic<bool> runs{false}, go{false}, stop{false};
  XNodeThread silent(world, 2, [&](const kernel::ThreadSlot& slot) {
    runs = true;
    spin(go);
    (void)slot.tell(0, 1);  // and does not yield
    spin(stop);
  });
  Waiter waiting(world, 1, [](const kernel::ThreadSlot&) {});
  wait_for([&] { return runs.load(); });
  waiting.submit(1, 1);
  wait_for([&] { return queued(world, waiting.index()); });
  go = true;
  const bool ran = wait_for([&] { return waiting.done() == 1; }, 5);
  stop = true;
  silent.join();
  ksft_test_result(ran, "... and if it does not yield, the tick takes the CPU from it\n");
}

void told_while_queued() {
  World& world = loaded_world();
  std::vector<int> order;
  std::atomic<bool> open{false}, holding{false};
  {
    Waiter first(world, 0, [&](const kernel::ThreadSlot&) { order.push_back(0); });
    Waiter second(world, 1, [&](const kernel::ThreadSlot&) { order.push_back(1); });
    Waiter gate(world, 3, [&](const kernel::ThreadSlot&) {
      holding = true;
      spin(open);
    });
    gate.wake();
    wait_for([&] { return holding.load(); });
    first.wake();
    second.wake();
    wait_for([&] { return queued(world, first.index()) && queued(world, second.index()); });
    first.tell(2, 1);  // from 10 to 30, above the other's 20, without a wake-up
    open = true;
    wait_for([&] { return first.done() == 1 && second.done() == 1; });
  }
  ksft_test_result(order == std::vector<int>({0, 1}),
                   "a thread told a more urgent job while it waits is served by that one\n");
}

// ---- the traps ----------------------------------------------------------------------------------

// A real-time thread interrupts an XNode thread that has slice left: it comes back without
// dispatch(), and whoever more urgent was queued meanwhile used to wait for seconds.
void lost_preemption() {
  World world(2, kCpu);
  world.load({"--slice", "100ms"});
  std::atomic<bool> stop{false};
  int late = 0;
  double worst = 0;
  {
    XNodeThread low(world, 0, [&](const kernel::ThreadSlot&) { spin(stop); });
    Clock::time_point ran;
    Waiter high(world, 1, [&](const kernel::ThreadSlot&) { ran = Clock::now(); });
    for (std::uint32_t i = 0; i < 30; ++i) {
      std::atomic<bool> interrupting{false}, leave{false};
      Clock::time_point left;
      std::thread realtime([&] {
        pin(kCpu);
        sched_param priority{};
        priority.sched_priority = 40;
        sched_setscheduler(0, SCHED_FIFO, &priority);
        interrupting = true;
        spin(leave);
        left = Clock::now();
      });
      wait_for([&] { return interrupting.load(); });
      high.wake();
      wait_for([&] { return queued(world, high.index()); });
      leave = true;
      realtime.join();
      if (!wait_for([&] { return high.done() == i + 1; }, 5)) ++late;
      const double wait = seconds(ran - left);
      worst = std::max(worst, wait);
      late += wait > 0.05 ? 1 : 0;
    }
    stop = true;
  }
  ksft_test_result(late == 0,
                   "no preemption is lost behind a real-time thread: worst of 30 %.1f ms\n",
                   worst * 1e3);
}

void kick_storm() {
  World& world = loaded_world();
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> rounds{0};
  {
    XNodeThread low(world, 0, [&](const kernel::ThreadSlot&) { spin(stop); });
    std::vector<std::unique_ptr<Waiter>> waiters;
    for (std::uint32_t i = 1; i < 9; ++i)
      waiters.push_back(
          std::make_unique<Waiter>(world, i, [&](const kernel::ThreadSlot&) { ++rounds; }));
    const auto end = Clock::now() + std::chrono::seconds(full() ? 3 : 1);
    while (Clock::now() < end)
      for (auto& waiter : waiters) waiter->wake();
    stop = true;
  }
  const auto kicks = world.stat(XAUTO_BPF_STAT_KICKED) + world.stat(XAUTO_BPF_STAT_RECHECKED);
  const auto wakes = world.stat(XAUTO_BPF_STAT_QUEUED);
  ksft_test_result(
      scx_state() == "enabled" && kicks <= wakes + wakes / 2 && rounds > 100,
      "a storm of wake-ups causes about one kick each at most: %llu wake-ups, %llu kicks, "
      "%llu jobs\n",
      static_cast<unsigned long long>(wakes), static_cast<unsigned long long>(kicks),
      static_cast<unsigned long long>(rounds.load()));
}

void finite_slice() {
  World& world = loaded_world(kShortSlices);
  std::atomic<bool> stop{false};
  const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
  XNodeThread low(world, 0, body), high(world, 1, body);
  sleep_ms(200);  // what the floor's first credit bought is over
  const std::uint64_t kept = world.stat(XAUTO_BPF_STAT_KEPT);
  const auto used_ns = [&] {
    return *const_cast<volatile const __u64*>(&world.maps.jobs()[low.index()].used_ns);
  };
  const std::uint64_t before = used_ns();
  sleep_ms(1000);
  const std::uint64_t ended = world.stat(XAUTO_BPF_STAT_KEPT) - kept;
  const double got_ms = static_cast<double>(used_ns() - before) * 1e-6;
  stop = true;
  low.join();
  high.join();
  ksft_test_result(
      ended > 50 && got_ms < 10,
      "when a slice ends the more urgent goes on: %llu slices, the other got %.1f ms\n",
      static_cast<unsigned long long>(ended), got_ms);
}

void watchdog() {
  World world(2, kCpu);
  world.load({"--timeout", "2s", "--age", "500ms"});
  std::atomic<bool> stop{false};
  double ordinary = 0;
  std::atomic<bool> started{false};
  std::thread other([&] {
    pin(kCpu);
    started = true;
    const double begin = cpu_seconds();
    spin(stop);
    ordinary = cpu_seconds() - begin;
  });
  wait_for([&] { return started.load(); });
  const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
  XNodeThread low(world, 0, body), high(world, 1, body);
  const auto begin = Clock::now();
  sleep_ms(5000);
  const std::string state = scx_state();
  stop = true;
  low.join();
  high.join();
  other.join();
  const double wall = seconds(Clock::now() - begin);
  ksft_test_result(state == "enabled",
                   "a runaway does not get us thrown out by the watchdog: 5 s, limit 2 s\n");
  ksft_test_result(low.cpu() > 0.005, "a starved XNode thread gets turns: %.3f s of %.1f\n",
                   low.cpu(), wall);
  ksft_test_result(ordinary > 0.01 * wall && ordinary < 0.2 * wall && high.cpu() > 0.75 * wall,
                   "an ordinary spinner gets the floor, not more: %.2f of %.2f s, the XNode %.2f\n",
                   ordinary, wall, high.cpu());
}

void responsive_shell() {
  World& world = loaded_world();
  world.rows[1].cpu = 0;
  world.put_rows();
  std::atomic<bool> stop{false};
  // Both CPUs have a runaway, so that the shell has nowhere to go.
  const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
  const auto commands = [] {
    std::vector<double> took;
    for (int i = 0; i < 11; ++i) {
      sleep_ms(200);
      const auto begin = Clock::now();
      const pid_t child = fork();
      if (child == 0) {
        execl("/bin/sh", "sh", "-c", "echo hello >/dev/null", nullptr);
        _exit(1);
      }
      int status = 1;
      waitpid(child, &status, 0);
      if (status == 0) took.push_back(seconds(Clock::now() - begin));
    }
    std::sort(took.begin(), took.end());
    return took;
  };
  const std::vector<double> alone = commands();
  XNodeThread first(world, 0, body), second(world, 1, body);
  const std::vector<double> under = commands();
  stop = true;
  first.join();
  second.join();
  ksft_test_result(
      alone.size() == 11 && under.size() == 11 && under[5] < 2.0,
      "a shell under runaways on all CPUs: a command takes %.0f ms, median of 11 (alone %.0f ms)\n",
      under.size() == 11 ? under[5] * 1e3 : -1.0, alone.size() == 11 ? alone[5] * 1e3 : -1.0);
}

void budget() {
  World& world = loaded_world();
  world.rows[1].budget_us = 50'000;
  world.put_rows();
  std::atomic<bool> stop{false};
  const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
  XNodeThread low(world, 0, body), runaway(world, 1, body);
  const volatile __u32& flags = world.maps.jobs()[runaway.index()].flags;
  const bool demoted = wait_for([&] { return (flags & XAUTO_BPF_JOB_DEMOTED) != 0; }, 3);
  const double used_ms = static_cast<double>(world.maps.jobs()[runaway.index()].used_ns) * 1e-6;
  sleep_ms(1500);
  stop = true;
  low.join();
  runaway.join();
  ksft_test_result(
      demoted && used_ms >= 50 && used_ms < 200 && world.stat(XAUTO_BPF_STAT_DEMOTED) == 1,
      "a job over its budget of 50 ms is demoted once, after %.1f ms\n", used_ms);
  // It may go on where nobody more urgent is: on the other CPU.
  ksft_test_result(low.cpu() > 1.1, "... and the less urgent one has its CPU: %.2f s of 1.5\n",
                   low.cpu());
}

void kernel_threads() {
  World& world = loaded_world();
  world.rows[1].cpu = 0;
  world.put_rows();
  std::atomic<bool> stop{false};
  const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
  XNodeThread first(world, 0, body), second(world, 1, body);
  // An expedited RCU grace period and a flush of all per-CPU work need kernel threads on each CPU.
  std::vector<double> took;
  for (int i = 0; i < 21; ++i) {
    const auto begin = Clock::now();
    syscall(SYS_membarrier, 1 /* MEMBARRIER_CMD_GLOBAL: waits for a grace period */, 0, 0);
    took.push_back(seconds(Clock::now() - begin));
    sleep_ms(10);
  }
  stop = true;
  first.join();
  second.join();
  std::sort(took.begin(), took.end());
  ksft_test_result(took[10] < 0.3,
                   "kernel threads stay prompt under runaways: a grace period takes %.0f ms\n",
                   took[10] * 1e3);
}

void counts() {
  constexpr std::uint64_t kJobs = 200;
  World world(2, kCpu);
  world.rows[1].cpu = 0;  // one XNode on each CPU, so that each CPU counts
  world.put_rows();
  world.load();
  const std::uint64_t before = world.stat(XAUTO_BPF_STAT_LATCHED);
  {
    const auto jobs_of = [](std::uint32_t xnode) {
      return [xnode](const kernel::ThreadSlot& slot) {
        for (std::uint64_t i = 1; i <= kJobs; ++i) {
          (void)slot.tell(xnode, i);
          usleep(500);  // taken up here at the latest, on its own CPU
        }
      };
    };
    XNodeThread here(world, 0, jobs_of(0)), there(world, 1, jobs_of(1));
  }
  const std::uint64_t latched = world.stat(XAUTO_BPF_STAT_LATCHED) - before;
  std::vector<xauto_bpf_counts> each(kernel::possible_cpus().value());
  const std::uint32_t only = 0;
  if (!kernel::get_element(world.maps.fd("counts"), &only, each.data()))
    ksft_exit_fail_msg("no counts\n");
  const auto counting = std::count_if(each.begin(), each.end(), [](const xauto_bpf_counts& cpu) {
    return cpu.stats[XAUTO_BPF_STAT_LATCHED] > 0;
  });
  // Beside the jobs, each thread takes up one when it enters.
  ksft_test_result(latched >= 2 * kJobs && latched <= 2 * kJobs + 2 && counting == 2,
                   "the counts of all CPUs make one: %llu jobs taken up of %llu, on %d CPUs\n",
                   static_cast<unsigned long long>(latched), 2ULL * kJobs,
                   static_cast<int>(counting));
}

// ---- coming and going ---------------------------------------------------------------------------

void leaves_nothing() {
  const std::string folder = kernel::RunMaps::folder(loaded_world().maps.run());
  ksft_test_result(access((folder + "/table").c_str(), F_OK) == 0 &&
                       access((folder + "/cpu_states").c_str(), F_OK) == 0,
                   "the maps are pinned below %s\n", XAUTO_BPF_ROOT);
  end_loaded_world();
  ksft_test_result(scx_state() == "disabled", "ended in order, the scheduler is gone\n");
  ksft_test_result(access(folder.c_str(), F_OK) != 0, "... and so is the folder with the pins\n");
}

// Those that share a scheduler first.
const Test kTests[] = {
    {"two_spinners", 2, two_spinners},
    {"order_of_eight", 1, order_of_eight},
    {"placement", 1, placement},
    {"lowered_by_store", 2, lowered_by_store},
    {"told_while_queued", 1, told_while_queued},
    {"kick_storm", 1, kick_storm},
    {"responsive_shell", 1, responsive_shell},
    {"budget", 2, budget},
    {"kernel_threads", 1, kernel_threads},
    {"leaves_nothing", 3, leaves_nothing},
    {"counts", 1, counts},
    {"equal_priorities", 1, equal_priorities},
    {"finite_slice", 1, finite_slice},
    {"preemption", 2, preemption, true},
    {"lost_preemption", 1, lost_preemption},
    {"watchdog", 3, watchdog},
};

}  // namespace
}  // namespace xauto::test

int main(int argc, char** argv) {
  xauto::test::run_tests(xauto::test::kTests, argc > 1 ? argv[1] : "");
}
