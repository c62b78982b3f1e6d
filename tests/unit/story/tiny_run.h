// SPDX-License-Identifier: Apache-2.0
// A run small enough to know every number of its trace by heart.
#pragma once

#include <string>

#include <gtest/gtest.h>

#include "story/run_trace.h"

namespace xauto::test {

using namespace xauto::story;

inline constexpr std::uint16_t kNone = XAUTO_EV_NONE;

/// Two modules on a CPU and a GPU: CAM (pre, infer) is urgent, BIG (infer) is preempted by it.
struct Tiny {
  AppSpec app;
  Platform platform;
  Scene scene;
  trace::Recording trace;

  Tiny() {
    app.name = "tiny";
    app.sources = {{"sensor", {2'000}}};
    app.xnodes = {{"cam.pre", "CAM", {{"cpu", 100}}, {0}},
                  {"cam.infer", "CAM", {{"gpu", 200}}},
                  {"big.infer", "BIG", {{"gpu", 500}}, {0}}};
    app.edges = {{0, 1}};
    app.modules = {{"CAM"}, {"BIG"}};
    app.chains = {{"see", 0, 1}, {"all", 0, 2}};
    app.deadline_us = 800;
    platform.name = "two";
    platform.xpus = {{"cpu0", "cpu"}, {"gpu0", "gpu"}};
    scene.title = "tiny on two: xauto";
    scene.note = "emulated XPUs, xauto";
    scene.rows = {{"cpu0", true}, {"gpu0", true}};
    scene.row_of = {0, 1};
    scene.modules = {{"CAM", true}, {"BIG", true}};
    scene.priorities = {1, 2, 1};
  }

  void at(std::int64_t us, std::uint16_t kind, std::uint64_t seq, std::uint16_t xnode = kNone,
          std::uint16_t module = kNone, std::uint16_t xpu = kNone, std::uint32_t arg = 0) {
    trace.events.push_back(
        {static_cast<std::uint64_t>(1'000'000 + us * 1000), seq, xnode, module, xpu, kind, arg, 0});
  }

  void publish(std::int64_t us, std::uint64_t seq) {
    at(us, XAUTO_EV_PUBLISH, seq, kNone, kNone, kNone, XAUTO_TAKE_SOURCE);
  }
  /// At `us`, of the message that was released at `origin`.
  void activate(std::int64_t us, std::uint64_t seq, std::uint16_t module, std::int64_t origin) {
    at(us, XAUTO_EV_ACTIVATE, seq, kNone, module);
    at(us, XAUTO_EV_TAKE, static_cast<std::uint64_t>(1'000'000 + origin * 1000), kNone, module,
       kNone, XAUTO_TAKE_SOURCE);
  }

  /// One release, beginning at `us`: BIG runs, is preempted by CAM, resumes.
  void release(std::int64_t us, std::uint64_t seq) {
    publish(us, seq);
    activate(us + 1, seq, 0, us);
    at(us + 2, XAUTO_EV_READY, seq, 0, 0, 0);
    activate(us + 3, seq, 1, us);
    at(us + 4, XAUTO_EV_READY, seq, 2, 1, 1);
    at(us + 5, XAUTO_EV_START, seq, 0, 0, 0);
    at(us + 6, XAUTO_EV_RUN, seq, 0, 0, 0);
    at(us + 7, XAUTO_EV_START, seq, 2, 1, 1);
    at(us + 8, XAUTO_EV_RUN, seq, 2, 1, 1);
    at(us + 100, XAUTO_EV_FINISH, seq, 0, 0, 0);
    at(us + 101, XAUTO_EV_READY, seq, 1, 0, 1);
    at(us + 102, XAUTO_EV_START, seq, 1, 0, 1);
    at(us + 104, XAUTO_EV_SUSPEND, seq, 2, 1, 1);
    at(us + 114, XAUTO_EV_SUSPENDED, seq, 2, 1, 1);
    at(us + 115, XAUTO_EV_RUN, seq, 1, 0, 1);
    at(us + 315, XAUTO_EV_RESUME, seq, 2, 1, 1);
    at(us + 318, XAUTO_EV_RESUMED, seq, 2, 1, 1);
    at(us + 320, XAUTO_EV_FINISH, seq, 1, 0, 1);  // later than the XPU was handed over
    at(us + 321, XAUTO_EV_DONE, seq, kNone, 0);
    at(us + 720, XAUTO_EV_FINISH, seq, 2, 1, 1);
    at(us + 721, XAUTO_EV_DONE, seq, kNone, 1);
  }

  std::string file() const {
    const auto story = story_of(app, platform, scene.modules, trace);
    EXPECT_TRUE(story) << story.error().to_string();
    if (!story) return {};
    const auto bytes = perfetto_trace(app, scene, *story, 0);
    EXPECT_TRUE(bytes) << bytes.error().to_string();
    return bytes.value_or(std::string());
  }
};

}  // namespace xauto::test
