// SPDX-License-Identifier: Apache-2.0
// The emulated XPUs in virtual time: cases by hand, and random operations that must never break a
// rule.
#include "emu/machine.h"

#include <limits>
#include <random>
#include <string>

#include <gtest/gtest.h>

#include "emu/snapshot.h"

#include "times.h"

namespace xauto::emu {
namespace {

Machine small() {
  return std::move(*Machine::create(*Platform::builtin("small")));
}

/// Runs to the end; what happened as "done1@2000 ..." with times in us.
std::string play(Machine& machine) {
  std::string out;
  std::vector<Event> events;
  while (machine.next_event() != kNever) {
    events.clear();
    machine.advance(machine.next_event(), events);
    for (const Event& e : events) {
      const char* what = e.kind == Event::Kind::kDone        ? "done"
                         : e.kind == Event::Kind::kSuspended ? "susp"
                                                             : "res";
      out += (out.empty() ? "" : " ") + std::string(what) + std::to_string(e.tag) + "@" +
             std::to_string(e.time / kUs);
    }
  }
  return out;
}

TEST(Machine, AloneAJobTakesItsTime) {
  Machine m = small();
  const ContextId a = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 7 * kMs, 0));
  EXPECT_EQ(play(m), "done1@7000");
}

TEST(Machine, BusyIsWhatHasProgressedUntilNow) {
  Machine m = small();  // slice 1000 us, switch 275 us
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 2 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 1 * kMs, 0));
  EXPECT_EQ(m.busy("gpu0", 400 * kUs).value(), 400 * kUs);
  EXPECT_EQ(m.busy("gpu0", 1200 * kUs).value(), 1000 * kUs) << "a switch is nobody's work";
  EXPECT_EQ(m.busy("gpu0", 9000 * kUs).value(), 3000 * kUs);
  EXPECT_EQ(m.busy("cpu1", 9000 * kUs).value(), 0);
  EXPECT_FALSE(m.busy("gpu1", 9000 * kUs));
}

TEST(Machine, GpuTakesTurnsAndPaysForEachSwitch) {
  Machine m = small();  // slice 1000 us, switch 275 us
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 2 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 1 * kMs, 0));
  // a 0-1000, switch, b 1275-2275 ends, a goes on free 2275-3275.
  EXPECT_EQ(play(m), "done2@2275 done1@3275");
}

TEST(Machine, NewcomerFindsTheSliceWhereItIs) {
  Machine m = small();
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 100 * kUs, 2300 * kUs));  // a's third slice ends at 3000
  EXPECT_EQ(play(m), "done2@3375 done1@5375");
}

TEST(Machine, PreemptionBlocksTheDeviceThenTheOtherRunsFree) {
  Machine m = small();
  const ContextId low = *m.open("gpu0", 0), high = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(low, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.submit(high, 2, 2 * kMs, 500 * kUs));
  ASSERT_TRUE(m.suspend(low, 9, 500 * kUs));
  std::vector<Event> events;
  m.advance(2775 * kUs, events);
  // Suspended 500-775, high 775-2775.
  EXPECT_EQ(events, (std::vector<Event>{{Event::Kind::kSuspended, low, 9, 775 * kUs},
                                        {Event::Kind::kDone, high, 2, 2775 * kUs}}));
  ASSERT_TRUE(m.resume(low, 10, 3000 * kUs));
  EXPECT_EQ(play(m), "res10@3000 done1@7500");  // 4.5 ms were left
}

TEST(Machine, SuspendingWhatDoesNotRunIsFree) {
  Machine m = small();
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 1 * kMs, 0));
  ASSERT_TRUE(m.suspend(b, 9, 0));
  ASSERT_TRUE(m.submit(b, 2, 1 * kMs, 0));
  EXPECT_EQ(play(m), "susp9@0 done1@1000");  // b waits for its resume
}

TEST(Machine, CpuPreemptionIsFree) {
  Machine m = small();
  const ContextId low = *m.open("cpu0", 0), high = *m.open("cpu0", 0);
  ASSERT_TRUE(m.submit(low, 1, 2 * kMs, 0));
  ASSERT_TRUE(m.suspend(low, 8, 1 * kMs));
  ASSERT_TRUE(m.submit(high, 2, 1 * kMs, 1 * kMs));
  ASSERT_TRUE(m.resume(low, 9, 2 * kMs));
  EXPECT_EQ(play(m), "susp8@1000 done2@2000 res9@2000 done1@3000");
}

