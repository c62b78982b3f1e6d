// SPDX-License-Identifier: Apache-2.0
// An ordinary node, and an app that runs it, for the tests of Ros2Gate: also beside rclcpp itself, so it uses nothing
// that rclcpp does not have.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <std_msgs/msg/int32.hpp>
#include <unistd.h>

#include <xauto/ros2.h>
#include <xauto/xauto.h>

#include "model/json.h"
#include "model/periodic.h"

namespace xauto::testing_ros2 {

using namespace std::chrono_literals;
using std_msgs::msg::Int32;

/// Opens once.
class Door {
 public:
  void open() {
    {
      const std::lock_guard lock(mutex_);
      open_ = true;
    }
    changed_.notify_all();
  }
  void pass() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return open_; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool open_ = false;
};

/// Code that knows nothing of XAuto.
class Adder : public rclcpp::Node {
 public:
  /// `type`: of a group of its own, which add_node does not add. None: the node's default one.
  explicit Adder(std::size_t depth = 64,
                 std::optional<rclcpp::CallbackGroupType> type = std::nullopt)
      : Node("adder") {
    out_ = create_publisher<Int32>("sum", 10);
    if (type) group = create_callback_group(*type, false);
    rclcpp::SubscriptionOptions options;
    options.callback_group = group;
    in_ = create_subscription<Int32>(
        "number", depth, [this](const Int32& number) { add(number.data); }, options);
  }
  rclcpp::CallbackGroup::SharedPtr group;
  std::function<void(int)> on_number = [](int) {};
  std::vector<int> numbers;           ///< of the callback's thread; read after the run
  std::set<std::thread::id> threads;  ///< likewise
  std::atomic<int> calls{0}, inside{0}, most_inside{0};

 private:
  void add(int number) {
    most_inside = std::max(most_inside.load(), ++inside);
    numbers.push_back(number);
    threads.insert(std::this_thread::get_id());
    ++calls;
    const struct Leave {
      std::atomic<int>& inside;
      ~Leave() { --inside; }
    } leave{inside};
    on_number(number);
    sum_.data += number;
    out_->publish(sum_);
  }
  Int32 sum_;
  rclcpp::Publisher<Int32>::SharedPtr out_;
  rclcpp::Subscription<Int32>::SharedPtr in_;
};

class Ros2GateTest : public ::testing::Test {
 protected:
  Ros2GateTest() {
    // Of rclcpp itself: a domain of this process, which other tests on this machine are not in.
    setenv("ROS_DOMAIN_ID", std::to_string(1 + getpid() % 100).c_str(), 1);
    setenv("CYCLONEDDS_URI",
           "<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='lo'/>"
           "</Interfaces><AllowMulticast>false</AllowMulticast></General></Domain></CycloneDDS>",
           1);
    rclcpp::init(0, nullptr);
    sender_ = std::make_shared<rclcpp::Node>("sender");  // spun by nobody
    out_ = sender_->create_publisher<Int32>("number", 64);
  }
  ~Ros2GateTest() override {
    finish();
    rclcpp::shutdown();
  }

  static std::shared_ptr<detail::Ros2Executor> executor_of(Adder& adder) {
    auto executor = std::make_shared<detail::Ros2Executor>(rclcpp::ExecutorOptions(), 1us);
    executor->add_node(adder.get_node_base_interface());
    return executor;
  }
  /// Of a gate "gate", one core. Its messages have a rate, or none and are released one at a time: then no release is
  /// left out that a loaded machine brings late.
  static RunOptions options(std::optional<std::int64_t> distance_us = std::nullopt) {
    AppSpec spec;
    spec.name = "app";
    spec.xnodes = {{"gate.callback", "gate", {{"cpu", 100}}}};
    spec.xnodes[0].sources = {0};
    spec.one_at_a_time = !distance_us;
    spec.sources = {{"gate/ready", distance_us ? Period{*distance_us} : kNoRate}};
    complete_modules(spec);
    complete_chains(spec);
    Platform platform;
    platform.name = "tiny";
    platform.xpus = {{"cpu0", "cpu"}};
    PriorityPlan policy;
    policy.app = spec.name;
    policy.app_hash = spec.hash();
    policy.method = "heft";
    policy.platform = platform.name;
    policy.placements = {{0, 1}};
    return RunOptions()
        .app(to_json(spec))
        .platform(to_json(platform))
        .policy(to_json(by_priorities(policy, spec), spec, platform))
        .cpu_sched("other")
        .activations(0);
  }
  void start(const RunOptions& with = options()) {
    thread_ = std::thread([this, with] { report_ = app.run(with); });
  }
  /// The run's end; without `stop` the run has to end by itself.
  const Result<RunReport>& finish(bool stop = true) {
    if (!thread_.joinable()) return report_;
    if (stop) app.stop();
    thread_.join();
    return report_;
  }
  /// Until it is so: the time-out of the test's runner judges the rest.
  static void await(const std::function<bool()>& condition) {
    while (!condition()) std::this_thread::sleep_for(1ms);
  }
  /// It is in the subscriptions' queues then.
  void send(int number) {
    Int32 message;
    message.data = number;
    out_->publish(message);
  }

  App app{"app"};

 private:
  rclcpp::Node::SharedPtr sender_;
  rclcpp::Publisher<Int32>::SharedPtr out_;
  std::thread thread_;
  Result<RunReport> report_ = fail(ErrorCode::kInternal, "not run");
};

}  // namespace xauto::testing_ros2
