// SPDX-License-Identifier: Apache-2.0
// A stand-in of the few types of rclcpp that xauto/ros2.h and an ordinary node touch. Never installed. Written from
// rclcpp's sources, tags 16.0.11 (Humble) and 28.1.6 (Jazzy); each behaviour names the file that has it, below
// rclcpp/src/rclcpp/ unless it says otherwise. With RCLCPP_STAND_IN_JAZZY it behaves as Jazzy where the two differ.
//
// Not here: services, clients, waitables, intra-process messages, QoS but depth, and DDS. What is published arrives
// at once, in this process. One lock for all of a context's queues, instead of rcl's and the middleware's.
#pragma once

#include <algorithm>
#include <atomic>
#include <cassert>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
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
  SubscriptionBase(Context::SharedPtr context, std::size_t depth)
      : context_(std::move(context)), depth_(depth) {}
  virtual ~SubscriptionBase() = default;
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
  const std::size_t depth_;
  std::deque<std::shared_ptr<const void>> queue_;
};

template <class T>
class Subscription final : public SubscriptionBase {
 public:
  using SharedPtr = std::shared_ptr<Subscription>;
  Subscription(Context::SharedPtr context, std::size_t depth,
               std::function<void(const T&)> callback)
      : SubscriptionBase(std::move(context), depth), callback_(std::move(callback)) {}
  void handle_message(const std::shared_ptr<const void>& message) override {
    callback_(*static_cast<const T*>(message.get()));
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

/// node.hpp; node_interfaces/node_base.cpp: a node holds its groups weakly, but for its default one.
class Node {
 public:
  explicit Node(const std::string& /*name*/)
      : context_(contexts::get_global_default_context()),
        default_group_(create_callback_group(CallbackGroupType::MutuallyExclusive)) {
    if (!ok(context_))
      throw std::runtime_error("failed to create guard condition: not initialized");
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
    auto made = std::make_shared<Subscription<T>>(context_, depth, std::move(callback));
    (options.callback_group ? options.callback_group : default_group_)
        ->subscriptions.push_back(made);
    const std::lock_guard lock(context_->mutex);
    context_->readers.emplace(topic, made);
    return made;
  }
  template <class Callback>
  TimerBase::SharedPtr create_wall_timer(std::chrono::nanoseconds period, Callback callback,
                                         const CallbackGroup::SharedPtr& group = nullptr) {
    auto made = std::make_shared<TimerBase>(period, std::move(callback));
    (group ? group : default_group_)->timers.push_back(made);
    return made;
  }

 private:
  const Context::SharedPtr context_;
  const node_interfaces::NodeBaseInterface::SharedPtr base_ =
      std::make_shared<node_interfaces::NodeBaseInterface>();
  const CallbackGroup::SharedPtr default_group_;
};

/// any_executable.cpp: what is discarded gives its group back.
struct AnyExecutable {
  AnyExecutable() = default;
  AnyExecutable(const AnyExecutable&) = delete;
  AnyExecutable& operator=(const AnyExecutable&) = delete;
  virtual ~AnyExecutable() {
    if (callback_group) callback_group->can_be_taken_from().store(true);
  }
  SubscriptionBase::SharedPtr subscription;
  TimerBase::SharedPtr timer;
  CallbackGroup::SharedPtr callback_group;
  std::shared_ptr<void> data;
};

/// executor_options.hpp
struct ExecutorOptions {
  Context::SharedPtr context = contexts::get_global_default_context();
};

class Executor {
 public:
  explicit Executor(const ExecutorOptions& options = ExecutorOptions())
      : spinning(false), context_(options.context) {
    if (!ok(context_))
      throw std::runtime_error("failed to create guard condition: not initialized");
  }
  Executor(const Executor&) = delete;
  Executor& operator=(const Executor&) = delete;
  /// executor.cpp: groups and nodes are free again.
  virtual ~Executor() {
    for (const auto& weak : groups_)
      if (const auto group = weak.lock()) group->get_associated_with_executor_atomic().store(false);
    for (const auto& weak : nodes_)
      if (const auto node = weak.lock()) node->get_associated_with_executor_atomic().store(false);
  }
  virtual void spin() = 0;

  /// executor.cpp, add_callback_group_to_map; executors/executor_entities_collector.cpp in Jazzy.
  virtual void add_callback_group(CallbackGroup::SharedPtr group,
                                  node_interfaces::NodeBaseInterface::SharedPtr /*node*/,
                                  bool /*notify*/ = true) {
    if (group->get_associated_with_executor_atomic().exchange(true))
      throw std::runtime_error("Callback group has already been added to an executor.");
    groups_.push_back(group);
    entities_need_rebuild_.store(true);
  }
  virtual void add_node(node_interfaces::NodeBaseInterface::SharedPtr node,
                        bool /*notify*/ = true) {
    if (node->get_associated_with_executor_atomic().exchange(true))
      throw std::runtime_error("Node has already been added to an executor.");
    nodes_.push_back(node);
    for (const auto& weak : node->groups) {
      const auto group = weak.lock();
      if (group && group->automatically_add_to_executor_with_node() &&
          !group->get_associated_with_executor_atomic().load())
        add_callback_group(group, node);
    }
  }
  /// executor.cpp
  virtual void cancel() {
    spinning.store(false);
    {
      const std::lock_guard lock(context_->mutex);
      interrupted_ = true;
    }
    context_->rung.notify_all();
  }

 protected:
  /// executor.cpp
  bool get_next_executable(AnyExecutable& executable,
                           std::chrono::nanoseconds timeout = std::chrono::nanoseconds(-1)) {
    if (get_next_ready_executable(executable)) return true;
    wait_for_work(timeout);
    if (!spinning.load()) return false;
    return get_next_ready_executable(executable);
  }

  /// executor.cpp: nothing is done after cancel(); the message is taken here, on the thread that calls.
  void execute_any_executable(AnyExecutable& executable) {
    if (!spinning.load()) return;
    if (executable.timer) executable.timer->execute_callback();
    if (executable.subscription)
      if (const auto message = executable.subscription->take_type_erased())
        executable.subscription->handle_message(message);
    executable.callback_group->can_be_taken_from().store(true);
#ifndef RCLCPP_STAND_IN_JAZZY
    // Humble wakes its wait set after each callback; Jazzy leaves that to the multi-threaded executor.
    {
      const std::lock_guard lock(context_->mutex);
      interrupted_ = true;
    }
    context_->rung.notify_all();
#endif
  }

  std::atomic_bool spinning;
  Context::SharedPtr context_;

 private:
  template <class T>
  struct Entry {
    std::shared_ptr<T> entity;
    std::weak_ptr<CallbackGroup> group;
  };
  /// What a wait set watches, and after the wait what of it is ready.
  struct Entities {
    std::vector<Entry<TimerBase>> timers;
    std::vector<Entry<SubscriptionBase>> subscriptions;
  };

 protected:
#ifdef RCLCPP_STAND_IN_JAZZY
  std::optional<Entities> wait_result_;  ///< executor.hpp, of Jazzy alone
#endif

 private:
  /// Groups that are taken are left out: strategies/allocator_memory_strategy.hpp, collect_entities, and
  /// executors/executor_entities_collection.cpp, build_entities_collection.
  [[nodiscard]] Entities collect_entities() const {
    Entities collected;
    for (const auto& weak : groups_) {
      const auto group = weak.lock();
      if (!group || !group->can_be_taken_from().load()) continue;
      for (const auto& timer : group->timers)
        if (auto held = timer.lock()) collected.timers.push_back({std::move(held), group});
      for (const auto& subscription : group->subscriptions)
        if (auto held = subscription.lock())
          collected.subscriptions.push_back({std::move(held), group});
    }
    return collected;
  }

  void wait_for_work(std::chrono::nanoseconds timeout) {
    forget_ready();
#ifdef RCLCPP_STAND_IN_JAZZY
    // Collected anew only when nodes, groups or entities have changed.
    if (entities_need_rebuild_.exchange(false) ||
        (current_.timers.empty() && current_.subscriptions.empty()))
      current_ = collect_entities();
    const Entities& watched = current_;
#else
    const Entities watched = collect_entities();  // at every wait
#endif
    assert(timeout.count() < 0);  // the only wait that is used
    (void)timeout;
    Entities ready;
    std::unique_lock lock(context_->mutex);
    while (true) {
      auto next = TimerBase::Clock::time_point::max();
      for (const auto& timer : watched.timers) {
        if (timer.entity->is_ready()) ready.timers.push_back(timer);
        next = std::min(next, timer.entity->next_call());
      }
      for (const auto& subscription : watched.subscriptions)
        if (subscription.entity->has_data_locked()) ready.subscriptions.push_back(subscription);
      const bool woken = std::exchange(interrupted_, false) || !context_->valid_locked();
      if (woken || !ready.timers.empty() || !ready.subscriptions.empty()) break;
      if (next == TimerBase::Clock::time_point::max())
        context_->rung.wait(lock);
      else
        context_->rung.wait_until(lock, next);
    }
    ready_ref() = std::move(ready);
  }

  /// Timers first, then subscriptions: executor.cpp. What is skipped because its group is taken stays ready in
  /// Humble (allocator_memory_strategy.hpp); in Jazzy a subscription is passed over until the next wait.
  bool get_next_ready_executable(AnyExecutable& executable) {
    if (!has_ready()) return false;
    Entities& ready = ready_ref();
    for (auto at = ready.timers.begin(); at != ready.timers.end(); ++at) {
      const auto group = at->group.lock();
      if (!group || !group->can_be_taken_from().load()) continue;
      at->entity->advance();  // timer->call(): the tick is taken here, before it is executed
      executable.timer = at->entity;
      executable.data = std::make_shared<int>();
      return take(executable, group, ready.timers, at);
    }
    for (auto at = ready.subscriptions.begin(); at != ready.subscriptions.end();) {
      const auto group = at->group.lock();
      if (group && group->can_be_taken_from().load()) {
        executable.subscription = at->entity;
        return take(executable, group, ready.subscriptions, at);
      }
#ifdef RCLCPP_STAND_IN_JAZZY
      at = ready.subscriptions.erase(at);
#else
      ++at;
#endif
    }
    return false;
  }
  template <class T>
  static bool take(AnyExecutable& executable, const CallbackGroup::SharedPtr& group,
                   std::vector<Entry<T>>& from, typename std::vector<Entry<T>>::iterator at) {
    from.erase(at);
    executable.callback_group = group;
    if (group->type() == CallbackGroupType::MutuallyExclusive) {
      assert(group->can_be_taken_from().load());
      group->can_be_taken_from().store(false);
    }
    return true;
  }

#ifdef RCLCPP_STAND_IN_JAZZY
  [[nodiscard]] bool has_ready() const {
    return wait_result_.has_value();
  }
  Entities& ready_ref() {
    if (!wait_result_) wait_result_.emplace();
    return *wait_result_;
  }
  void forget_ready() {
    wait_result_.reset();
  }
  Entities current_;
#else
  [[nodiscard]] static bool has_ready() {
    return true;
  }
  Entities& ready_ref() {
    return ready_;
  }
  void forget_ready() {
    ready_ = {};
  }
  Entities ready_;
#endif
  std::vector<std::weak_ptr<CallbackGroup>> groups_;
  std::vector<std::weak_ptr<node_interfaces::NodeBaseInterface>> nodes_;
  std::atomic_bool entities_need_rebuild_{true};
  bool interrupted_ = false;  ///< the guard condition; of context_->mutex
};

}  // namespace rclcpp
