// SPDX-License-Identifier: Apache-2.0
// What a worker stores for the scheduler.
#include "kernel/thread_slots.h"

#include <gtest/gtest.h>

namespace xauto::kernel {
namespace {

TEST(ThreadSlot, TellsAJobWithItsKeyAndWhenItAsked) {
  xauto_bpf_slot memory{};
  const ThreadSlot slot(&memory);
  EXPECT_FALSE(slot.tell(3, 7, {-5, 100}));
  EXPECT_EQ(memory.job, XAUTO_BPF_JOB(3, 7));
  EXPECT_EQ(memory.key, -5);
  EXPECT_EQ(memory.asked_ns, 100u);
  slot.tell(4, 7);
  EXPECT_EQ(memory.key, 0) << "what was told of the last job is not of this one";
  EXPECT_EQ(memory.asked_ns, 0u);
}

TEST(ThreadSlot, AskedWhenTheJobWasToldFirst) {
  xauto_bpf_slot memory{};
  const ThreadSlot slot(&memory);
  slot.tell(3, 7, {40, 100});
  slot.tell(3, 7, {40, 200});
  EXPECT_EQ(memory.asked_ns, 100u) << "whoever handed it over has told it";
  slot.end();
  slot.tell(3, 8, {50, 300});
  EXPECT_EQ(memory.asked_ns, 300u);
}

TEST(ThreadSlot, SaysWhetherSomebodyWaitsAlsoOfAJobThatWasTold) {
  xauto_bpf_slot memory{};
  const ThreadSlot slot(&memory);
  memory.waiting = 1;
  EXPECT_TRUE(slot.tell(3, 7));
  EXPECT_TRUE(slot.tell(3, 7));
}

}  // namespace
}  // namespace xauto::kernel
