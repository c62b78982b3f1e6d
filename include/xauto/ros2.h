// SPDX-License-Identifier: Apache-2.0
// Callbacks of ordinary ROS 2 nodes as jobs of an app. Only for apps that have rclcpp (Humble or Jazzy), which
// is the app's to link. Run with Humble's; of Jazzy compiled with the headers, and tested with a stand-in.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include <rclcpp/rclcpp.hpp>

#include <xauto/app.h>
#include <xauto/result.h>
#include <xauto/source.h>
#include <xauto/topic.h>
#include <xauto/xmodule.h>
#include <xauto/xnode.h>
#include <xauto/xpu.h>

namespace xauto {

/// What a Ros2Gate did, in all runs of its app together.
struct Ros2Counts {
  std::uint64_t released = 0;  ///< callbacks that were ready and went to the app as a release
  std::uint64_t begun =
      0;  ///< ... that a job began; less than `released`: the app's report says why
  /// Ready, but not released: the app took no message. A message that waits in a subscription's queue stays
  /// there. What rclcpp has taken is lost: a timer's tick, a message inside the process.
  std::uint64_t refused = 0;
};

namespace detail {

class Ros2Executor;

/// A callback that is ready, on its way to its job. It is over when it was run, however long its message is kept
/// (by the profiler, say), or when nobody holds it any more. For the app may drop a release, whose job never begins.
class Ros2Ready {
 public:
  Ros2Ready(std::shared_ptr<Ros2Executor> gate, std::uint64_t number,
            std::unique_ptr<rclcpp::AnyExecutable> work)
      : gate_(std::move(gate)), number_(number), work_(std::move(work)) {}
  Ros2Ready(const Ros2Ready&) = delete;
  Ros2Ready& operator=(const Ros2Ready&) = delete;
  ~Ros2Ready() { end(); }

  /// On the thread of the job. Once: `profile --contended` makes its load by running one release again and again.
  void run() const;

 private:
  void end() const;
  std::shared_ptr<Ros2Executor> gate_;
  std::uint64_t number_;
  // Messages are const, and have one reader here: the gate's module.
  mutable std::unique_ptr<rclcpp::AnyExecutable> work_;
};

/// Waits for its nodes as rclcpp's own executors do, but has the app run what is ready. Of the executor's
/// protected functions it uses get_next_executable and execute_any_executable: they are the same in Humble and
/// Jazzy, and hide what is not (timers, waitables).
///
/// One callback at a time: while one is with the app, this thread sleeps and does not ask for the next. That keeps
/// a subscription's message in its queue until its job takes it. It also keeps the waiting thread from spinning:
/// data that is not taken yet leaves a wait set ready.
class Ros2Executor final : public rclcpp::Executor {
 public:
  Ros2Executor(const rclcpp::ExecutorOptions& options, std::chrono::microseconds distance)
      : rclcpp::Executor(options), distance_(distance) {}

  /// Releases what is ready. Null: where to; kept until the next call.
  using Publish =
      std::function<Status(std::uint64_t number, std::unique_ptr<rclcpp::AnyExecutable>)>;
  void publish_by(Publish publish) { publish_ = std::move(publish); }

  /// Begins to wait, on a thread of its own. `ended`: called there if nobody called stop().
  void start(std::function<void()> ended) {
    {
      const std::lock_guard lock(state_);
      stopping_ = false;
      in_flight_ = 0;
      failure_ = nullptr;
    }
    thread_ = std::thread([this, ended = std::move(ended)] {
      try {
        spin();
      } catch (...) {  // from the middleware; told by stop()
        failure_ = std::current_exception();
      }
      if (!told_to_stop()) ended();
    });
  }
  /// Returns when the thread has ended. A callback that is with the app is not waited for, and can still be run.
  /// Throws what the middleware threw.
  void stop() {
    if (!thread_.joinable()) return;
    bool idle = false;
    {
      const std::lock_guard lock(state_);
      stopping_ = true;
      idle = in_flight_ == 0;
    }
    changed_.notify_all();
    // Not while a callback is with the app: execute_any_executable does nothing after cancel().
    if (idle) wake();
    thread_.join();
    if (failure_ != nullptr) std::rethrow_exception(failure_);
  }

