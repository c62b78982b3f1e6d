// SPDX-License-Identifier: Apache-2.0
// An ordinary ROS 2 node in an app: what its callbacks do runs as jobs. Detector knows nothing of XAuto. Run it as
// any app: `xauto profile build/gate --out app.json`, `xauto solve`, `xauto run`.
#include <atomic>
#include <chrono>
#include <memory>

#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/int32.hpp>

#include <xauto/ros2.h>

using namespace std::chrono_literals;

class Detector : public rclcpp::Node {
 public:
  Detector() : Node("detector") {
    found_ = create_publisher<std_msgs::msg::Int32>("found", 10);
    // A callback group makes a callback a thing of its own, for any executor. This one's is the second gate's.
    statistics = create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false);
    tick_ = create_wall_timer(10ms, [this] { detect(); });
    report_ = create_wall_timer(
        100ms, [this] { count_ = 0; }, statistics);
  }
  rclcpp::CallbackGroup::SharedPtr statistics;

 private:
  void detect() {
    std_msgs::msg::Int32 message;
    message.data = ++number_;
    ++count_;
    found_->publish(message);
  }
  int number_ = 0;
  std::atomic<int> count_{0};  // two groups, so two threads
  rclcpp::Publisher<std_msgs::msg::Int32>::SharedPtr found_;
  rclcpp::TimerBase::SharedPtr tick_, report_;
};

int main(int argc, char** argv) {
  // XAuto ends a run at SIGINT: what is in flight is finished first.
  rclcpp::init(argc, argv, rclcpp::InitOptions(), rclcpp::SignalHandlerOptions::None);
  auto detector = std::make_shared<Detector>();
  xauto::App app("gate");
  xauto::Ros2Gate detect(app, "detect", 9ms);  // a timer's ticks are not exactly 10 ms apart
  detect.add_node(detector);
  xauto::Ros2Gate statistics(app, "statistics", 90ms);
  statistics.add_callback_group(detector->statistics, detector);
  const int status = app.main(argc, argv);
  rclcpp::shutdown();
  return status;
}