TEST(Machine, CoreIsSharedFairly) {
  Machine m = small();
  const ContextId a = *m.open("cpu0", 0), b = *m.open("cpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 1 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 3 * kMs, 0));
  EXPECT_EQ(play(m), "done1@2000 done2@4000");
}

TEST(Machine, PoolGivesNobodyMoreThanOneCore) {
  Machine m = small();  // 4 cores
  for (std::uint64_t i = 1; i <= 5; ++i) {
    const ContextId c = *m.open("cpu", 0);
    ASSERT_TRUE(m.submit(c, i, static_cast<Nanos>(i) * kMs, 0));
  }
  // Five on four cores at 0.8 until the first ends at 1250; then each has a core.
  EXPECT_EQ(play(m), "done1@1250 done2@2250 done3@3250 done4@4250 done5@5250");
}

TEST(Machine, WhatIsNotPreemptiveRunsToItsEnd) {
  Platform platform = *Platform::builtin("small");
  platform.xpus[4].preemptive = false;
  Machine m = std::move(*Machine::create(platform));
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 3 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 1 * kMs, 0));
  EXPECT_FALSE(m.suspend(a, 9, 0));
  EXPECT_EQ(play(m), "done1@3000 done2@4000");
}

TEST(Machine, AHigherLevelTakesTheDeviceAndGivesItBackForFree) {
  Platform platform = *Platform::builtin("small");
  platform.xpus[4].levels = 3;
  Machine m = std::move(*Machine::create(platform));
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0), c = *m.open("gpu0", 0);
  ASSERT_TRUE(m.level(b, 1, 0));
  ASSERT_TRUE(m.level(c, 2, 0));
  ASSERT_TRUE(m.submit(a, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 3 * kMs, 1 * kMs));
  EXPECT_FALSE(m.level(b, 0, 1 * kMs)) << "it has a job";
  ASSERT_TRUE(m.submit(c, 3, 1 * kMs, 2 * kMs));
  // a 0-1000, 275, b 1275-2000, 275, c 2275-3275, b -5550, a -9550: nobody takes turns.
  EXPECT_EQ(play(m), "done3@3275 done2@5550 done1@9550");
  EXPECT_EQ(m.stats()[4].preemptions, 2u);
  EXPECT_EQ(m.stats()[4].switches, 0u);
  ASSERT_TRUE(m.level(b, 0, 10 * kMs));
  ASSERT_TRUE(m.submit(a, 4, 2 * kMs, 10 * kMs));
  ASSERT_TRUE(m.submit(b, 5, 1 * kMs, 10 * kMs));
  EXPECT_EQ(play(m), "done5@12275 done4@13275") << "those of one level do";
  EXPECT_FALSE(m.level(a, 3, 14 * kMs));
  EXPECT_FALSE(m.level(a, -1, 14 * kMs));
  EXPECT_FALSE(small().level(a, 0, 0)) << "no such context";
}

TEST(Machine, ALevelOutlivesTheEmulator) {
  Platform platform = *Platform::builtin("small");
  platform.xpus[4].levels = 2;
  Machine m = std::move(*Machine::create(platform));
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.level(b, 1, 0));
  ASSERT_TRUE(m.submit(a, 1, 2 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 2 * kMs, 0));
  std::vector<Event> events;
  m.advance(1 * kMs, events);
  Snapshot snapshot;
  m.save(snapshot);
  Machine next = std::move(*Machine::restore(platform, snapshot, 1 * kMs));
  EXPECT_EQ(play(next), play(m));
  for (ContextRecord& context : snapshot.contexts) context.level = 2;
  EXPECT_FALSE(Machine::restore(platform, snapshot, 1 * kMs)) << "a level that the device lacks";
}

TEST(Machine, ClosedContextTakesItsWorkAlong) {
  Machine m = small();
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 9 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 1 * kMs, 0));
  m.close(a, 200 * kUs);
  EXPECT_EQ(play(m), "done2@1200");
}