  /// For rclcpp; start() calls it.
  void spin() override {
    spinning.store(true);
    forget_wait(*this);
    auto earliest = std::chrono::steady_clock::now();
    while (rclcpp::ok(context_) && pause_until(earliest)) {
      auto work = std::make_unique<rclcpp::AnyExecutable>();
      if (!get_next_executable(*work)) continue;
      if (is_parameter_event(*work)) {
        execute_any_executable(*work);
        continue;
      }
      const std::uint64_t number = depart();
      if (number == 0) break;
      const bool taken = publish_(number, std::move(work)).has_value();
      earliest = std::chrono::steady_clock::now() + distance_;
      {
        const std::lock_guard lock(state_);
        ++(taken ? counts_.released : counts_.refused);
      }
      await_return();
    }
    forget_wait(*this);
  }

  void execute(rclcpp::AnyExecutable& work) {
    {
      const std::lock_guard lock(state_);
      ++counts_.begun;
    }
    execute_any_executable(work);
  }
  void over(std::uint64_t number) {
    {
      const std::lock_guard lock(state_);
      if (in_flight_ != number) return;  // of an earlier run
      in_flight_ = 0;
    }
    changed_.notify_all();
  }

  [[nodiscard]] Ros2Counts counts() const {
    const std::lock_guard lock(state_);
    return counts_;
  }

 private:
  /// rclcpp has every node hear them of every node, in its default callback group: five when a node starts anywhere
  /// in the domain. As releases they would hold up the app's own work by five distances.
  [[nodiscard]] static bool is_parameter_event(const rclcpp::AnyExecutable& work) {
    return work.subscription != nullptr &&
           work.subscription->get_topic_name() == std::string_view("/parameter_events");
  }
  [[nodiscard]] bool told_to_stop() const {
    const std::lock_guard lock(state_);
    return stopping_;
  }
  /// False: told to stop meanwhile.
  [[nodiscard]] bool pause_until(std::chrono::steady_clock::time_point time) {
    std::unique_lock lock(state_);
    return !changed_.wait_until(lock, time, [this] { return stopping_; });
  }
  /// Numbers a callback that goes to the app, from 1 on; 0: told to stop.
  [[nodiscard]] std::uint64_t depart() {
    const std::lock_guard lock(state_);
    if (stopping_) return 0;
    return in_flight_ = ++last_number_;
  }
  void await_return() {
    std::unique_lock lock(state_);
    changed_.wait(lock, [this] { return stopping_ || in_flight_ == 0; });
  }
  void wake() {
    try {
      cancel();
    } catch (const std::exception&) {
      // After rclcpp::shutdown the guard condition may be gone; then that has woken the thread.
    }
  }
  /// Jazzy keeps what the last wait found. It is not of this run.
  template <class Executor>
  static void forget_wait(Executor& executor) {
    if constexpr (requires { executor.wait_result_.reset(); }) executor.wait_result_.reset();
  }

