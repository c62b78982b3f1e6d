// SPDX-License-Identifier: Apache-2.0
// ROS 2 traces: made by LTTng itself (tests/golden/ros2-trace), of CARET's demo (../shared/data), damaged, and written
// event by event.
#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <gtest/gtest.h>

#include "model/json.h"

#include "import/ros2_app.h"

extern "C" void __lsan_disable() __attribute__((weak));
extern "C" void __lsan_enable() __attribute__((weak));

namespace xauto::import {
namespace {

namespace fs = std::filesystem;

const fs::path kMade = fs::path(XAUTO_SOURCE_DIR) / "tests/golden/ros2-trace/made";
const fs::path kCaret = fs::path(XAUTO_SOURCE_DIR) / "../shared/data/ros2-trace";

std::string text_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

Result<ImportedApp> app_of(const RosTrace& trace, const std::string& architecture = "") {
  Architecture parsed;
  if (!architecture.empty()) {
    XAUTO_ASSIGN(parsed, parse_architecture(architecture, "architecture.yaml"));
  }
  std::vector<std::string> lines;
  return ros2_app(trace, parsed, {"app", "a trace", 0}, lines);
}

bool has_note(const RosTrace& trace, const std::string& part) {
  for (const std::string& note : trace.notes)
    if (note.find(part) != std::string::npos) return true;
  return false;
}

/// Events one after the other, as a tracer has them. Kinds are by name.
struct Events {
  Trace trace;
  std::int64_t thread = 1;

