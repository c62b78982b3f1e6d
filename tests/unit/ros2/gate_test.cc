// SPDX-License-Identifier: Apache-2.0
// Ordinary nodes whose callbacks run as jobs: real daemons, a real run of the app, and a stand-in of rclcpp
// (tests/ros2/). Compiled for Humble here, for Jazzy in unit/ros2_jazzy/, and for the real one by XAUTO_RCLCPP
// (tests/CMakeLists.txt): so it uses nothing that rclcpp does not have. No time is measured.
#include <memory>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <std_msgs/msg/int32.hpp>

#include <xauto/ros2.h>
#include <xauto/xauto.h>

#include "gate_fixture.h"

namespace xauto {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::Int32;
using testing_ros2::Adder;
using testing_ros2::Door;
using testing_ros2::Ros2GateTest;

TEST_F(Ros2GateTest, EveryMessageIsAJobOnTheWorkersThreadInOrder) {
  rclcpp::Node listener("listener");  // spun by nobody: its queue keeps what comes
  const auto heard = listener.create_subscription<Int32>("sum", 64, [](const Int32&) {});
  const auto adder = std::make_shared<Adder>();
  Ros2Gate gate(app, "gate", 1ms);
  gate.add_node(adder);
  ASSERT_TRUE(app.check()) << app.check().error().to_string();
  for (int k = 0; k < 10; ++k) send(k);  // before the run: the queue keeps them
  start();
  await([&] { return adder->calls == 10; });
  for (int k = 10; k < 20; ++k) send(k);
  await([&] { return adder->calls == 20; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete()) << report->json();
  EXPECT_EQ(report->modules(), std::vector<std::string>{"gate"});
  EXPECT_EQ(report->results("gate"), 20u) << report->json();
  EXPECT_EQ(report->lost(), 0u);
  EXPECT_EQ(gate.counts().released, 20u);
  EXPECT_EQ(gate.counts().begun, 20u);
  EXPECT_EQ(gate.counts().refused, 0u);
  for (int k = 0; k < 20; ++k) EXPECT_EQ(adder->numbers[static_cast<std::size_t>(k)], k);
  EXPECT_EQ(adder->threads.size(), 1u);
  for (int k = 0, sum = 0; k < 20; ++k) {
    sum += k;
    Int32 message;
    rclcpp::MessageInfo info;
    ASSERT_TRUE(heard->take(message, info));
    EXPECT_EQ(message.data, sum);
  }
}

TEST_F(Ros2GateTest, TheSubscriptionsDepthIsTheQueueAndAMessageIsTakenWhenItsJobBegins) {
  const auto adder = std::make_shared<Adder>(3);
  Door door;
  adder->on_number = [&](int number) {
    if (number == 0) door.pass();
  };
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(adder);
  start();
  send(0);
  await([&] { return adder->calls == 1; });
  for (int k = 1; k <= 10; ++k) send(k);  // the reader's history keeps the newest three
  door.open();
  await([&] { return adder->calls == 4; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(adder->numbers, (std::vector<int>{0, 8, 9, 10}));
  EXPECT_EQ(gate.counts().released, 4u);
  EXPECT_EQ(report->lost(), 0u) << report->json();
}

TEST_F(Ros2GateTest, AReentrantGroupIsReleasedOncePerMessageAndOneAtATime) {
  const auto adder = std::make_shared<Adder>(64, rclcpp::CallbackGroupType::Reentrant);
  Door door;
  adder->on_number = [&](int number) {
    if (number == 0) door.pass();
  };
  Ros2Gate gate(app, "gate", 1us);
  gate.add_callback_group(adder->group, adder);
  start();
  for (int k = 0; k < 8; ++k) send(k);  // seven wait while the first one's callback does
  await([&] { return adder->calls == 1; });
  door.open();
  await([&] { return adder->calls == 8; });
  ASSERT_TRUE(finish());
  EXPECT_EQ(adder->most_inside.load(), 1);
  EXPECT_EQ(gate.counts().released, 8u);  // the wait set was ready all the time
}

TEST_F(Ros2GateTest, AMessageWhoseReleaseWasDroppedIsReleasedAgain) {
  const auto adder = std::make_shared<Adder>();
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(adder);
  for (int k = 0; k < 60; ++k) send(k);
  start(options().overload("skip"));  // drops what comes while the module is not free
  await([&] { return adder->calls == 60; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->results("gate"), 60u) << report->json();
  EXPECT_EQ(gate.counts().begun, 60u);
  for (int k = 0; k < 60; ++k) EXPECT_EQ(adder->numbers[static_cast<std::size_t>(k)], k);
}

TEST_F(Ros2GateTest, TimersAreJobsToo) {
  const auto node = std::make_shared<rclcpp::Node>("timer");
  std::atomic<int> ticks{0};
  std::atomic<std::thread::id> thread;
  const auto timer = node->create_wall_timer(2ms, [&] {
    thread = std::this_thread::get_id();
    ++ticks;
  });
  Ros2Gate gate(app, "gate", 1ms);
  gate.add_node(node);
  start();
  await([&] { return ticks >= 5; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->results("gate"), static_cast<std::uint64_t>(ticks.load()));
  EXPECT_EQ(gate.counts().begun, static_cast<std::uint64_t>(ticks.load()));
}

TEST_F(Ros2GateTest, NodesThatStartElsewhereReleaseNothing) {
  const auto adder = std::make_shared<Adder>();
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(adder);
  std::vector<rclcpp::Node::SharedPtr> nodes;
  for (int k = 0; k < 5; ++k)
    nodes.push_back(std::make_shared<rclcpp::Node>("node" + std::to_string(k)));
  start();
  send(0);
  await([&] { return adder->calls == 1; });
  for (int k = 5; k < 10; ++k)
    nodes.push_back(std::make_shared<rclcpp::Node>("node" + std::to_string(k)));
  send(1);
  await([&] { return adder->calls == 2; });
  ASSERT_TRUE(finish());
  EXPECT_EQ(gate.counts().released, 2u);
  EXPECT_EQ(adder->threads.size(), 1u);
}

TEST_F(Ros2GateTest, ACallbackThatThrowsLosesItsActivationAndTheGateGoesOn) {
  const auto adder = std::make_shared<Adder>();
  adder->on_number = [](int number) {
    if (number % 2 == 1) throw std::runtime_error("odd");
  };
  Ros2Gate gate(app, "gate", 1ms);
  gate.add_node(adder);
  for (int k = 0; k < 6; ++k) send(k);
  start();
  await([&] { return adder->calls == 6; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->lost("gate"), 3u) << report->json();
  EXPECT_EQ(report->results("gate"), 3u);
  EXPECT_EQ(gate.counts().begun, 6u);
}

TEST_F(Ros2GateTest, NothingIsReleasedSoonerThanDeclared) {
  const auto adder = std::make_shared<Adder>();
  Ros2Gate gate(app, "gate", 20ms);
  gate.add_node(adder);
  for (int k = 0; k < 5; ++k) send(k);  // all at once
  start(options(20000));
  await([&] { return adder->calls == 5; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->note(), "");  // the runtime itself counts what comes too early
  EXPECT_EQ(report->releases(), 5u);
}

TEST_F(Ros2GateTest, AStopWakesAGateThatNobodySendsToAndTheNextRunGoesOn) {
  const auto adder = std::make_shared<Adder>();
  Ros2Gate gate(app, "gate", 1ms);
  gate.add_node(adder);
  for (int run = 1; run <= 3; ++run) {
    start();
    send(run);
    await([&] { return adder->calls == run; });
    ASSERT_TRUE(finish());
    EXPECT_EQ(gate.counts().begun, static_cast<std::uint64_t>(run));
  }
  EXPECT_EQ(adder->numbers, (std::vector<int>{1, 2, 3}));
}

TEST_F(Ros2GateTest, ACallbackThatIsUnderWayAtTheStopEnds) {
  const auto adder = std::make_shared<Adder>();
  Door door, stopped;
  adder->on_number = [&](int) { door.pass(); };
  Ros2Gate gate(app, "gate", 1ms);
  gate.add_node(adder);
  app.on_stop([&] { stopped.open(); });  // after the gate's
  start();
  send(7);
  send(8);  // stays in the queue
  await([&] { return adder->calls == 1; });
  app.stop();
  stopped.pass();  // the gate's thread has ended, though its callback has not
  door.open();
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->results("gate"), 1u) << report->json();
  EXPECT_EQ(adder->numbers, std::vector<int>{7});
}

TEST_F(Ros2GateTest, WhatWasReleasedBeforeTheStopRunsAfterIt) {
  const auto adder = std::make_shared<Adder>();
  const auto executor = executor_of(*adder);
  std::unique_ptr<detail::Ros2Ready> ready;  // the app, in which the job waits to begin
  Door released;
  executor->publish_by([&](std::uint64_t number, std::unique_ptr<rclcpp::AnyExecutable> work) {
    ready = std::make_unique<detail::Ros2Ready>(executor, number, std::move(work));
    released.open();
    return Status();
  });
  executor->start([] {});
  send(5);
  released.pass();
  executor->stop();
  EXPECT_EQ(adder->calls, 0);
  ready->run();
  EXPECT_EQ(adder->numbers, std::vector<int>{5});
  ready->run();  // there is nothing left to take
  EXPECT_EQ(executor->counts().begun, 1u);
  ready.reset();
  executor->publish_by(nullptr);
}

TEST_F(Ros2GateTest, WhoKeepsAMessageThatHasRunHoldsUpNobody) {
  const auto adder = std::make_shared<Adder>();
  const auto executor = executor_of(*adder);
  std::vector<std::unique_ptr<detail::Ros2Ready>> kept;
  executor->publish_by([&](std::uint64_t number, std::unique_ptr<rclcpp::AnyExecutable> work) {
    kept.push_back(std::make_unique<detail::Ros2Ready>(executor, number, std::move(work)));
    kept.back()->run();
    return Status();
  });
  executor->start([] {});
  for (int k = 0; k < 3; ++k) send(k);
  await([&] { return adder->calls == 3; });
  executor->stop();
  kept.clear();
  executor->publish_by(nullptr);
}

TEST_F(Ros2GateTest, WhatTheAppDoesNotTakeIsCountedAndAMessageStays) {
  const auto adder = std::make_shared<Adder>();
  const auto executor = executor_of(*adder);
  std::atomic<int> tries{0};
  executor->publish_by([&](std::uint64_t number, std::unique_ptr<rclcpp::AnyExecutable> work) {
    const detail::Ros2Ready ready(executor, number, std::move(work));
    if (++tries < 3) return Status(fail(ErrorCode::kUnavailable, "not now"));
    ready.run();
    return Status();
  });
  executor->start([] {});
  send(5);
  await([&] { return adder->calls == 1; });
  executor->stop();
  EXPECT_EQ(executor->counts().refused, 2u);
  EXPECT_EQ(executor->counts().released, 1u);
  EXPECT_EQ(adder->numbers, std::vector<int>{5});
  executor->publish_by(nullptr);
}

TEST_F(Ros2GateTest, WhatTheMiddlewareThrowsIsToldByStop) {
  const auto adder = std::make_shared<Adder>();
  const auto executor = executor_of(*adder);
  executor->publish_by([](std::uint64_t, std::unique_ptr<rclcpp::AnyExecutable>) -> Status {
    throw std::runtime_error("rcl_wait() failed");
  });
  Door ended;
  executor->start([&] { ended.open(); });
  send(5);
  ended.pass();
  EXPECT_THROW(executor->stop(), std::runtime_error);
}

TEST_F(Ros2GateTest, ShutdownOfRclcppEndsTheRun) {
  const auto adder = std::make_shared<Adder>();
  Ros2Gate gate(app, "gate", 1ms);
  gate.add_node(adder);
  start();
  send(1);
  await([&] { return adder->calls == 1; });
  rclcpp::shutdown();
  const auto& report = finish(false);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->lost(), 0u);
}

TEST_F(Ros2GateTest, ANodeHasOneExecutor) {
  const auto adder = std::make_shared<Adder>();
  {
    App other("other");
    Ros2Gate gate(other, "gate", 1ms);
    gate.add_node(adder);
    Ros2Gate second(other, "second", 1ms);
    EXPECT_THROW(second.add_node(adder), std::runtime_error);
  }
  Ros2Gate gate(app, "gate", 1ms);
  EXPECT_NO_THROW(gate.add_node(adder));  // it went with its app
}

TEST_F(Ros2GateTest, WithoutInitTheGateCannotBeMade) {
  rclcpp::shutdown();
  EXPECT_THROW(Ros2Gate(app, "gate", 1ms), std::runtime_error);
}

}  // namespace
}  // namespace xauto