TEST(Machine, SuspendingAgainWaitsForThePreemptionUnderWay) {
  Machine m = small();
  const ContextId a = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.suspend(a, 8, 1 * kMs));
  ASSERT_TRUE(m.suspend(a, 9, 1100 * kUs));
  EXPECT_EQ(play(m), "susp8@1275 susp9@1275");
  ASSERT_TRUE(m.suspend(a, 10, 2 * kMs));
  EXPECT_EQ(play(m), "susp10@2000");
  EXPECT_EQ(m.stats()[4].preemptions, 1u);
}

TEST(Machine, RemembersTheLastJobOfAContext) {
  Machine m = small();
  const ContextId a = *m.open("gpu0", 0);
  EXPECT_EQ(m.progress(a, 7), Progress::kUnknown);
  ASSERT_TRUE(m.submit(a, 7, 1 * kMs, 0));
  EXPECT_EQ(m.progress(a, 7), Progress::kUnderWay);
  EXPECT_EQ(play(m), "done7@1000");
  EXPECT_EQ(m.progress(a, 7), Progress::kDone);
  EXPECT_EQ(m.progress(a, 8), Progress::kUnknown);
  EXPECT_FALSE(m.progress(a + 1, 7));
}

TEST(Machine, RefusesNonsense) {
  Machine m = small();
  EXPECT_FALSE(m.open("gpu7", 0));
  const ContextId a = *m.open("gpu0", 0);
  EXPECT_FALSE(m.submit(a + 1, 1, kMs, 0));
  EXPECT_FALSE(m.submit(a, 1, 0, 0));
  EXPECT_FALSE(m.submit(a, 1, kMaxWorkNs + 1, 0));
  EXPECT_TRUE(m.submit(a, 1, kMs, 0));
  EXPECT_FALSE(m.submit(a, 2, kMs, 0));  // one job at a time
  EXPECT_FALSE(m.suspend(99, 1, 0));
  EXPECT_FALSE(m.resume(99, 1, 0));
}

TEST(Machine, WorkIsConservedUnderRandomOperations) {
  for (unsigned seed = 0; seed < 300; ++seed) {
    std::mt19937 random(seed);
    Machine m = small();
    const char* devices[] = {"gpu0", "dla0", "cpu0", "cpu"};
    struct Context {
      ContextId id;
      bool busy = false, suspended = false;
    };
    std::vector<Context> contexts;
    for (int i = 0; i < 6; ++i) contexts.push_back({*m.open(devices[random() % 4], 0)});
    Nanos now = 0, submitted = 0;
    std::uint64_t jobs = 0, done = 0, requests = 0, acknowledged = 0;
    const auto collect = [&](Nanos until) {
      std::vector<Event> events;
      m.advance(until, events);
      Nanos last = 0;
      for (const Event& e : events) {
        EXPECT_LE(last, e.time);
        EXPECT_LE(e.time, until);
        last = e.time;
        if (e.kind != Event::Kind::kDone) {
          ++acknowledged;
          continue;
        }
        ++done;
        for (Context& c : contexts)
          if (c.id == e.context) {
            EXPECT_TRUE(c.busy);
            c.busy = false;
          }
      }
    };
    for (int step = 0; step < 200; ++step) {
      Context& c = contexts[random() % contexts.size()];
      switch (random() % 4) {
        case 0:
          if (!c.busy) {
            const Nanos work = 1 + static_cast<Nanos>(random() % 3'000'000);
            ASSERT_TRUE(m.submit(c.id, ++jobs, work, now));
            submitted += work;
            c.busy = true;
          }
          break;
        case 1:
          ASSERT_TRUE(m.suspend(c.id, ++requests, now));
          c.suspended = true;
          break;
        case 2:
          ASSERT_TRUE(m.resume(c.id, ++requests, now));
          c.suspended = false;
          break;
        default:
          now += static_cast<Nanos>(random() % 700'000);
          collect(now);
      }
    }
    for (Context& c : contexts) ASSERT_TRUE(m.resume(c.id, ++requests, now));
    while (m.next_event() != kNever) collect(now = std::max(now, m.next_event()));
    EXPECT_EQ(done, jobs);
    EXPECT_EQ(acknowledged, requests);
    Nanos busy = 0;
    for (const DeviceStats& s : m.stats()) busy += s.busy_ns;
    EXPECT_EQ(busy, submitted);
  }
}

}  // namespace
}  // namespace xauto::emu