  void add(const std::string& name, std::int64_t ms, std::array<std::uint64_t, 3> numbers,
           std::vector<std::string> texts = {}) {
    TraceEvent event;
    for (std::size_t k = 0; k < ros2_events().size(); ++k)
      if (ros2_events()[k].name == name) event.kind = static_cast<int>(k);
    ASSERT_GE(event.kind, 0) << name;
    event.time_ns = 1'000'000'000 + ms * 1'000'000;
    event.process = 7;
    event.thread = thread;
    event.cpu = static_cast<std::int32_t>(thread);
    event.numbers = numbers;
    event.texts = static_cast<std::uint32_t>(trace.texts.size());
    trace.texts.insert(trace.texts.end(), texts.begin(), texts.end());
    trace.events.push_back(event);
  }
  void node(std::uint64_t handle, const std::string& name) {
    add("rcl_node_init", 0, {handle}, {name, "/"});
  }
  void timer(std::uint64_t node, std::uint64_t handle, std::uint64_t callback, std::int64_t ms) {
    add("rcl_timer_init", 0, {handle, static_cast<std::uint64_t>(ms * 1'000'000)});
    add("rclcpp_timer_callback_added", 0, {handle, callback});
    add("rclcpp_timer_link_node", 0, {handle, node});
  }
  void subscription(std::uint64_t node, std::uint64_t handle, std::uint64_t callback,
                    const std::string& topic) {
    add("rcl_subscription_init", 0, {handle, node, 5}, {topic});
    add("rclcpp_subscription_init", 0, {handle, handle + 1});
    add("rclcpp_subscription_callback_added", 0, {handle + 1, callback});
  }
  void call(std::uint64_t callback, std::int64_t from, std::int64_t to,
            std::uint64_t publisher = 0) {
    add("callback_start", from, {callback});
    if (publisher != 0) add("rcl_publish", to, {publisher});
    add("callback_end", to, {callback});
  }
  RosTrace made() {
    std::ranges::stable_sort(trace.events, {}, &TraceEvent::time_ns);
    auto read = ros2_trace_of(trace, "here");
    EXPECT_TRUE(read) << read.error().to_string();
    return read ? *read : RosTrace();
  }
};

/// A timer of 10 ms whose message fires a subscription.
Events ticking(int times) {
  Events e;
  e.node(1, "a");
  e.node(2, "b");
  e.add("rcl_publisher_init", 0, {3}, {"/tick"});
  e.timer(1, 4, 5, 10);
  e.subscription(2, 6, 8, "/tick");
  for (int k = 1; k <= times; ++k) {
    e.call(5, 10 * k, 10 * k + 2, 3);
    e.call(8, 10 * k + 3, 10 * k + 6);
  }
  return e;
}

TEST(Ros2Trace, ATimerIsASourceAndAMessageAnEdge) {
  const auto made = app_of(ticking(20).made());
  ASSERT_TRUE(made) << made.error().to_string();
  const AppSpec& app = made->app;
  ASSERT_EQ(app.xnodes.size(), 2u);
  EXPECT_EQ(app.xnodes[0].name, "a.timer");
  EXPECT_EQ(app.xnodes[1].name, "b.tick");
  EXPECT_EQ(app.xnodes[0].wcet_us.at("cpu"), 2000);
  EXPECT_EQ(app.xnodes[1].wcet_us.at("cpu"), 3000);
  ASSERT_EQ(app.sources.size(), 1u);
  EXPECT_EQ(app.sources[0].period, *Period::of_rate("100"));
  EXPECT_EQ(app.edges, (std::vector<std::pair<int, int>>{{0, 1}}));
  ASSERT_EQ(made->seen.chains.size(), 1u);
  // Each tick is known at its end, 6 ms after it was due.
  EXPECT_EQ(made->seen.chains[0].count, 20);
  EXPECT_EQ(made->seen.chains[0].median_us, 6000);
  EXPECT_EQ(made->seen.chains[0].longest_us, 6000);
}

TEST(Ros2Trace, TheMarginIsOnTopOfTheLongestTime) {
  std::vector<std::string> lines;
  const auto made = ros2_app(ticking(5).made(), {}, {"app", "a trace", 20}, lines);
  ASSERT_TRUE(made);
  EXPECT_EQ(made->app.xnodes[1].wcet_us.at("cpu"), 3600);
  EXPECT_EQ(made->app.xnodes[1].typical_us.at("cpu"), 3000);
}

TEST(Ros2Trace, ATimerThatIsCalledLateHasNoOtherPhase) {
  Events e;
  e.node(1, "a");
  e.timer(1, 4, 5, 10);
  for (int k = 1; k <= 30; ++k) e.call(5, 10 * k + (k == 7 ? 4 : 0), 10 * k + 5);
  const auto made = app_of(e.made());
  ASSERT_TRUE(made);
  EXPECT_EQ(made->app.sources[0].offset_us, 0);
  EXPECT_EQ(made->app.sources[0].jitter_us, 4000);
  EXPECT_EQ(made->seen.chains[0].count, 30);
  EXPECT_EQ(made->seen.chains[0].longest_us, 5000);
}

TEST(Ros2Trace, AMessageFromOutsideIsASourceOfAClockOfItsOwn) {
  Events e;
  e.node(1, "a");
  e.subscription(1, 6, 8, "/camera");
  for (int k = 0; k < 20; ++k) e.call(8, 33 + 50 * k + (k % 3 == 0 ? 2 : 0), 36 + 50 * k);
  const auto made = app_of(e.made());
  ASSERT_TRUE(made) << made.error().to_string();
  ASSERT_EQ(made->app.sources.size(), 1u);
  EXPECT_EQ(made->app.sources[0].name, "camera");
  EXPECT_EQ(made->app.sources[0].period, *Period::of_rate("20"));
  EXPECT_NE(made->app.sources[0].clock, 0);
  EXPECT_NEAR(static_cast<double>(made->app.sources[0].jitter_us), 2000, 300);
}

TEST(Ros2Trace, WhatANodeKeepsForAnotherCallbackIsASample) {
  // As CARET traces it: the timer publishes the header that the subscription has received.
  Events e;
  e.node(1, "source");
  e.node(2, "b");
  e.add("rcl_publisher_init", 0, {3}, {"/in"});
  e.add("rcl_publisher_init", 0, {9}, {"/out"});
  e.timer(1, 4, 5, 10);
  e.subscription(2, 6, 8, "/in");
  e.timer(2, 14, 15, 10);
  for (std::uint64_t k = 1; k <= 10; ++k) {
    const auto ms = static_cast<std::int64_t>(10 * k);
    e.add("callback_start", ms, {5});
    e.add("rclcpp_publish", ms + 1, {0, 100 + k});
    e.add("rcl_publish", ms + 1, {3});
    e.add("callback_end", ms + 1, {5});
    e.add("dispatch_subscription_callback", ms + 2, {8, 0, 100 + k});
    e.call(8, ms + 2, ms + 3);
    e.add("callback_start", ms + 5, {15});
    e.add("rclcpp_publish", ms + 6, {0, 100 + k});
    e.add("rcl_publish", ms + 6, {9});
    e.add("callback_end", ms + 6, {15});
  }
  const auto made = app_of(e.made());
  ASSERT_TRUE(made) << made.error().to_string();
  const int read = made->app.find("b.in"), timer = made->app.find("b.timer");
  EXPECT_EQ(made->app.samples, (std::vector<std::pair<int, int>>{{read, timer}}));
}

TEST(Ros2Trace, WhoPublishesBesideACallbackThatKeepsIsAskedFor) {
  Events e = ticking(10);
  e.add("rcl_publisher_init", 0, {30}, {"/out"});
  e.timer(2, 14, 15, 20);
  for (int k = 1; k <= 5; ++k) e.call(15, 20 * k + 7, 20 * k + 8, 30);
  const auto made = app_of(e.made());
  ASSERT_TRUE(made);
  int asked = 0;
  for (const Todo& todo : made->todo) asked += todo.at == "/samples/-" ? 1 : 0;
  EXPECT_EQ(asked, 1);
  EXPECT_TRUE(made->app.samples.empty());
}

TEST(Ros2Trace, GroupsAndExecutorsAreCarets) {
  Events e = ticking(10);
  e.add("construct_executor", 0, {100}, {"multi_threaded_executor"});
  e.add("add_callback_group", 0, {100, 101}, {"mutually_exclusive"});
  e.add("add_callback_group", 0, {100, 102}, {"reentrant"});
  e.add("callback_group_add_timer", 0, {101, 4});
  e.add("callback_group_add_subscription", 0, {102, 6});
  for (auto& event : e.trace.events)
    if (event.kind >= 0 && event.numbers[0] == 8) event.thread = 2;
  const auto made = app_of(e.made());
  ASSERT_TRUE(made);
  ASSERT_EQ(made->seen.executors.size(), 1u);
  const SeenExecutor& executor = made->seen.executors[0];
  EXPECT_EQ(executor.kind, ExecutorKind::kMultiThreaded);
  EXPECT_EQ(executor.threads, 2);
  ASSERT_EQ(executor.groups.size(), 2u);
  EXPECT_FALSE(executor.groups[0].reentrant);
  EXPECT_TRUE(executor.groups[1].reentrant);
  EXPECT_TRUE(made->groups.empty()) << "one callback each";
}

TEST(Ros2Trace, WithoutThemThreadsTell) {
  const auto made = app_of(ticking(10).made());
  ASSERT_TRUE(made);
  ASSERT_EQ(made->seen.executors.size(), 1u);
  EXPECT_EQ(made->seen.executors[0].kind, ExecutorKind::kSingleThreaded);
  EXPECT_EQ(made->seen.executors[0].groups.size(), 2u) << "a node is a group";
  bool asked = false;
  for (const Todo& todo : made->todo) asked = asked || todo.at == "/seen/executors/0/type";
  EXPECT_TRUE(asked);
}

TEST(Ros2Trace, ACircleOfMessagesIsCut) {
  Events e;
  e.node(1, "a");
  e.add("rcl_publisher_init", 0, {3}, {"/x"});
  e.add("rcl_publisher_init", 0, {13}, {"/y"});
  e.subscription(1, 6, 8, "/y");
  e.subscription(1, 26, 28, "/x");
  for (int k = 0; k < 10; ++k) {
    e.call(8, 10 * k, 10 * k + 1, 3);
    e.call(28, 10 * k + 2, 10 * k + 3, 13);
  }
  const auto made = app_of(e.made());
  ASSERT_TRUE(made) << made.error().to_string();
  EXPECT_EQ(made->app.edges.size(), 1u);
  EXPECT_EQ(made->app.sources.size(), 1u);
}

TEST(Ros2Trace, LostBeginsAndEndsCostTheirCallbackAlone) {
  Events e = ticking(10);
  int n = 0;
  std::erase_if(e.trace.events, [&n](const TraceEvent& event) {
    const std::string name = ros2_events()[static_cast<std::size_t>(event.kind)].name;
    const bool edge = name == "callback_start" || name == "callback_end";
    return edge && (++n == 6 || n == 11);  // an end, and a begin
  });
  e.call(999, 300, 301);
  const RosTrace trace = e.made();
  EXPECT_EQ(trace.calls.size(), 18u);
  EXPECT_TRUE(has_note(trace, "their end is not in the trace"));
  EXPECT_TRUE(has_note(trace, "their begin is not in the trace"));
  EXPECT_TRUE(has_note(trace, "does not introduce"));
  EXPECT_TRUE(app_of(trace));
}

TEST(Ros2Trace, NothingThatRanIsAnError) {
  Events e;
  e.node(1, "a");
  const auto read = ros2_trace_of(e.trace, "here");
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().code, ErrorCode::kInvalid);
}

TEST(Ros2Trace, NamesOfATraceMayBeAnything) {
  Events e;
  e.node(1, std::string("\xff\n\x1b[2J") + std::string(5000, 'x'));
  e.timer(1, 4, 5, 10);
  e.timer(1, 14, 15, 10);
  for (int k = 1; k <= 5; ++k) {
    e.call(5, 10 * k, 10 * k + 1);
    e.call(15, 10 * k + 2, 10 * k + 3);
  }
  const auto made = app_of(e.made());
  ASSERT_TRUE(made);
  EXPECT_TRUE(parse_imported(to_json(*made), "again"));
}

#ifdef XAUTO_HAVE_BABELTRACE
TEST(Ros2Trace, LttngsOwnTraceIsRead) {
  const auto trace = read_ros2_trace(kMade.string());
  ASSERT_TRUE(trace) << trace.error().to_string();
  EXPECT_EQ(trace->calls.size(), 96u) << "program.c: 40 ticks, 40 behind them, 16 of the camera";
  EXPECT_TRUE(has_note(*trace, "events were lost while"));
  EXPECT_TRUE(has_note(*trace, "ros2:of_tomorrow"));
  const auto made = app_of(*trace);
  ASSERT_TRUE(made) << made.error().to_string();
  const AppSpec& app = made->app;
  EXPECT_GE(app.find("ticker.timer"), 0);
  EXPECT_EQ(app.edges, (std::vector<std::pair<int, int>>{
                           {app.find("ticker.timer"), app.find("front/worker.tick")}}));
  EXPECT_EQ(made->seen.executors.at(0).kind, ExecutorKind::kSingleThreaded);
  EXPECT_GE(app.xnodes[static_cast<std::size_t>(app.find("front/worker.tick"))].wcet_us.at("cpu"),
            3000);
}

/// A copy of the trace that LTTng made, to be damaged.
struct Copy {
  Copy() {
    char name[] = "/tmp/xauto-import-XXXXXX";
    folder = mkdtemp(name);
    fs::copy(kMade, folder, fs::copy_options::recursive);
  }
  ~Copy() { fs::remove_all(folder); }
  fs::path folder;
};

TEST(Ros2Trace, ATruncatedStreamIsReadUntilThere) {
  std::size_t calls = 96;
  for (const std::uintmax_t left : {30'000u, 18'000u, 12'000u, 9'000u}) {
    const Copy copy;
    fs::resize_file(copy.folder / "c_1", left);
    const auto trace = read_ros2_trace(copy.folder.string());
    ASSERT_TRUE(trace) << left << trace.error().to_string();
    EXPECT_TRUE(has_note(*trace, "damaged: c_1")) << left;
    EXPECT_LE(trace->calls.size(), calls);
    calls = trace->calls.size();
  }
  // Its first packet of 8 KiB, and all of c_0.
  EXPECT_LT(calls, 96u);
  EXPECT_GT(calls, 5u);
}

TEST(Ros2Trace, MetadataThatEndAmidAPacketAreNotGivenToTheLibrary) {
  for (const std::uintmax_t left : {0u, 36u, 258u, 2359u, 4435u, 8191u}) {
    const Copy copy;
    fs::resize_file(copy.folder / "metadata", left);
    const auto trace = read_ros2_trace(copy.folder.string());  // babeltrace2 2.0.4 would not return
    ASSERT_FALSE(trace) << left;
    EXPECT_NE(trace.error().what.find("metadata"), std::string::npos);
  }
}

TEST(Ros2Trace, DamagedTracesAreErrorsOrNotes) {
  std::uint64_t dice = 1;
  for (int round = 0; round < 60; ++round) {
    const Copy copy;
    const char* const name = round % 2 == 0 ? "c_1" : "metadata";
    std::string bytes = text_of(copy.folder / name);
    for (int n = 0; n < 4; ++n) {
      dice = dice * 6364136223846793005u + 1442695040888963407u;
      bytes[(dice >> 20) % bytes.size()] = static_cast<char>(dice >> 56);
    }
    std::ofstream(copy.folder / name, std::ios::binary) << bytes;
    // libbabeltrace2 2.0.4 loses what it has parsed of metadata that is broken.
    if (__lsan_disable != nullptr) __lsan_disable();
    const auto trace = read_ros2_trace(copy.folder.string());
    if (__lsan_enable != nullptr) __lsan_enable();
    if (!trace) {
      EXPECT_FALSE(trace.error().what.empty());
      continue;
    }
    if (const auto made = app_of(*trace)) {
      EXPECT_TRUE(parse_imported(to_json(*made), "again"));
    }
  }
}

TEST(Ros2Trace, AFolderWithoutATraceIsNamed) {
  const auto none = read_ros2_trace((fs::path(XAUTO_SOURCE_DIR) / "docs").string());
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kNotFound);
}

