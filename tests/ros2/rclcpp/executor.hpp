// SPDX-License-Identifier: Apache-2.0
// Of the stand-in of rclcpp: how an executor waits and executes (rclcpp.hpp).
#pragma once

#include <algorithm>
#include <atomic>
#include <cassert>
#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include <rclcpp/node.hpp>

namespace rclcpp {

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
