// SPDX-License-Identifier: Apache-2.0
#include "base/rt.h"

#include <chrono>
#include <functional>
#include <future>
#include <optional>
#include <thread>

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/clock.h"

namespace xauto::rt {
namespace {

/// In a process of its own that has given up root, with a real-time limit; true: `holds` held.
bool as_nobody(rlim_t limit, const std::function<bool()>& holds) {
  const pid_t pid = fork();
  if (pid == 0) {
    const rlimit both{limit, limit};
    const bool ready =
        setrlimit(RLIMIT_RTPRIO, &both) == 0 && setgid(65534) == 0 && setuid(65534) == 0;
    _exit(ready ? (holds() ? 0 : 1) : 77);
  }
  int status = 0;
  waitpid(pid, &status, 0);
  EXPECT_TRUE(WIFEXITED(status));
  if (WEXITSTATUS(status) == 77) return true;  // no right to become nobody, or to that limit
  return WEXITSTATUS(status) == 0;
}

TEST(Rt, HighestPriorityIsTheOneThatTheKernelAcceptsLast) {
  const int highest = highest_fifo();
  EXPECT_GE(highest, 0);
  EXPECT_LE(highest, 99);
  if (highest > 0) {
    EXPECT_TRUE(may_use_fifo(highest));
  }
  if (highest < 99) {
    EXPECT_FALSE(may_use_fifo(highest + 1));
  }
}

/// What a thread that computes did not run for, by the clock of its CPU time, it waited for. Two of them
/// share a core.
TEST(Rt, WithoutACoreIsWhatAThreadThatComputesDoesNotRun) {
  if (!without_core_ns()) GTEST_SKIP() << "this kernel does not count it";
  const auto compute = [] {
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(allowed_cores().front(), &one);
    sched_setaffinity(0, sizeof one, &one);
    const std::int64_t waited = *without_core_ns(), since = now_ns();
    const std::int64_t ran = clock_ns(CLOCK_THREAD_CPUTIME_ID);
    while (clock_ns(CLOCK_THREAD_CPUTIME_ID) - ran < 100'000'000) {
    }
    const std::int64_t all = now_ns() - since;
    const std::int64_t not_run = all - (clock_ns(CLOCK_THREAD_CPUTIME_ID) - ran);
    const std::int64_t told = *without_core_ns() - waited;
    EXPECT_GT(told, 0);
    EXPECT_NEAR(static_cast<double>(told), static_cast<double>(not_run), 1e6 + 0.02 * 1e8);
  };
  std::thread other(compute);
  std::thread(compute).join();
  other.join();
}

TEST(Rt, ASleeperHasItsCore) {
  const auto waited = without_core_ns();
  if (!waited) GTEST_SKIP() << "this kernel does not count it";
  const std::int64_t since = now_ns();
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  const std::int64_t all = now_ns() - since;
  EXPECT_GE(all - (*without_core_ns() - *waited), 20'000'000);
}

TEST(Rt, OthersTellOfASleeperAndNotOfWhoRuns) {
  if (!without_core_ns()) GTEST_SKIP() << "this kernel does not count it";
  EXPECT_FALSE(without_core_ns(gettid())) << "who asks runs";
  EXPECT_FALSE(without_core_ns(1)) << "a thread of another process";
  std::promise<pid_t> tid;
  std::promise<void> leave;
  std::int64_t own_ns = -1;
  std::thread sleeper([&] {
    set_thread_name("a) R 1 (b");
    own_ns = *without_core_ns();
    tid.set_value(gettid());
    leave.get_future().wait();
  });
  const pid_t asleep = tid.get_future().get();
  std::optional<std::int64_t> told;
  while (!told) told = without_core_ns(asleep);  // it is about to sleep
  leave.set_value();
  sleeper.join();
  EXPECT_GE(*told, own_ns);
}

TEST(Rt, WithoutRootTheLimitDecides) {
  EXPECT_TRUE(
      as_nobody(0, [] { return highest_fifo() == 0 && !set_fifo_up_to(60) && !may_use_fifo(1); }));
  EXPECT_TRUE(as_nobody(20, [] {
    if (highest_fifo() != 20 || may_use_fifo(21) || !set_fifo_up_to(60)) return false;
    sched_param got{};
    sched_getparam(0, &got);
    return sched_getscheduler(0) == SCHED_FIFO && got.sched_priority == 20;
  }));
}

TEST(Rt, HintSaysWhereTheLimitComesFrom) {
  EXPECT_NE(way_to_fifo(false).find("/etc/security/limits.d/xauto.conf"), std::string::npos);
  EXPECT_NE(way_to_fifo(true).find("CAP_SYS_NICE"), std::string::npos);
  EXPECT_EQ(way_to_fifo(true).find("as root"), std::string::npos);
  for (const bool root : {false, true})
    EXPECT_NE(way_to_fifo(root).find("LimitRTPRIO=60"), std::string::npos);
  EXPECT_NE(fifo_hint().find(way_to_fifo(geteuid() == 0)), std::string::npos);
}

}  // namespace
}  // namespace xauto::rt
