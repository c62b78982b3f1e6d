// SPDX-License-Identifier: Apache-2.0
// What computes in this process, or below it, and is no thread of the run. Judged by the CPU time that each
// counts itself.
#include "account/thread_watch.h"

#include <functional>
#include <future>
#include <thread>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "base/clock.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kLater = 2'000'000'000;

void compute_ms(std::int64_t ms) {
  const std::int64_t since = clock_ns(CLOCK_THREAD_CPUTIME_ID);
  while (clock_ns(CLOCK_THREAD_CPUTIME_ID) - since < ms * 1'000'000) {
  }
}

std::int64_t taken_us(const ThreadWatch& watch, const std::string& words) {
  for (const TakenReport& one : watch.taken())
    if (one.what.find(words) != std::string::npos) return one.us;
  return 0;
}

/// On a thread that is still there at the look.
void look_beside(ThreadWatch& watch, const std::function<void()>& work) {
  std::promise<void> computed, looked;
  std::thread thread([&] {
    work();
    computed.set_value();
    looked.get_future().wait();
  });
  computed.get_future().wait();
  watch.look(now_ns() + kLater);
  looked.set_value();
  thread.join();
}

TEST(ThreadWatch, AThreadThatCameLaterIsAStranger) {
  ThreadWatch watch({});
  if (!watch.not_watched().empty()) GTEST_SKIP() << "this kernel counts no waits";
  look_beside(watch, [] { compute_ms(30); });
  EXPECT_GE(taken_us(watch, "threads of the program"), 29'000);
}

TEST(ThreadWatch, SoIsOneThatHasEndedMeanwhile) {
  ThreadWatch watch({});
  if (!watch.not_watched().empty()) GTEST_SKIP() << "this kernel counts no waits";
  std::thread([] { compute_ms(30); }).join();
  watch.look(now_ns() + kLater);
  EXPECT_GE(taken_us(watch, "threads of the program"), 29'000);
}

TEST(ThreadWatch, ThreadsOfTheRuntimeAreNone) {
  ThreadWatch watch({});
  if (!watch.not_watched().empty()) GTEST_SKIP() << "this kernel counts no waits";
  compute_ms(30);  // this one was there
  look_beside(watch, [] {
    rt::set_thread_name("xauto/late");
    compute_ms(30);
  });
  EXPECT_LT(taken_us(watch, "threads of the program"), 25'000);
}

TEST(ThreadWatch, ChildrenAreSeenWhileTheyRunAndAfterwards) {
  ThreadWatch watch({});
  int ready[2], go[2];
  ASSERT_EQ(pipe(ready), 0);
  ASSERT_EQ(pipe(go), 0);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  char byte = 0;
  if (child == 0) {
    compute_ms(60);
    (void)!write(ready[1], &byte, 1);
    (void)!read(go[0], &byte, 1);
    _exit(0);
  }
  ASSERT_EQ(read(ready[0], &byte, 1), 1);
  watch.finish();
  EXPECT_GE(taken_us(watch, "child processes"), 30'000) << "/proc counts in ticks";
  ASSERT_EQ(write(go[1], &byte, 1), 1);
  ASSERT_EQ(waitpid(child, nullptr, 0), child);
  watch.finish();
  EXPECT_GE(taken_us(watch, "child processes"), 50'000);
  for (const int fd : {ready[0], ready[1], go[0], go[1]}) close(fd);
}

TEST(ThreadWatch, AMachineThatStoodStillIsNoQueue) {
  ThreadWatch watch({});
  watch.woke(0);
  EXPECT_EQ(taken_us(watch, "stood still"), 0);
  if (!watch.not_watched().empty()) GTEST_SKIP() << "this kernel counts no waits";
  watch.woke(3'600'000'000'000);
  EXPECT_GE(taken_us(watch, "stood still"), 1'800'000'000) << "less what this test waited";
}

TEST(ThreadWatch, WhereTheKernelTellsNothingThatIsSaid) {
  ThreadWatch watch({}, "/nowhere");
  EXPECT_NE(watch.not_watched().find("/nowhere/self/task"), std::string::npos);
  std::thread([] { compute_ms(5); }).join();
  watch.look(now_ns() + kLater);
  watch.finish();
  EXPECT_TRUE(watch.taken().empty());
}

}  // namespace
}  // namespace xauto::runtime
