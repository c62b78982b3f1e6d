// SPDX-License-Identifier: Apache-2.0
// What the sched_ext scheduler is told of a policy, and who keeps its order on real CPUs.
#include "launch/cpu_run.h"

#include <gtest/gtest.h>

#include "base/rt.h"

namespace xauto::launch {
namespace {

using runtime::CpuSched;
using runtime::Scheduling;
using runtime::Session;

/// Three XNodes on two CPUs and a GPU, all real.
Session three() {
  Session session;
  session.app.name = "app";
  session.app.xnodes = {
      {"a", "m", {{"cpu", 1000}}}, {"b", "m", {{"cpu", 10}}}, {"c", "m", {{"gpu", 5}}}};
  session.platform = {"p", {{"cpu0", "cpu"}, {"cpu1", "cpu"}, {"gpu0", "gpu"}}};
  session.policy.placements = {{1, 70}, {1, -3}, {2, 9}};
  return session;
}

CpuRunRequest request_of(const Session& session) {
  return {.run = "1-0",
          .bin = "",
          .app = session.app,
          .platform = session.platform,
          .tables = {&session.policy},
          .real = {true, true, true},
          .budget_pct = 150};
}

TEST(TableRows, APriorityIsAKeyThatNoReleaseMoves) {
  const Session session = three();
  const auto rows = table_rows(request_of(session), {4, 6});
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_EQ(rows[0].cpu, 6u);
  EXPECT_EQ(rows[0].key, -70);
  EXPECT_EQ(rows[0].budget_us, 1500);
  EXPECT_EQ(rows[1].key, 3);
  EXPECT_EQ(rows[2].cpu, XAUTO_BPF_NO_CPU);
}

TEST(TableRows, OfAPolicyOfKeysEachJobTellsItsOwn) {
  const Session session = three();
  CpuRunRequest request = request_of(session);
  request.keys = true;
  const auto rows = table_rows(request, {4, 6});
  EXPECT_EQ(rows[0].key, 0);
  EXPECT_EQ(rows[1].key, 0);
}

TEST(CpuKeeper, SaysWhoKeepsTheOrderOnRealCpus) {
  Session session = three();
  const int highest = rt::highest_fifo();
  const bool levels = highest >= 6;  // those of a core that follows keys, and those above
  const auto keeper = [&](CpuSched asked) {
    session.cpu.sched = asked;
    decide_cpu_by_keys(session);
    return cpu_keeper(session);
  };
  EXPECT_EQ(keeper(CpuSched::kExt), "sched_ext");
  EXPECT_EQ(keeper(CpuSched::kFifo), highest > 0 ? "SCHED_FIFO" : "nobody");
  EXPECT_EQ(keeper(CpuSched::kOther), "nobody");
  session.keys.emplace();
  EXPECT_EQ(keeper(CpuSched::kExt), "sched_ext");
  EXPECT_FALSE(session.cpu.by_keys) << "the kernel orders by keys itself";
  EXPECT_EQ(keeper(CpuSched::kFifo), levels ? "SCHED_FIFO, told by coordinators" : "nobody");
  EXPECT_EQ(session.cpu.by_keys, levels);
  EXPECT_EQ(keeper(CpuSched::kOther), "nobody");
  EXPECT_FALSE(session.cpu.by_keys);
}

TEST(CpuKeeper, SaysNothingWhereThereIsNoOrderToKeep) {
  Session session = three();
  session.scheduling = Scheduling::kTimeshare;
  decide_cpu_by_keys(session);
  EXPECT_EQ(cpu_keeper(session), "");
  session.scheduling = Scheduling::kXAuto;
  session.presence = {Presence::kEmulated, Presence::kEmulated, Presence::kReal};
  EXPECT_EQ(cpu_keeper(session), "");
}

}  // namespace
}  // namespace xauto::launch
