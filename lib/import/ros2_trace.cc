// SPDX-License-Identifier: Apache-2.0
#include "import/ros2_trace.h"

#include <algorithm>
#include <set>
#include <unordered_map>

#include "base/index.h"

namespace xauto::import {
namespace {

// Kinds of events, as ros2_events() lists them.
enum RosEvent : int {
  kNode,
  kPublisher,
  kSubscription,
  kSubscriptionObject,
  kSubscriptionCallback,
  kService,
  kServiceCallback,
  kTimer,
  kTimerCallback,
  kTimerNode,
  kSymbol,
  kStart,
  kEnd,
  kRclcppPublish,
  kRclPublish,
  kIntraPublish,
  kRmwPublish,
  kBindStamp,
  kTake,
  kDispatch,
  kDispatchIntra,
  kExecutor,
  kStaticExecutor,
  kGroup,
  kStaticGroup,
  kGroupTimer,
  kGroupSubscription,
  kGroupService,
};

/// What these providers record besides, and nothing here asks for.
const std::set<std::string>& unasked() {
  static const std::set<std::string> names = {"rcl_init",
                                              "rmw_publisher_init",
                                              "rmw_subscription_init",
                                              "rcl_take",
                                              "rclcpp_take",
                                              "rcl_client_init",
                                              "rmw_client_init",
                                              "rmw_service_init",
                                              "rmw_take_request",
                                              "rmw_send_response",
                                              "rmw_send_request",
                                              "rmw_take_response",
                                              "rcl_lifecycle_state_machine_init",
                                              "rcl_lifecycle_transition",
                                              "rclcpp_executor_get_next_ready",
                                              "rclcpp_executor_wait_for_work",
                                              "rclcpp_executor_execute",
                                              "rclcpp_ipb_to_subscription",
                                              "rclcpp_buffer_to_ipb",
                                              "rclcpp_construct_ring_buffer",
                                              "rclcpp_ring_buffer_enqueue",
                                              "rclcpp_ring_buffer_dequeue",
                                              "rclcpp_ring_buffer_clear",
                                              "dds_write",
                                              "dds_bind_addr_to_addr",
                                              "on_data_available",
                                              "rmw_implementation",
                                              "callback_group_add_client",
                                              "sim_time",
                                              "caret_init",
                                              "message_construct",
                                              "rclcpp_callback_group_add"};
  return names;
}

constexpr std::size_t kMaxCalls = 2'000'000;
constexpr std::size_t kToldNames = 5;

using Handle = std::pair<std::int64_t, std::uint64_t>;  // process, address

struct HashHandle {
  std::size_t operator()(const Handle& h) const {
    return std::hash<std::uint64_t>()(h.second * 0x9e3779b97f4a7c15u ^
                                      static_cast<std::uint64_t>(h.first));
  }
};
template <class T>
using Table = std::unordered_map<Handle, T, HashHandle>;

/// Takes the events in their order. Of an address that is used again the last use counts.
class Builder {
 public:
  Builder(const Trace& trace, RosTrace& out) : trace_(trace), out_(out) {}

  void take(const TraceEvent& e) {
    if (out_.begin_ns == 0) out_.begin_ns = e.time_ns;
    out_.end_ns = e.time_ns;
    if (e.kind >= kExecutor)
      take_executor(e);
    else if (e.kind >= kStart)
      take_run(e);
    else
      take_making(e);
  }

  void finish() {
    for (const auto& [thread, call] : running_) unended_ += call >= 0 ? 1 : 0;
    drop_unended();
    note(unended_, "callbacks began, and their end is not in the trace");
    note(unbegun_, "callbacks ended, and their begin is not in the trace");
    note(unknown_,
         "callbacks ran that the trace does not introduce: record from the program's start");
    note(too_many_, "callbacks more than this program takes");
    out_.cpus = static_cast<int>(cpus_.size());
  }

 private:
  void note(std::uint64_t count, const std::string& what) {
    if (count > 0) out_.notes.push_back(std::to_string(count) + " " + what);
  }

