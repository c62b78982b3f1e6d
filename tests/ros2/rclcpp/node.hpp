// SPDX-License-Identifier: Apache-2.0
// Of the stand-in of rclcpp: contexts, nodes and what they have (rclcpp.hpp).
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace rclcpp {

class SubscriptionBase;

class Context {
 public:
  using SharedPtr = std::shared_ptr<Context>;
  void init() {
    const std::lock_guard lock(mutex);
    valid_ = true;
  }
  /// context.cpp: the shutdown callbacks run, of which each executor has one that triggers its guard condition.
  bool shutdown(const std::string& /*reason*/) {
    {
      const std::lock_guard lock(mutex);
      if (!valid_) return false;
      valid_ = false;
    }
    rung.notify_all();
    return true;
  }
  [[nodiscard]] bool is_valid() const {
    const std::lock_guard lock(mutex);
    return valid_;
  }
  [[nodiscard]] bool valid_locked() const { return valid_; }

  mutable std::mutex mutex;
  std::condition_variable
      rung;  ///< rcl_wait: something arrived, or a guard condition was triggered
  std::multimap<std::string, std::weak_ptr<SubscriptionBase>> readers;

 private:
  bool valid_ = false;
};

namespace contexts {
inline Context::SharedPtr get_global_default_context() {
  static const auto context = std::make_shared<Context>();
  return context;
}
}  // namespace contexts

struct InitOptions {};
/// signal_handler.hpp: what ends a program by a signal is nobody's here.
enum class SignalHandlerOptions { All, SigInt, SigTerm, None };
inline void init(int /*argc*/, const char* const* /*argv*/, const InitOptions& /*options*/ = {},
                 SignalHandlerOptions /*signals*/ = SignalHandlerOptions::All) {
  contexts::get_global_default_context()->init();
}
/// utilities.cpp: null is the default context, here and in shutdown().
inline bool ok(const Context::SharedPtr& context = nullptr) {
  return (context ? context : contexts::get_global_default_context())->is_valid();
}
inline bool shutdown(const Context::SharedPtr& context = nullptr,
                     const std::string& reason = "user called rclcpp::shutdown()") {
  return (context ? context : contexts::get_global_default_context())->shutdown(reason);
}

class TimerBase {
 public:
  using SharedPtr = std::shared_ptr<TimerBase>;
  using Clock = std::chrono::steady_clock;
  TimerBase(std::chrono::nanoseconds period, std::function<void()> callback)
      : period_(period), next_(Clock::now() + period), callback_(std::move(callback)) {}
  [[nodiscard]] Clock::time_point next_call() const { return next_; }
  [[nodiscard]] bool is_ready() const { return Clock::now() >= next_; }
  /// rcl/src/rcl/timer.c, rcl_timer_call: the next time is a period later; periods that were missed are skipped.
  void advance() {
    const auto now = Clock::now();
    next_ += period_;
    if (next_ < now) next_ += ((now - next_) / period_ + 1) * period_;
  }
  void execute_callback() { callback_(); }

 private:
  const std::chrono::nanoseconds period_;
  Clock::time_point next_;
  const std::function<void()> callback_;
};

class SubscriptionBase {
 public:
  using SharedPtr = std::shared_ptr<SubscriptionBase>;
  SubscriptionBase(Context::SharedPtr context, std::string topic, std::size_t depth)
      : context_(std::move(context)), topic_(std::move(topic)), depth_(depth) {}
  virtual ~SubscriptionBase() = default;
  [[nodiscard]] const char* get_topic_name() const { return topic_.c_str(); }
  /// KEEP_LAST of a DDS reader's history: the oldest makes room.
  void arrive(std::shared_ptr<const void> message) {
    {
      const std::lock_guard lock(context_->mutex);
      if (queue_.size() == depth_) queue_.pop_front();
      queue_.push_back(std::move(message));
    }
    context_->rung.notify_all();
  }
  [[nodiscard]] bool has_data_locked() const { return !queue_.empty(); }
  /// The oldest; null: there is none.
  std::shared_ptr<const void> take_type_erased() {
    const std::lock_guard lock(context_->mutex);
    if (queue_.empty()) return nullptr;
    std::shared_ptr<const void> message = std::move(queue_.front());
    queue_.pop_front();
    return message;
  }
  virtual void handle_message(const std::shared_ptr<const void>& message) = 0;

 private:
  const Context::SharedPtr context_;
  const std::string topic_;
  const std::size_t depth_;
  std::deque<std::shared_ptr<const void>> queue_;
};

struct MessageInfo {};

template <class T>
class Subscription final : public SubscriptionBase {
 public:
  using SharedPtr = std::shared_ptr<Subscription>;
  Subscription(Context::SharedPtr context, std::string topic, std::size_t depth,
               std::function<void(const T&)> callback)
      : SubscriptionBase(std::move(context), std::move(topic), depth),
        callback_(std::move(callback)) {}
  void handle_message(const std::shared_ptr<const void>& message) override {
    callback_(*static_cast<const T*>(message.get()));
  }
  bool take(T& to, MessageInfo& /*info*/) {
    const auto message = take_type_erased();
    if (message != nullptr) to = *static_cast<const T*>(message.get());
    return message != nullptr;
  }

 private:
  const std::function<void(const T&)> callback_;
};

template <class T>
class Publisher {
 public:
  using SharedPtr = std::shared_ptr<Publisher>;
  Publisher(Context::SharedPtr context, std::string topic)
      : context_(std::move(context)), topic_(std::move(topic)) {}
  void publish(const T& message) {
    std::vector<std::shared_ptr<SubscriptionBase>> readers;
    {
      const std::lock_guard lock(context_->mutex);
      const auto [begin, end] = context_->readers.equal_range(topic_);
      for (auto reader = begin; reader != end; ++reader)
        if (auto held = reader->second.lock()) readers.push_back(std::move(held));
    }
    for (const auto& reader : readers) reader->arrive(std::make_shared<const T>(message));
  }

 private:
  const Context::SharedPtr context_;
  const std::string topic_;
};

enum class CallbackGroupType { MutuallyExclusive, Reentrant };

/// callback_group.cpp
class CallbackGroup {
 public:
  using SharedPtr = std::shared_ptr<CallbackGroup>;
  CallbackGroup(CallbackGroupType type, bool automatically_add)
      : type_(type), automatically_add_(automatically_add) {}
  std::atomic_bool& can_be_taken_from() { return can_be_taken_from_; }
  std::atomic_bool& get_associated_with_executor_atomic() { return associated_; }
  [[nodiscard]] CallbackGroupType type() const { return type_; }
  [[nodiscard]] bool automatically_add_to_executor_with_node() const { return automatically_add_; }

  std::vector<std::weak_ptr<TimerBase>> timers;
  std::vector<std::weak_ptr<SubscriptionBase>> subscriptions;

 private:
  const CallbackGroupType type_;
  const bool automatically_add_;
  std::atomic_bool can_be_taken_from_{true}, associated_{false};
};

namespace node_interfaces {
class NodeBaseInterface {
 public:
  using SharedPtr = std::shared_ptr<NodeBaseInterface>;
  std::atomic_bool& get_associated_with_executor_atomic() { return associated_; }
  std::vector<std::weak_ptr<CallbackGroup>> groups;

 private:
  std::atomic_bool associated_{false};
};
}  // namespace node_interfaces

struct SubscriptionOptions {
  CallbackGroup::SharedPtr callback_group;  ///< null: the node's default one
};

struct ParameterEvent {};

/// node.hpp; node_interfaces/node_base.cpp: a node holds its groups weakly, but for its default one.
class Node {
 public:
  using SharedPtr = std::shared_ptr<Node>;
  explicit Node(const std::string& /*name*/)
      : context_(contexts::get_global_default_context()),
        default_group_(create_callback_group(CallbackGroupType::MutuallyExclusive)) {
    if (!ok(context_))
      throw std::runtime_error("failed to create guard condition: not initialized");
    // time_source.cpp: declares use_sim_time, which all nodes hear of that are there, and hears from then on.
    // node.cpp: then declares four policies of the topic's QoS.
    const auto events = create_publisher<ParameterEvent>("/parameter_events", 1000);
    events->publish({});
    parameter_events_ = create_subscription<ParameterEvent>("/parameter_events", 1000,
                                                            [](const ParameterEvent&) {});
    for (int policy = 0; policy < 4; ++policy) events->publish({});
  }
  virtual ~Node() = default;
  [[nodiscard]] node_interfaces::NodeBaseInterface::SharedPtr get_node_base_interface() const {
    return base_;
  }
  CallbackGroup::SharedPtr create_callback_group(CallbackGroupType type,
                                                 bool automatically_add_to_executor = true) {
    auto group = std::make_shared<CallbackGroup>(type, automatically_add_to_executor);
    base_->groups.push_back(group);
    return group;
  }
  template <class T>
  typename Publisher<T>::SharedPtr create_publisher(const std::string& topic,
                                                    std::size_t /*depth*/) {
    return std::make_shared<Publisher<T>>(context_, topic);
  }
  template <class T, class Callback>
  typename Subscription<T>::SharedPtr create_subscription(
      const std::string& topic, std::size_t depth, Callback callback,
      const SubscriptionOptions& options = SubscriptionOptions()) {
    check_group(options.callback_group);
    auto made = std::make_shared<Subscription<T>>(context_, topic, depth, std::move(callback));
    (options.callback_group ? options.callback_group : default_group_)
        ->subscriptions.push_back(made);
    const std::lock_guard lock(context_->mutex);
    context_->readers.emplace(topic, made);
    return made;
  }
  template <class Callback>
  TimerBase::SharedPtr create_wall_timer(std::chrono::nanoseconds period, Callback callback,
                                         const CallbackGroup::SharedPtr& group = nullptr) {
    check_group(group);
    auto made = std::make_shared<TimerBase>(period, std::move(callback));
    (group ? group : default_group_)->timers.push_back(made);
    return made;
  }

 private:
  /// node_interfaces/node_topics.cpp, node_timers.cpp
  void check_group(const CallbackGroup::SharedPtr& group) const {
    if (!group) return;
    for (const auto& own : base_->groups)
      if (own.lock() == group) return;
    throw std::runtime_error("callback group not in node.");
  }

  const Context::SharedPtr context_;
  const node_interfaces::NodeBaseInterface::SharedPtr base_ =
      std::make_shared<node_interfaces::NodeBaseInterface>();
  const CallbackGroup::SharedPtr default_group_;
  Subscription<ParameterEvent>::SharedPtr parameter_events_;
};

}  // namespace rclcpp