  const std::chrono::microseconds distance_;
  Publish publish_;
  std::thread thread_;
  std::exception_ptr failure_;  ///< the thread's until it has ended
  // std::mutex, which clang's analysis does not see: lib/base/mutex.h is not installed.
  mutable std::mutex state_;  ///< of what follows; never held while rclcpp or the app is called
  std::condition_variable changed_;
  bool stopping_ = false;
  std::uint64_t in_flight_ = 0;  ///< number of the callback that is with the app; 0: none
  std::uint64_t last_number_ = 0;
  Ros2Counts counts_;
};

inline void Ros2Ready::run() const {
  if (work_ == nullptr) return;  // whose message was taken
  struct AtEnd {
    const Ros2Ready& ready;
    ~AtEnd() { ready.end(); }
  } const at_end{*this};  // also if the callback throws
  gate_->execute(*work_);
}

inline void Ros2Ready::end() const {
  if (work_ == nullptr) return;
  // First: the end of an AnyExecutable gives its callback group back, and the gate may only then ask for more.
  work_.reset();
  gate_->over(number_);
}

}  // namespace detail

/// Runs callbacks of ordinary rclcpp nodes as jobs of an app: subscriptions, timers, services, clients and
/// waitables of the nodes or callback groups that it was given. The nodes' code stays as it is.
///
///   auto node = std::make_shared<Detector>();          // an rclcpp::Node
///   xauto::Ros2Gate detector(app, "detector", 33ms);   // a module with one XNode, on a CPU
///   detector.add_node(node);
///   app.main(argc, argv);                              // instead of rclcpp::spin(node)
///
/// A gate is a module NAME, fired by a pushed source "NAME/ready", with one XNode "NAME.callback" for XPU::CPU.
/// Its jobs are as any other's: profiled, planned, begun when the scheduler says so, and suspended. One at a time:
/// give callbacks that are to run side by side, or to be told apart, callback groups and gates of their own.
/// No jobs are parameter events (/parameter_events): the gate's own thread runs them between two jobs. What a
/// callback on them throws ends the run.
///
/// Handle of what the app keeps: may be gone before the run. Threads: as App.
class Ros2Gate {
 public:
  /// `distance` (1 us to 1 h): as of pushed(). The gate keeps it: what is ready sooner waits where it is. So a burst
  /// from ROS does not break what the policy promises to the rest of the app; a callback past its WCET
  /// may. Throws what rclcpp throws of `options`; of a context that was not initialised, say.
  Ros2Gate(App& app, const std::string& name, std::chrono::microseconds distance,
           const rclcpp::ExecutorOptions& options = rclcpp::ExecutorOptions())
      : executor_(std::make_shared<detail::Ros2Executor>(options, distance)) {
    const Topic<detail::Ros2Ready> ready(name + "/ready");
    XNode<State> callback(name + ".callback");
    callback.add_impl(
        XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); },
        [ready](State&, const Input& input) { input.get(ready).run(); });
    XModule<State> module(name);
    app.add_module(module.add_node(callback).add_input_topic(ready));
    const Source<detail::Ros2Ready> source = app.add_source(ready, pushed(distance));
    executor_->publish_by([source, gate = std::weak_ptr<detail::Ros2Executor>(executor_)](
                              std::uint64_t number, std::unique_ptr<rclcpp::AnyExecutable> work) {
      return source.publish(
          std::make_shared<const detail::Ros2Ready>(gate.lock(), number, std::move(work)));
    });
    app.on_start([&app, executor = executor_] {
      // As spin() returns: rclcpp::shutdown() ends a run of App::run, and what the middleware throws does.
      executor->start([&app] { app.stop(); });
    });
    app.on_stop([executor = executor_] { executor->stop(); });
  }

  /// All callback groups of the node that are not left out of executors, as rclcpp::Executor::add_node. Throws
  /// std::runtime_error if the node has an executor. Not during a run.
  void add_node(rclcpp::node_interfaces::NodeBaseInterface::SharedPtr node) {
    executor_->add_node(std::move(node));
  }
  /// The same of an rclcpp::Node, or what else has its get_node_base_interface().
  template <class Node>
  requires requires(Node& node) { node.get_node_base_interface(); }
  void add_node(const std::shared_ptr<Node>& node) { add_node(node->get_node_base_interface()); }
  /// One callback group, as rclcpp::Executor::add_callback_group. Likewise.
  template <class Node>
  requires requires(Node& node) { node.get_node_base_interface(); }
  void add_callback_group(const rclcpp::CallbackGroup::SharedPtr& group,
                          const std::shared_ptr<Node>& node) {
    executor_->add_callback_group(group, node->get_node_base_interface());
  }

  /// Threads: any.
  [[nodiscard]] Ros2Counts counts() const { return executor_->counts(); }

 private:
  struct State {};
  std::shared_ptr<detail::Ros2Executor> executor_;
};

}  // namespace xauto