  void drop_unended() {
    std::vector<std::int64_t> now_at(out_.calls.size(), -1);
    std::int64_t kept = 0;
    for (std::size_t c = 0; c < out_.calls.size(); ++c)
      if (out_.calls[c].end_ns >= out_.calls[c].start_ns) now_at[c] = kept++;
    for (RosPublication& p : out_.publications)
      if (p.call >= 0) p.call = now_at[static_cast<std::size_t>(p.call)];
    std::erase_if(out_.calls, [](const RosCall& c) { return c.end_ns < c.start_ns; });
  }

  [[nodiscard]] std::string text(const TraceEvent& e, std::size_t which) const {
    const std::size_t at = e.texts + which;
    return at < trace_.texts.size() ? trace_.texts[at] : std::string();
  }

  int callback_of(const TraceEvent& e, std::uint64_t address) {
    const auto [known, fresh] =
        callbacks_.try_emplace({e.process, address}, static_cast<int>(out_.callbacks.size()));
    if (fresh) {
      out_.callbacks.emplace_back();
      out_.callbacks.back().process = e.process;
    }
    return known->second;
  }

  void take_making(const TraceEvent& e) {
    const auto& n = e.numbers;
    const auto handle = [&](std::size_t i) { return Handle{e.process, n[i]}; };
    switch (e.kind) {
      case kNode: {
        const std::string name = text(e, 0), space = text(e, 1);
        nodes_[handle(0)] = (space.ends_with('/') ? space : space + "/") + name;
        break;
      }
      case kPublisher:
        topics_[handle(0)] = text(e, 0);
        break;
      case kSubscription:
        subscriptions_[handle(0)] = {text(e, 0), nodes_[handle(1)],
                                     static_cast<std::int64_t>(n[2])};
        break;
      case kSubscriptionObject:
        objects_[handle(1)] = n[0];
        break;
      case kSubscriptionCallback: {
        RosCallback& made = out_.callbacks[at(callback_of(e, n[1]))];
        const std::uint64_t subscription = objects_[handle(0)];
        const Subscription& of = subscriptions_[{e.process, subscription}];
        made.kind = RosCallback::Kind::kSubscription;
        made.topic = of.topic;
        made.node = of.node;
        made.depth = of.depth;
        of_subscription_[{e.process, subscription}] = callback_of(e, n[1]);
        break;
      }
      default:
        take_timers(e);
    }
  }

  void take_timers(const TraceEvent& e) {
    const auto& n = e.numbers;
    const auto handle = [&](std::size_t i) { return Handle{e.process, n[i]}; };
    switch (e.kind) {
      case kService:
        services_[handle(0)] = nodes_[handle(1)];
        break;
      case kServiceCallback: {
        const int made = callback_of(e, n[1]);
        out_.callbacks[at(made)].kind = RosCallback::Kind::kService;
        out_.callbacks[at(made)].node = services_[handle(0)];
        of_service_[handle(0)] = made;
        break;
      }
      case kTimer:
        timers_[handle(0)] = {static_cast<std::int64_t>(n[1]), e.time_ns};
        break;
      case kTimerCallback: {
        const int made = callback_of(e, n[1]);
        RosCallback& timer = out_.callbacks[at(made)];
        timer.kind = RosCallback::Kind::kTimer;
        std::tie(timer.period_ns, timer.made_ns) = timers_[handle(0)];
        of_timer_[handle(0)] = made;
        break;
      }
      case kTimerNode:
        if (const auto timer = of_timer_.find(handle(0)); timer != of_timer_.end())
          out_.callbacks[at(timer->second)].node = nodes_[handle(1)];
        break;
      case kSymbol:
        out_.callbacks[at(callback_of(e, n[0]))].symbol = text(e, 0);
        break;
      default:
        break;
    }
  }

  struct Pending {
    std::uint64_t stamp = 0, header = 0;
  };