#ifdef XAUTO_HAVE_LIBYAML
TEST(Ros2Trace, CaretsDemoIsAsItsArchitectureSays) {
  if (!fs::exists(kCaret / "caret-demo")) GTEST_SKIP() << "no ../shared/data";
  const auto trace = read_ros2_trace((kCaret / "caret-demo").string());
  ASSERT_TRUE(trace) << trace.error().to_string();
  EXPECT_EQ(trace->calls.size(), 480u);
  const auto made = app_of(*trace, text_of(kCaret / "caret-demo-architecture.yaml"));
  ASSERT_TRUE(made) << made.error().to_string();
  const AppSpec& app = made->app;
  const auto pair = [&](const char* u, const char* v) {
    return std::pair(app.find(u), app.find(v));
  };
  const auto sorted = [](auto list) {
    std::ranges::sort(list);
    return list;
  };
  EXPECT_EQ(app.sources.size(), 3u);
  // Topics of the architecture, by who publishes and who subscribes.
  EXPECT_EQ(sorted(app.edges),
            sorted(std::vector{pair("sensor_dummy_node.timer", "filter_node.topic1"),
                               pair("filter_node.topic1", "message_driven_node.topic2"),
                               pair("drive_node.timer", "message_driven_node.drive"),
                               pair("message_driven_node.drive", "timer_driven_node.topic3"),
                               pair("timer_driven_node.timer", "actuator_dummy_node.topic4")}));
  EXPECT_EQ(sorted(app.samples),
            sorted(std::vector{pair("message_driven_node.topic2", "message_driven_node.drive"),
                               pair("timer_driven_node.topic3", "timer_driven_node.timer")}));
  ASSERT_EQ(app.chains.size(), 1u);
  EXPECT_EQ(app.chains[0].name, "target");
  EXPECT_EQ(app.chains[0].to, app.find("actuator_dummy_node.topic4"));
  ASSERT_EQ(made->seen.executors.size(), 1u);
  EXPECT_EQ(made->seen.executors[0].kind, ExecutorKind::kMultiThreaded);
  EXPECT_EQ(made->groups.size(), 2u);
  EXPECT_GT(made->seen.chains.at(0).count, 40);
}
#endif
#endif

}  // namespace
}  // namespace xauto::import
