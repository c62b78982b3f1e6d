// SPDX-License-Identifier: Apache-2.0
#include "bench/synthetic/time_sharing.h"

#include <deque>

#include <gtest/gtest.h>

#include "problem_random.h"

namespace xauto::solver::test {
namespace {

using bench::share_time, bench::Sharing;

AppSpec singles(const std::vector<std::map<std::string, std::int64_t, std::less<>>>& wcets) {
  AppSpec app;
  app.name = "t";
  for (std::size_t i = 0; i < wcets.size(); ++i)
    app.xnodes.push_back(
        {numbered("x", static_cast<int>(i)), numbered("m", static_cast<int>(i)), wcets[i]});
  return app;
}

Platform cpus(int count) {
  Platform platform{"p", {}};
  for (int i = 0; i < count; ++i)
    platform.xpus.push_back({numbered("cpu", i), "cpu", true, 0, 0, -1});
  return platform;
}

TEST(TimeSharing, TwoXNodesOnOneCpuProgressAtHalfSpeed) {
  const Platform platform = cpus(1);
  const Problem p = *Problem::create(singles({{{"cpu", 10}}, {{"cpu", 4}}}), platform);
  const Simulation s = share_time(p, platform, Sharing::kTimeshare, {{0, 0}, {2, 1}, {}});
  EXPECT_EQ(s.finish, (std::vector<Time>{14, 8}));
}

TEST(TimeSharing, Ros2PoolsTheCpusAndAnXNodeNeverGetsMoreThanOne) {
  const Platform platform = cpus(2);
  const Problem p = *Problem::create(singles({{{"cpu", 6}}, {{"cpu", 6}}, {{"cpu", 7}}}), platform);
  // 2/3 speed until 9, when the third has 1 left and a core for itself.
  EXPECT_EQ(share_time(p, platform, Sharing::kRos2, {}).finish, (std::vector<Time>{9, 9, 10}));
}

TEST(TimeSharing, ResultsAreRoundedUpToMicroseconds) {
  const Platform platform = cpus(2);
  const Problem p = *Problem::create(singles({{{"cpu", 1}}, {{"cpu", 1}}, {{"cpu", 1}}}), platform);
  EXPECT_EQ(share_time(p, platform, Sharing::kRos2, {}).makespan, 2);  // 1.5
}

TEST(TimeSharing, Ros2TakesTheFastestTypeAndTiesTheFirstOfThePlatform) {
  Platform platform = cpus(1);
  platform.xpus.push_back({"gpu0", "gpu", true, 2, 4, -1});
  const Problem p =
      *Problem::create(singles({{{"cpu", 10}, {"gpu", 9}}, {{"cpu", 5}, {"gpu", 5}}}), platform);
  const Simulation s = share_time(p, platform, Sharing::kRos2, {});
  EXPECT_EQ(s.xpu, (std::vector<int>{1, 0}));
  EXPECT_EQ(s.finish, (std::vector<Time>{9, 5}));
}

TEST(TimeSharing, RoundRobinPaysASwitchAtEachChangeOfContext) {
  Platform platform{"p", {{"gpu0", "gpu", true, 1, 4, -1}}};
  const Problem p = *Problem::create(singles({{{"gpu", 6}}, {{"gpu", 5}}}), platform);
  // x0 0-4, switch, x1 5-9, switch, x0 10-12 ends: no switch, x1 12-13.
  const Simulation s =
      share_time(p, platform, Sharing::kTimeshare, {{0, 0}, {2, 1}, {}}, {.slices = true});
  EXPECT_EQ(s.finish, (std::vector<Time>{12, 13}));
  Time switching = 0;
  for (const Slice& slice : s.slices) switching += slice.switching ? slice.end - slice.begin : 0;
  EXPECT_EQ(switching, 2);
}

TEST(TimeSharing, SwitchCostOfThePlatformReplacesThePreemptionCost) {
  Platform platform{"p", {{"gpu0", "gpu", true, 1, 4, 3}}};
  const Problem p = *Problem::create(singles({{{"gpu", 6}}, {{"gpu", 5}}}), platform);
  EXPECT_EQ(share_time(p, platform, Sharing::kTimeshare, {{0, 0}, {2, 1}, {}}).makespan, 17);
}

TEST(TimeSharing, IdealSharingIgnoresSlicesAndCosts) {
  Platform platform{"p", {{"gpu0", "gpu", true, 1, 4, -1}}};
  const Problem p = *Problem::create(singles({{{"gpu", 6}}, {{"gpu", 5}}}), platform);
  EXPECT_EQ(
      share_time(p, platform, Sharing::kTimeshare, {{0, 0}, {2, 1}, {}}, {.ideal = true}).finish,
      (std::vector<Time>{11, 10}));
}

TEST(TimeSharing, NonPreemptiveXpuServesInOrderOfArrival) {
  Platform platform{"p", {{"gpu0", "gpu", false, 1, 4, -1}}};
  const Problem p = *Problem::create(singles({{{"gpu", 6}}, {{"gpu", 5}}}), platform);
  EXPECT_EQ(share_time(p, platform, Sharing::kTimeshare, {{0, 0}, {2, 1}, {}}).finish,
            (std::vector<Time>{6, 11}));
}

TEST(TimeSharing, Ros2JoinsTheInstanceWithTheFewestXNodes) {
  Platform platform{"p", {{"dla0", "dla", true, 0, 4, 0}, {"dla1", "dla", true, 0, 4, 0}}};
  const Problem p = *Problem::create(singles({{{"dla", 6}}, {{"dla", 5}}, {{"dla", 9}}}), platform);
  EXPECT_EQ(share_time(p, platform, Sharing::kRos2, {}).xpu, (std::vector<int>{0, 1, 0}));
}

/// Round-robin once more, a microsecond at a time.
std::vector<Time> naive_round_robin(const Problem& p, const Platform& platform, const Decision& d) {
  const auto n = static_cast<std::size_t>(p.num_xnodes);
  struct Device {
    std::deque<int> queue;
    Time slice = 0, switching = 0;
  };
  std::vector<Device> devices(platform.xpus.size());
  std::vector<Time> left(n), finish(n, -1);
  std::vector<char> queued(n, 0);
  for (std::size_t x = 0; x < devices.size(); ++x) devices[x].slice = platform.xpus[x].timeslice_us;
  for (Time now = 0;; ++now) {
    for (std::size_t i = 0; i < n; ++i) {
      bool ready = !queued[i];
      for (const int u : p.pred[i]) ready = ready && finish[static_cast<std::size_t>(u)] >= 0;
      if (!ready) continue;
      queued[i] = 1;
      left[i] = p.wcet_on(static_cast<int>(i), d.xpu[i]);
      devices[static_cast<std::size_t>(d.xpu[i])].queue.push_back(static_cast<int>(i));
    }
    bool idle = true;
    for (std::size_t x = 0; x < devices.size(); ++x) {
      Device& device = devices[x];
      if (device.queue.empty()) continue;
      idle = false;
      if (device.switching > 0) {
        --device.switching;
        continue;
      }
      const auto front = static_cast<std::size_t>(device.queue.front());
      --device.slice;
      if (--left[front] == 0) {
        finish[front] = now + 1;
        device.queue.pop_front();
        device.slice = platform.xpus[x].timeslice_us;
      } else if (device.slice == 0) {
        device.slice = platform.xpus[x].timeslice_us;
        if (device.queue.size() > 1) {
          device.queue.push_back(device.queue.front());
          device.queue.pop_front();
          device.switching = platform.xpus[x].effective_switch_us();
        }
      }
    }
    if (idle) return finish;
  }
}

TEST(TimeSharing, RoundRobinAgreesWithSteppingThroughEveryMicrosecond) {
  Dice dice(1);
  for (int round = 0; round < 2000; ++round) {
    Platform platform{"p", {}};
    const int devices = dice.roll(1, 3);
    for (int i = 0; i < devices; ++i)
      platform.xpus.push_back(
          {numbered("gpu", i), "gpu", true, dice.roll(0, 3), dice.roll(1, 5), -1});
    Shape shape;
    shape.max_nodes = 10;
    const AppSpec app = random_app(dice, shape, platform);
    const Problem p = *Problem::create(app, platform);
    const Decision d = random_decision(dice, p);
    ASSERT_EQ(share_time(p, platform, Sharing::kTimeshare, d).finish,
              naive_round_robin(p, platform, d))
        << "round " << round;
  }
}

TEST(TimeSharing, NothingIsFasterThanItsCriticalPath) {
  Dice dice(2);
  for (int round = 0; round < 500; ++round) {
    const Platform platform = random_platform(dice, {});
    const AppSpec app = random_app(dice, {}, platform);
    const Problem p = *Problem::create(app, platform);
    for (const Sharing sharing : {Sharing::kRos2, Sharing::kTimeshare}) {
      const Decision d = random_decision(dice, p);
      const Simulation s = share_time(p, platform, sharing, d);
      for (int i = 0; i < p.num_xnodes; ++i) {
        const auto k = static_cast<std::size_t>(i);
        ASSERT_GE(s.finish[k], s.start[k] + p.wcet_on(i, s.xpu[k]) - 1);  // starts are rounded up
        for (const int u : p.pred[k]) ASSERT_GE(s.start[k], s.finish[static_cast<std::size_t>(u)]);
      }
    }
  }
}

}  // namespace
}  // namespace xauto::solver::test
