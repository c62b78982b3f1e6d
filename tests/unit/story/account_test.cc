// SPDX-License-Identifier: Apache-2.0
#include "story/account.h"

#include <algorithm>
#include <numeric>
#include <random>

#include <gtest/gtest.h>

#include "story/perfetto.h"

#include "tiny_run.h"

namespace xauto::story {
namespace {

using test::Tiny;

ReadTrace read(const Tiny& tiny) {
  const auto trace = read_trace(tiny.file(), "t.pftrace");
  EXPECT_TRUE(trace) << trace.error().to_string();
  return trace.value_or(ReadTrace());
}

Account account(const ReadTrace& trace, std::int64_t release) {
  const auto account = account_of(trace, release);
  EXPECT_TRUE(account) << account.error().to_string();
  return account.value_or(Account());
}

std::int64_t sum(const Account& a) {
  return std::accumulate(
      a.steps.begin(), a.steps.end(), a.publish_us,
      [](std::int64_t total, const ChainStep& s) { return total + s.took_us(); });
}

TEST(Account, APreemptedStepSaysByWhomAndForHowLong) {
  Tiny tiny;
  tiny.release(0, 0);
  const Account a = account(read(tiny), 0);
  EXPECT_EQ(a.latency_us, 721);
  EXPECT_EQ(a.planned_us, 710);
  ASSERT_EQ(a.steps.size(), 1u);  // BIG is done last, and waits for nobody's output
  const ChainStep& step = a.steps[0];
  EXPECT_EQ(step.xnode, "big.infer");
  EXPECT_EQ(step.xpu, "gpu0");
  EXPECT_EQ(step.handover_us, 4);
  EXPECT_EQ(step.waited_us, 8 - 4);
  EXPECT_EQ(step.ran_us, (104 - 8) + (720 - 318));
  EXPECT_EQ(step.switched_us, (114 - 104) + (318 - 315));
  EXPECT_EQ(step.suspended_us, 315 - 114);
  ASSERT_EQ(step.preempted_by.size(), 1u);
  EXPECT_EQ(step.preempted_by[0].who, "cam.infer");
  EXPECT_EQ(step.preempted_by[0].us, 318 - 115);  // until big.infer has the XPU again
  EXPECT_EQ(step.planned_us, 500);
  EXPECT_EQ(step.planned_end_us, 710);
  EXPECT_EQ(a.publish_us, 1);
  EXPECT_EQ(sum(a), a.latency_us);
}

TEST(Account, WhatAWorkerSaysOfAHoldIsInTheStory) {
  Tiny tiny;
  tiny.release(0, 0);
  for (trace::Event& event : tiny.trace.events)
    if (event.kind == XAUTO_EV_START && event.xnode == 2) event.arg = 3;
  EXPECT_EQ(account(read(tiny), 0).steps[0].held_us, 3);
  for (trace::Event& event : tiny.trace.events)
    if (event.kind == XAUTO_EV_START && event.xnode == 2) event.arg = 4'000'000'000;
  const Account damaged = account(read(tiny), 0);
  EXPECT_EQ(damaged.steps[0].held_us, damaged.steps[0].waited_us) << "no more than it waited";
}

/// As Tiny::release(), but BIG's end was lost: CAM's output is the last.
Tiny only_cam_ends() {
  Tiny tiny;
  tiny.release(0, 0);
  while (tiny.trace.events.back().kind != XAUTO_EV_DONE || tiny.trace.events.back().module != 0)
    tiny.trace.events.pop_back();
  tiny.scene.modules[1].sink = false;
  return tiny;
}

TEST(Account, TheChainIsFollowedFromTheOutputToTheSensors) {
  const Account a = account(read(only_cam_ends()), 0);
  ASSERT_EQ(a.steps.size(), 2u);
  EXPECT_EQ(a.steps[0].xnode, "cam.pre");
  EXPECT_EQ(a.steps[0].xpu, "cpu0");
  EXPECT_EQ(a.steps[1].xnode, "cam.infer");
  EXPECT_EQ(a.steps[1].handover_us, 1);
  EXPECT_EQ(a.steps[1].waited_us, 115 - 101);
  ASSERT_EQ(a.steps[1].waited_for.size(), 1u);
  EXPECT_EQ(a.steps[1].waited_for[0].who, "big.infer");
  EXPECT_EQ(a.steps[1].waited_for[0].us, 3);  // then it was being taken off
  EXPECT_EQ(sum(a), a.latency_us);
}

TEST(Account, ItsWordsHoldTheSameNumbers) {
  EXPECT_EQ(account_text(account(read(only_cam_ends()), 0)),
            "release 0 took 0.321 ms, the longest of 1; the median is 0.321, the plan 0.710.\n"
            "\n"
            "    took ms   ends at   planned   step         on       why\n"
            "      0.100     0.100     0.100   cam.pre      cpu0     nothing but its work\n"
            "      0.218     0.318     0.310   cam.infer    gpu0     nothing but its work\n"
            "      0.003     0.321             published\n"
            "      0.321   in all\n"
            "\n"
            "  Of it 0.297 ms is work, 0.018 waiting for an XPU, 0.000 suspended, 0.000 switching, "
            "0.006 handing over.\n");
}

TEST(Account, WorkBeyondThePlanIsSaid) {
  ChainStep step;
  step.ran_us = 700;
  step.planned_us = 500;
  EXPECT_EQ(reasons_of(step, 10), "ran 0.200 ms longer than planned");
  EXPECT_EQ(reasons_of(step, 201), "");
  step.beside = {{"a", 100}, {"b", 40}};
  EXPECT_EQ(reasons_of(step, 10), "ran 0.200 ms longer than planned, beside a (0.100), b (0.040)");
  step.beside = {{"a", 4}, {"b", 3}, {"c", 2}, {"d", 1}, {"e", 1}};
  EXPECT_EQ(
      reasons_of(step, 10),
      "ran 0.200 ms longer than planned, beside a (0.004), b (0.003), c (0.002) and 2 others");
  step.planned_us = -1;
  EXPECT_EQ(reasons_of(step, 10), "");
}

/// Two rates. Sensor 0 feeds CAM; BIG joins CAM's result with sensor 1's message, which comes 50 us
/// after CAM has ended. Numbers lie: an earlier activation of CAM has the number of the later one.
Tiny two_rates() {
  Tiny tiny;
  tiny.app.edges = {{0, 1}, {1, 2}};
  tiny.scene.modules[0].sink = false;
  const auto ns = [](std::int64_t us) { return static_cast<std::uint64_t>(1'000'000 + us * 1000); };
  const auto cam = [&](std::int64_t us) {
    tiny.at(us, XAUTO_EV_PUBLISH, 0);
    tiny.at(us + 1, XAUTO_EV_ACTIVATE, 0, test::kNone, 0);
    tiny.at(us + 1, XAUTO_EV_TAKE, ns(us), test::kNone, 0, test::kNone, XAUTO_TAKE_SOURCE);
    tiny.at(us + 2, XAUTO_EV_READY, 0, 0, 0, 0);
    tiny.at(us + 2, XAUTO_EV_RUN, 0, 0, 0, 0);
    tiny.at(us + 100, XAUTO_EV_FINISH, 0, 0, 0, 0);
    tiny.at(us + 101, XAUTO_EV_READY, 0, 1, 0, 1);
    tiny.at(us + 105, XAUTO_EV_RUN, 0, 1, 0, 1);
    tiny.at(us + 300, XAUTO_EV_FINISH, 0, 1, 0, 1);
    tiny.at(us + 301, XAUTO_EV_DONE, 0, test::kNone, 0);
  };
  cam(0);
  cam(1000);
  tiny.at(1350, XAUTO_EV_PUBLISH, 0);
  tiny.at(1352, XAUTO_EV_ACTIVATE, 0, test::kNone, 1);
  tiny.at(1352, XAUTO_EV_TAKE, ns(1000), test::kNone, 1, test::kNone, 0);
  tiny.at(1352, XAUTO_EV_TAKE, ns(1350), test::kNone, 1, test::kNone, XAUTO_TAKE_SOURCE | 1);
  tiny.at(1353, XAUTO_EV_READY, 0, 2, 1, 1);
  tiny.at(1360, XAUTO_EV_RUN, 0, 2, 1, 1);
  tiny.at(1860, XAUTO_EV_FINISH, 0, 2, 1, 1);
  tiny.at(1861, XAUTO_EV_DONE, 0, test::kNone, 1);
  return tiny;
}

TEST(Account, WithSeveralRatesAChainIsFollowedThroughWhatWasTaken) {
  const ReadTrace trace = read(two_rates());
  ASSERT_EQ(trace.chains.size(), 1u);
  const TraceChain& chain = trace.chains.front();
  EXPECT_EQ(chain.name, "BIG");
  ASSERT_EQ(chain.results.size(), 1u);
  const auto a = account_of(trace, chain, *worst_of(chain.results));
  ASSERT_TRUE(a) << a.error().to_string();
  EXPECT_EQ(a->latency_us, 861);  // from the oldest message on
  EXPECT_EQ(a->planned_us, -1);
  ASSERT_EQ(a->steps.size(), 3u);
  EXPECT_EQ(a->steps[0].xnode, "cam.pre");
  EXPECT_EQ(a->steps[1].xnode, "cam.infer");
  EXPECT_EQ(a->steps[2].xnode, "big.infer");
  EXPECT_EQ(a->steps[0].begin_us, 2);  // of the later activation: its number is the earlier one's
  EXPECT_EQ(a->steps[1].end_us, 300);
  EXPECT_EQ(a->steps[2].handover_us, 53);
  EXPECT_EQ(a->steps[2].sensor_us, 50);
  EXPECT_EQ(a->steps[2].waited_us, 7);
  EXPECT_EQ(sum(*a), a->latency_us);
  EXPECT_EQ(reasons_of(a->steps[2], 50), "needed a message that was released 0.050 ms later");
  EXPECT_EQ(account_text(*a).substr(0, 66),
            "BIG: release 0 took 0.861 ms, the longest of 1; the median is 0.86");
}

TEST(Account, WithSeveralRatesWhatWasNotTakenIsNotGuessed) {
  Tiny tiny = two_rates();
  // CAM's output is of an origin that is not in the trace.
  for (trace::Event& event : tiny.trace.events)
    if (event.kind == XAUTO_EV_TAKE && event.arg == 0) event.seq -= 1;
  const ReadTrace trace = read(tiny);
  ASSERT_EQ(trace.chains.size(), 1u);
  const auto a = account_of(trace, trace.chains[0], trace.chains[0].results[0]);
  ASSERT_TRUE(a) << a.error().to_string();
  ASSERT_EQ(a->steps.size(), 1u);  // the chain begins where nothing is known before it
  EXPECT_EQ(sum(*a), a->latency_us);
}

TEST(Account, AModuleThatIsStillBusyWithAnotherReleaseIsNamed) {
  Tiny tiny;
  tiny.release(0, 0);  // BIG ends at 720
  tiny.at(730, XAUTO_EV_PUBLISH, 1);
  tiny.at(740, XAUTO_EV_ACTIVATE, 1, test::kNone, 0);
  tiny.at(740, XAUTO_EV_READY, 1, 0, 0, 0);
  tiny.at(740, XAUTO_EV_RUN, 1, 0, 0, 0);
  tiny.at(840, XAUTO_EV_FINISH, 1, 0, 0, 0);
  tiny.at(840, XAUTO_EV_DONE, 1, test::kNone, 0);
  tiny.at(745, XAUTO_EV_ACTIVATE, 1, test::kNone, 1);
  std::stable_sort(tiny.trace.events.begin(), tiny.trace.events.end(),
                   [](const trace::Event& a, const trace::Event& b) { return a.ts_ns < b.ts_ns; });
  tiny.at(850, XAUTO_EV_READY, 1, 2, 1, 1);
  tiny.at(850, XAUTO_EV_RUN, 1, 2, 1, 1);
  tiny.at(900, XAUTO_EV_PUBLISH, 2);
  tiny.at(1400, XAUTO_EV_FINISH, 1, 2, 1, 1);
  tiny.at(1401, XAUTO_EV_DONE, 1, test::kNone, 1);
  tiny.at(1402, XAUTO_EV_ACTIVATE, 2, test::kNone, 1);
  tiny.at(1402, XAUTO_EV_READY, 2, 2, 1, 1);
  tiny.at(1402, XAUTO_EV_RUN, 2, 2, 1, 1);
  tiny.at(1902, XAUTO_EV_FINISH, 2, 2, 1, 1);
  tiny.at(1903, XAUTO_EV_DONE, 2, test::kNone, 1);
  tiny.scene.modules[0].sink = false;
  const Account a = account(read(tiny), 2);
  ASSERT_EQ(a.steps.size(), 1u);
  EXPECT_EQ(a.steps[0].handover_us, 502);
  ASSERT_EQ(a.steps[0].busy_with.size(), 1u);
  EXPECT_EQ(a.steps[0].busy_with[0].who, "big.infer of release 1");
  EXPECT_EQ(a.steps[0].busy_with[0].us, 500);
  EXPECT_EQ(reasons_of(a.steps[0], 10),
            "its module was busy for 0.502 ms with big.infer of release 1");
  EXPECT_EQ(a.rank, 1);
  EXPECT_EQ(a.of, 3);
  const ReadTrace trace = read(tiny);
  EXPECT_EQ(worst_of(trace.releases)->number, 2);
  EXPECT_EQ(median_of(trace.releases)->number, 0);
}

TEST(Account, WaitingIsSaidWithTheShareOfEach) {
  ChainStep step;
  step.waited_us = 100;
  EXPECT_EQ(reasons_of(step, 50), "waited 0.100 ms, nobody had the XPU");
  step.waited_for = {{"a", 95}};
  EXPECT_EQ(reasons_of(step, 50), "waited 0.100 ms for a");
  step.waited_for = {{"a", 30}};
  EXPECT_EQ(reasons_of(step, 50),
            "waited 0.100 ms for a (0.030); for 0.070 ms of it nobody had the XPU");
  EXPECT_EQ(reasons_of(step, 101), "");
  step.held_us = 60;
  step.waited_for = {{"a", 30}};
  EXPECT_EQ(reasons_of(step, 20), "held for 0.060 ms by its policy; waited 0.040 ms for a (0.030)");
  step.held_us = 100;
  EXPECT_EQ(reasons_of(step, 20), "held for 0.100 ms by its policy");
  step = {};
  step.switched_us = 60;
  step.suspended_us = 200;
  step.preempted_by = {{"a", 200}};
  EXPECT_EQ(reasons_of(step, 50), "off the XPU for 0.260 ms, preempted by a, switching 0.060");
}

TEST(Account, ReleasesWithoutLatencyAreRefusedWithTheReason) {
  Tiny tiny;
  tiny.release(0, 0);
  tiny.at(2000, XAUTO_EV_PUBLISH, 1);
  const ReadTrace trace = read(tiny);
  EXPECT_EQ(account_of(trace, 7).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(account_of(trace, 7).error().to_string(),
            "release 7: is not in the trace\n  hint: it has 0 to 1");
  EXPECT_EQ(account_of(trace, 1).error().code, ErrorCode::kInfeasible);
  ReadTrace without = trace;
  without.run.clear();
  EXPECT_EQ(account_of(without, 0).error().code, ErrorCode::kInfeasible);
}

/// Whatever was lost or is late, the parts are not negative and add up.
TEST(Account, ItAddsUpWhateverIsMissing) {
  std::mt19937 random(5);
  int accounts = 0;
  for (int round = 0; round < 400; ++round) {
    Tiny tiny;
    for (std::uint64_t seq = 0; seq < 3; ++seq)
      tiny.release(static_cast<std::int64_t>(seq) * 300, seq);
    for (auto& event : tiny.trace.events) event.ts_ns += random() % 200'000;
    std::stable_sort(
        tiny.trace.events.begin(), tiny.trace.events.end(),
        [](const trace::Event& a, const trace::Event& b) { return a.ts_ns < b.ts_ns; });
    for (unsigned lost = 0; lost < random() % 4; ++lost)
      tiny.trace.events.erase(tiny.trace.events.begin() +
                              static_cast<std::ptrdiff_t>(random() % tiny.trace.events.size()));
    const auto trace = read_trace(tiny.file(), "t.pftrace");
    ASSERT_TRUE(trace) << trace.error().to_string();
    for (const TraceRelease& release : trace->releases) {
      const auto a = account_of(*trace, release.number);
      if (!a) continue;
      ++accounts;
      EXPECT_EQ(sum(*a), a->latency_us);
      EXPECT_GE(a->publish_us, 0);
      for (const ChainStep& s : a->steps)
        for (const auto part :
             {s.handover_us, s.waited_us, s.ran_us, s.switched_us, s.suspended_us})
          EXPECT_GE(part, 0) << s.xnode;
    }
  }
  EXPECT_GT(accounts, 200);
}

}  // namespace
}  // namespace xauto::story