  void take_run(const TraceEvent& e) {
    const Handle thread{e.process, static_cast<std::uint64_t>(e.thread)};
    const auto& n = e.numbers;
    switch (e.kind) {
      case kStart:
        return start(e, thread);
      case kEnd:
        return end(e, thread);
      case kTake:
        if (n[2] != 0) pending_[thread] = {n[1], 0};
        return;
      case kDispatch:
      case kDispatchIntra:
        pending_[thread] = {n[1], n[2]};
        return;
      case kRclcppPublish:
        header_[thread] = n[1];
        return;
      case kRmwPublish:
      case kBindStamp:
        if (const auto last = last_.find(thread);
            last != last_.end() && out_.publications[last->second].stamp == 0)
          out_.publications[last->second].stamp = n[1];
        return;
      default:
        return publish(e, thread);
    }
  }

  void start(const TraceEvent& e, const Handle& thread) {
    const auto known = callbacks_.find({e.process, e.numbers[0]});
    const Pending fired = std::exchange(pending_[thread], {});
    last_.erase(thread);
    std::int64_t& running = running_.try_emplace(thread, -1).first->second;
    if (running >= 0) ++unended_;
    running = -1;
    if (known == callbacks_.end()) {
      ++unknown_;
      return;
    }
    if (out_.calls.size() >= kMaxCalls) {
      ++too_many_;
      return;
    }
    if (e.cpu >= 0) cpus_.insert(e.cpu);
    running = static_cast<std::int64_t>(out_.calls.size());
    RosCall call{known->second, e.time_ns, e.time_ns - 1, e.thread, fired.stamp, fired.header, -1};
    out_.calls.push_back(call);
  }

  void end(const TraceEvent& e, const Handle& thread) {
    const auto running = running_.find(thread);
    const auto known = callbacks_.find({e.process, e.numbers[0]});
    last_.erase(thread);
    if (running == running_.end() || running->second < 0 || known == callbacks_.end() ||
        out_.calls[static_cast<std::size_t>(running->second)].callback != known->second) {
      if (known != callbacks_.end()) ++unbegun_;
      return;
    }
    out_.calls[static_cast<std::size_t>(running->second)].end_ns = e.time_ns;
    running->second = -1;
  }

  /// One message to other processes and inside this one is one publication.
  void publish(const TraceEvent& e, const Handle& thread) {
    const std::string& topic = topics_[{e.process, e.numbers[0]}];
    if (topic.empty()) return;
    const bool inside = e.kind == kIntraPublish;
    if (const auto last = last_.find(thread); !inside && last != last_.end() &&
                                              inside_.contains(last->second) &&
                                              out_.publications[last->second].topic == topic) {
      inside_.erase(last->second);
      return;
    }
    const auto running = running_.find(thread);
    last_[thread] = out_.publications.size();
    if (inside) inside_.insert(out_.publications.size());
    out_.publications.push_back({topic, e.time_ns, running == running_.end() ? -1 : running->second,
                                 0, inside ? e.numbers[1] : std::exchange(header_[thread], 0)});
  }

  void take_executor(const TraceEvent& e) {
    const auto& n = e.numbers;
    const auto handle = [&](std::size_t i) { return Handle{e.process, n[i]}; };
    const auto join = [&](const Table<int>& table, const Handle& object) {
      if (const auto made = table.find(object); made != table.end())
        out_.callbacks[at(made->second)].group = group_of(handle(0));
    };
    switch (e.kind) {
      case kExecutor:
      case kStaticExecutor: {
        const int executor = executor_of(handle(0));
        out_.executors[at(executor)].type = text(e, 0);
        if (e.kind == kStaticExecutor) executors_[handle(1)] = executor;
        break;
      }
      case kGroup:
      case kStaticGroup: {
        RosGroup& group = out_.groups[at(group_of(handle(1)))];
        group.executor = executor_of(handle(0));
        group.reentrant = text(e, 0) == "reentrant";
        break;
      }
      case kGroupTimer:
        return join(of_timer_, handle(1));
      case kGroupSubscription:
        return join(of_subscription_, handle(1));
      case kGroupService:
        return join(of_service_, handle(1));
      default:
        break;
    }
  }

