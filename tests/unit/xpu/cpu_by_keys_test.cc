// SPDX-License-Identifier: Apache-2.0
// A thread that is suspended by keys: what Linux says of its priority.
#include <future>
#include <thread>

#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include "base/rt.h"
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

int priority_of(int tid) {
  sched_param now{};
  EXPECT_EQ(sched_getparam(tid, &now), 0);
  return now.sched_priority;
}

TEST(CpuByKeys, LowersTheExecutionThreadBelowAllThatAreAdmittedAndRaisesItAgain) {
  if (rt::highest_fifo() < kCpuAsks) GTEST_SKIP() << rt::fifo_hint();
  auto backend = make_cpu_by_keys({"cpu0", XPU::CPU, 0}).value();
  std::promise<int> attached;
  std::promise<void> over;
  std::thread execution([&] {
    ASSERT_TRUE(rt::set_fifo(kCpuAsks));
    EXPECT_TRUE(backend->attach(SchedHandle::thread()));
    attached.set_value(gettid());
    over.get_future().wait();
  });
  const int tid = attached.get_future().get();
  const SchedHandle handle = SchedHandle::thread();
  EXPECT_TRUE(backend->restore(handle)) << "what runs may be resumed";
  EXPECT_EQ(priority_of(tid), kCpuAsks);
  EXPECT_TRUE(backend->preempt(handle));
  EXPECT_EQ(priority_of(tid), kCpuAsks) << "it has no job yet; its START must not wait";
  backend->admitted(SchedHandle::thread(), false);
  EXPECT_EQ(priority_of(tid), kCpuLowered) << "it was taken before it came to run";
  EXPECT_TRUE(backend->restore(handle));
  EXPECT_EQ(priority_of(tid), kCpuAdmitted);
  EXPECT_TRUE(backend->preempt(handle));
  EXPECT_TRUE(backend->preempt(handle)) << "what is suspended may be suspended";
  EXPECT_EQ(priority_of(tid), kCpuLowered);
  backend->finishing(SchedHandle::thread(), false);
  EXPECT_EQ(priority_of(tid), kCpuAsks);
  EXPECT_TRUE(backend->restore(handle));
  EXPECT_EQ(priority_of(tid), kCpuAsks) << "late: it is at its next START";
  over.set_value();
  execution.join();
}

TEST(CpuByKeys, TakesAHandleOfAThreadAlone) {
  auto backend = make_cpu_by_keys({"cpu0", XPU::CPU, 0}).value();
  EXPECT_TRUE(backend->attach(SchedHandle::gate()));
  EXPECT_FALSE(
      backend->attach(SchedHandle::custom([] { return Status(); }, [] { return Status(); })));
}

}  // namespace
}  // namespace xauto::xpu
