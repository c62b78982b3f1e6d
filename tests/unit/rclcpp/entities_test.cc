// SPDX-License-Identifier: Apache-2.0
// What the stand-in of rclcpp has not: services, clients, waitables, other executors, entities that come and go. Only
// built with rclcpp itself (XAUTO_RCLCPP). No time is measured.
#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <std_msgs/msg/int32.hpp>

#include <xauto/ros2.h>
#include <xauto/xauto.h>

#include "ros2/gate_fixture.h"

namespace xauto {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::Int32;
using testing_ros2::Adder;
using testing_ros2::Door;
using RclcppTest = testing_ros2::Ros2GateTest;

/// Nodes beside the app's, spun as ROS 2 does.
class Others {
 public:
  explicit Others(const rclcpp::Node::SharedPtr& node) {
    executor_.add_node(node);
    thread_ = std::thread([this] { executor_.spin(); });
  }
  ~Others() {
    while (!executor_.is_spinning()) std::this_thread::yield();  // else cancel() is forgotten
    executor_.cancel();
    thread_.join();
  }

 private:
  rclcpp::executors::MultiThreadedExecutor executor_;
  std::thread thread_;
};

TEST_F(RclcppTest, ServicesAreJobs) {
  const auto adder = std::make_shared<Adder>();
  adder->declare_parameter("gain", 1);
  std::atomic<std::thread::id> thread;
  const auto watched =
      adder->add_on_set_parameters_callback([&](const std::vector<rclcpp::Parameter>&) {
        thread = std::this_thread::get_id();
        rcl_interfaces::msg::SetParametersResult result;
        result.successful = true;
        return result;
      });
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(adder);
  start(options(1));
  const auto caller = std::make_shared<rclcpp::Node>("caller");
  rclcpp::AsyncParametersClient client(caller, "adder");
  await([&] { return client.service_is_ready(); });
  const Others others(caller);
  for (int gain = 2; gain < 12; ++gain) {
    ASSERT_TRUE(client.set_parameters({rclcpp::Parameter("gain", gain)}).get().at(0).successful);
    EXPECT_EQ(client.get_parameters({"gain"}).get().at(0).as_int(), gain);
  }
  send(1);
  await([&] { return adder->calls == 1; });
  ASSERT_TRUE(finish());
  EXPECT_EQ(*adder->threads.begin(), thread.load());  // the worker's
  EXPECT_GE(gate.counts().begun, 21u);
}

TEST_F(RclcppTest, AnswersToAClientAreJobs) {
  const auto server = std::make_shared<rclcpp::Node>("server");
  server->declare_parameter("gain", 7);
  const Others others(server);
  const auto adder = std::make_shared<Adder>();
  rclcpp::AsyncParametersClient client(adder, "server");
  std::atomic<int> answered{0};
  std::atomic<std::thread::id> thread;
  adder->on_number = [&](int) {  // asks from a job; the answer is another job
    client.get_parameters({"gain"}, [&](std::shared_future<std::vector<rclcpp::Parameter>> values) {
      thread = std::this_thread::get_id();
      answered += static_cast<int>(values.get().at(0).as_int());
    });
  };
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(adder);
  start(options(1));
  await([&] { return client.service_is_ready(); });
  for (int k = 0; k < 10; ++k) send(k);
  await([&] { return answered == 70; });
  ASSERT_TRUE(finish());
  EXPECT_EQ(*adder->threads.begin(), thread.load());
}

TEST_F(RclcppTest, MessagesInsideTheProcessAreJobsInOrder) {
  const auto node =
      std::make_shared<rclcpp::Node>("inside", rclcpp::NodeOptions().use_intra_process_comms(true));
  const auto out = node->create_publisher<Int32>("inside", 64);
  std::vector<int> heard;
  std::vector<const Int32*> sent, got;
  std::atomic<int> calls{0};
  const auto in = node->create_subscription<Int32>("inside", 64, [&](Int32::UniquePtr message) {
    heard.push_back(message->data);
    got.push_back(message.get());
    ++calls;
  });
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(node);
  const auto publish = [&](int number) {
    auto message = std::make_unique<Int32>();
    message->data = number;
    sent.push_back(message.get());
    out->publish(std::move(message));
  };
  for (int k = 0; k < 10; ++k) publish(k);
  start(options(1));
  await([&] { return calls == 10; });
  for (int k = 10; k < 20; ++k) publish(k);
  await([&] { return calls == 20; });
  const auto& report = finish();
  ASSERT_TRUE(report) << report.error().to_string();
  for (int k = 0; k < 20; ++k) EXPECT_EQ(heard[static_cast<std::size_t>(k)], k);
  EXPECT_EQ(got[0], sent[0]);  // not copied
}

TEST_F(RclcppTest, WhatIsMadeDuringTheRunIsHeard) {
  const auto adder = std::make_shared<Adder>();
  std::atomic<int> late{0}, done{-1};
  rclcpp::Subscription<Int32>::SharedPtr in;
  adder->on_number = [&](int number) {
    if (number == 0)
      in = adder->create_subscription<Int32>("number", 64, [&](const Int32&) { ++late; });
    if (number == 2) in.reset();
    done = number;
  };
  Ros2Gate gate(app, "gate", 1us);
  gate.add_node(adder);
  start(options(1));
  send(0);
  await([&] { return done == 0; });
  send(1);
  await([&] { return late == 1 && done == 1; });
  send(2);
  await([&] { return done == 2; });
  send(3);
  await([&] { return done == 3; });
  ASSERT_TRUE(finish());
}

TEST_F(RclcppTest, TheRestOfANodeIsAnotherExecutors) {
  const auto adder = std::make_shared<Adder>(64, rclcpp::CallbackGroupType::MutuallyExclusive);
  std::atomic<int> ticks{0};
  std::atomic<std::thread::id> thread;
  const auto timer = adder->create_wall_timer(1ms, [&] {
    thread = std::this_thread::get_id();
    ++ticks;
  });
  Ros2Gate gate(app, "gate", 1us);
  gate.add_callback_group(adder->group, adder);
  const Others others(adder);
  Door door;
  adder->on_number = [&](int) { door.pass(); };
  start(options(1));
  send(0);
  await([&] { return adder->calls == 1; });
  const int then = ticks;
  await([&] { return ticks > then + 3; });  // while the gate's callback is under way
  door.open();
  ASSERT_TRUE(finish());
  EXPECT_EQ(gate.counts().begun, 1u);
  EXPECT_NE(*adder->threads.begin(), thread.load());
}

TEST_F(RclcppTest, ARunEndsByShutdownWhateverTheGateIsAtThen) {
  for (int k = 0; k < 30; ++k) {
    auto context = std::make_shared<rclcpp::Context>();
    context->init(0, nullptr);
    rclcpp::ExecutorOptions of;
    of.context = context;
    const auto node =
        std::make_shared<rclcpp::Node>("short", rclcpp::NodeOptions().context(context));
    std::atomic<int> ticks{0};
    const auto timer = node->create_wall_timer(100us, [&] { ++ticks; });
    App own("app");
    Ros2Gate gate(own, "gate", 1us, of);
    gate.add_node(node);
    std::thread run([&] {
      const auto report = own.run(options(1));
      EXPECT_TRUE(report) << report.error().to_string();
    });
    await([&] { return ticks > k % 5; });
    context->shutdown("test");
    run.join();
  }
}

}  // namespace
}  // namespace xauto