  int group_of(const Handle& handle) {
    const auto [known, fresh] = groups_.try_emplace(handle, static_cast<int>(out_.groups.size()));
    if (fresh) out_.groups.emplace_back();
    return known->second;
  }
  int executor_of(const Handle& handle) {
    const auto [known, fresh] =
        executors_.try_emplace(handle, static_cast<int>(out_.executors.size()));
    if (fresh) out_.executors.push_back({"", handle.first});
    return known->second;
  }

  struct Subscription {
    std::string topic, node;
    std::int64_t depth = 0;
  };
  const Trace& trace_;
  RosTrace& out_;
  Table<std::string> nodes_, topics_, services_;
  Table<Subscription> subscriptions_;
  Table<std::uint64_t> objects_;
  Table<std::pair<std::int64_t, std::int64_t>> timers_;
  Table<int> callbacks_, of_subscription_, of_timer_, of_service_, groups_, executors_;
  Table<std::int64_t> running_;   ///< [thread] index of a call, or -1
  Table<Pending> pending_;        ///< [thread] of the message that was taken last
  Table<std::uint64_t> header_;   ///< [thread] of the message that rclcpp publishes
  Table<std::size_t> last_;       ///< [thread] its last publication
  std::set<std::size_t> inside_;  ///< publications that went inside the process alone
  std::set<std::int32_t> cpus_;
  std::uint64_t unended_ = 0, unbegun_ = 0, unknown_ = 0, too_many_ = 0;
};

/// Which message fired which call: by the stamp with which it was sent; where there is none, the oldest that its queue
/// still holds.
class Matching {
 public:
  explicit Matching(RosTrace& trace) : trace_(trace) {
    for (std::size_t p = 0; p < trace.publications.size(); ++p) {
      const RosPublication& one = trace.publications[p];
      of_topic_[one.topic].push_back(p);
      if (one.stamp != 0) by_stamp_[one.topic][one.stamp] = p;
    }
  }

  void match() {
    std::vector<std::size_t> next(trace_.callbacks.size(), 0);
    for (RosCall& call : trace_.calls) {
      const RosCallback& of = trace_.callbacks[at(call.callback)];
      if (of.kind != RosCallback::Kind::kSubscription) continue;
      const auto topic = of_topic_.find(of.topic);
      if (topic == of_topic_.end()) continue;
      if (call.stamp != 0) {
        const auto& stamps = by_stamp_[of.topic];
        if (const auto sent = stamps.find(call.stamp); sent != stamps.end()) {
          call.publication = static_cast<std::int64_t>(sent->second);
          continue;
        }
      }
      const std::vector<std::size_t>& sent = topic->second;
      std::size_t& oldest = next[at(call.callback)];
      const auto until =
          std::ranges::upper_bound(sent, call.start_ns, {},
                                   [&](std::size_t p) { return trace_.publications[p].time_ns; }) -
          sent.begin();
      const auto there = static_cast<std::size_t>(until);
      const auto depth = static_cast<std::size_t>(of.depth > 0 ? of.depth : 1);
      if (there > depth) oldest = std::max(oldest, there - depth);
      if (oldest < there) call.publication = static_cast<std::int64_t>(sent[oldest++]);
    }
  }

 private:
  RosTrace& trace_;
  std::unordered_map<std::string, std::vector<std::size_t>> of_topic_;
  std::unordered_map<std::string, std::unordered_map<std::uint64_t, std::size_t>> by_stamp_;
};

/// What the reader has to say of the trace.
void note_reading(const Trace& trace, RosTrace& out) {
  for (const std::string& broken : trace.broken) out.notes.push_back("damaged: " + broken);
  if (trace.lost_events > 0)
    out.notes.push_back(std::to_string(trace.lost_events) +
                        " events were lost while the trace was recorded");
  if (trace.lost_packets > 0)
    out.notes.push_back(std::to_string(trace.lost_packets) +
                        " packets of events were lost while the trace was recorded");
  std::uint64_t count = 0;
  std::size_t names = 0;
  std::string list;
  for (const auto& [name, times] : trace.others) {
    const std::size_t colon = name.find(':');
    const std::string provider = colon == std::string::npos ? "" : name.substr(0, colon);
    if ((provider == "ros2" || provider == "ros2_caret") &&
        unasked().contains(name.substr(colon + 1)))
      continue;
    count += times;
    if (++names <= kToldNames) list += (list.empty() ? "" : ", ") + name;
  }
  if (count > 0)
    out.notes.push_back(std::to_string(count) + " events of tracepoints that are not known here: " +
                        list + (names > kToldNames ? ", …" : ""));
}

}  // namespace

const std::vector<WantedEvent>& ros2_events() {
  static const std::vector<WantedEvent> events = {
      {"rcl_node_init", {"node_handle"}, {"node_name", "namespace"}},
      {"rcl_publisher_init", {"publisher_handle"}, {"topic_name"}},
      {"rcl_subscription_init",
       {"subscription_handle", "node_handle", "queue_depth"},
       {"topic_name"}},
      {"rclcpp_subscription_init", {"subscription_handle", "subscription"}, {}},
      {"rclcpp_subscription_callback_added", {"subscription", "callback"}, {}},
      {"rcl_service_init", {"service_handle", "node_handle"}, {}},
      {"rclcpp_service_callback_added", {"service_handle", "callback"}, {}},
      {"rcl_timer_init", {"timer_handle", "period"}, {}},
      {"rclcpp_timer_callback_added", {"timer_handle", "callback"}, {}},
      {"rclcpp_timer_link_node", {"timer_handle", "node_handle"}, {}},
      {"rclcpp_callback_register", {"callback"}, {"symbol"}},
      {"callback_start", {"callback"}, {}},
      {"callback_end", {"callback"}, {}},
      {"rclcpp_publish", {"message", "message_timestamp"}, {}},
      {"rcl_publish", {"publisher_handle"}, {}},
      {"rclcpp_intra_publish", {"publisher_handle", "message_timestamp"}, {}},
      {"rmw_publish", {"message", "timestamp"}, {}},
      {"dds_bind_addr_to_stamp", {"addr", "source_stamp"}, {}},
      {"rmw_take", {"rmw_subscription_handle", "source_timestamp", "taken"}, {}},
      {"dispatch_subscription_callback", {"callback", "source_stamp", "message_timestamp"}, {}},
      {"dispatch_intra_process_subscription_callback",
       {"callback", "source_stamp", "message_timestamp"},
       {}},
      {"construct_executor", {"executor_addr"}, {"executor_type_name"}},
      {"construct_static_executor",
       {"executor_addr", "entities_collector_addr"},
       {"executor_type_name"}},
      {"add_callback_group", {"executor_addr", "callback_group_addr"}, {"group_type_name"}},
      {"add_callback_group_static_executor",
       {"entities_collector_addr", "callback_group_addr"},
       {"group_type_name"}},
      {"callback_group_add_timer", {"callback_group_addr", "timer_handle"}, {}},
      {"callback_group_add_subscription", {"callback_group_addr", "subscription_handle"}, {}},
      {"callback_group_add_service", {"callback_group_addr", "service_handle"}, {}},
  };
  return events;
}

Result<RosTrace> ros2_trace_of(const Trace& trace, const std::string& origin) {
  RosTrace out;
  note_reading(trace, out);
  Builder builder(trace, out);
  for (const TraceEvent& event : trace.events) builder.take(event);
  builder.finish();
  if (out.calls.empty()) {
    std::string notes;
    for (const std::string& note : out.notes) notes += "; " + note;
    return fail(ErrorCode::kInvalid, "no callback of a ROS 2 program ran in this trace" + notes,
                origin, "record from the program's start: `ros2 trace` with ros2_tracing's events");
  }
  Matching(out).match();
  return out;
}

Result<RosTrace> read_ros2_trace(const std::string& folder) {
  XAUTO_ASSIGN(const Trace trace, read_ctf(folder, {"ros2:", "ros2_caret:"}, ros2_events()));
  return ros2_trace_of(trace, folder);
}

}  // namespace xauto::import
