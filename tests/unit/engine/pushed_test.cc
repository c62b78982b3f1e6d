// SPDX-License-Identifier: Apache-2.0
// Sources that are pushed into: every publish is a release, and nothing is kept for another run.
#include <algorithm>
#include <cctype>
#include <chrono>
#include <optional>

#include <gtest/gtest.h>

#include "base/clock.h"

#include "test_app.h"

namespace xauto::runtime {
namespace {

/// TestApp with a pushed camera, and a driver that publishes from on_start on.
class PushedApp : public TestApp {
 public:
  explicit PushedApp(std::chrono::microseconds distance = 1us) {
    detail::SourceSpec& source = spec.sources.front();
    source.period = {distance.count()};
    source.make = nullptr;
    inlet = source.inlet = std::make_shared<detail::Inlet>("camera", distance.count() * 1000);
    camera.emplace(inlet);
    spec.on_start.emplace_back([this] { driver_ = std::thread([this] { driver(); }); });
    spec.on_stop.emplace_back([this] { join(); });
  }
  ~PushedApp() { join(); }
  void join() {
    if (driver_.joinable()) driver_.join();
  }

  std::shared_ptr<detail::Inlet> inlet;
  std::optional<Source<int>> camera;
  std::function<void()> driver = [] {};

 private:
  std::thread driver_;
};

/// How many messages of the camera the report calls not released.
std::uint64_t too_late(const RunReport& report) {
  const std::string intro = "source 'camera': ", outro = " messages were not released";
  for (auto at = report.note.find(intro); at != std::string::npos;
       at = report.note.find(intro, at)) {
    at += intro.size();
    std::size_t length = 0;
    const unsigned long count =
        std::isdigit(report.note[at]) != 0 ? std::stoul(report.note.substr(at), &length) : 0;
    if (report.note.compare(at + length, outro.size(), outro) == 0) return count;
  }
  return 0;
}

TEST(Pushed, EveryPublishIsAReleaseWithItsNumberAndTheTimeOfTheCall) {
  PushedApp app;
  app.session.releases.lockstep = false;
  app.session.releases.activations = 5;
  app.session.deployment.defaults.overload = Overload{Overload::Kind::kQueue, 64};
  std::vector<std::int64_t> before, after;
  app.driver = [&] {
    for (int k = 0; k < 5; ++k) {
      before.push_back(now_ns());
      EXPECT_TRUE(app.camera->publish(k));
      after.push_back(now_ns());
      std::this_thread::sleep_for(2ms);
    }
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete) << report->note;
  EXPECT_EQ(report->note, "");
  ASSERT_EQ(report->releases.size(), 5u);
  for (std::size_t k = 0; k < 5; ++k) {
    EXPECT_EQ(report->releases[k].sequence, k);
    EXPECT_GE(report->releases[k].latency_us, 0);
    EXPECT_GE(report->releases[k].origin_ns, before[k]);
    EXPECT_LE(report->releases[k].origin_ns, after[k]);
  }
  EXPECT_EQ(count(app.log(), "c1"), 5u);
}

/// By keys, camera -> A and tick -> T: both have the period 10 ms and the clock "main", and the tick is polled.
class PushedByKeys : public PushedApp {
 public:
  PushedByKeys() : PushedApp(10ms) {
    const Topic<int> tick("tick"), a("a/out"), t("t/out");
    spec.modules.clear();
    spec.sources.push_back(
        {*detail::topic_spec(tick), Period{10'000},
         [](std::uint64_t k, detail::MessageMemory*) -> std::shared_ptr<const void> {
           return std::make_shared<const int>(static_cast<int>(k));
         }});
    add("A", {"a1"}, {*detail::topic_spec(camera_topic())}, a);
    add("T", {"t1"}, {*detail::topic_spec(tick)}, t);
    AppSpec& app = session.app;
    app.sources = {{"camera", {10'000}}, {"tick", {10'000}}};
    app.modules = {{"A"}, {"T"}};
    app.edges.clear();
    app.xnodes = {{"a1", "A", {{"cpu", 1'000}}}, {"t1", "T", {{"cpu", 1'000}}}};
    for (int x : {0, 1}) app.xnodes[static_cast<std::size_t>(x)].sources = {x};
    app.chains = {{"camera", 0, 0}, {"tick", 1, 1}};
    session.keys.emplace();
    session.keys->placements = {{0, {5'000}}, {0, {5'000}}};
    session.policy.placements = {{0, 2}, {0, 1}};
    session.deployment.defaults.overload = Overload{Overload::Kind::kQueue, 256};
    session.releases.lockstep = false;
    session.releases.activations = 0;
    session.releases.duration_us = 300'000;
  }
  /// Publishes every `us` from now on, until the run is over.
  void publish_every(std::chrono::microseconds us) {
    driver = [this, us] {
      auto next = std::chrono::steady_clock::now();
      while (camera->publish(published)) {
        ++published;
        std::this_thread::sleep_until(next += us);
      }
    };
  }
  [[nodiscard]] const Topic<int>& camera_topic() const { return TestApp::camera; }
  int published = 0;
};

TEST(Pushed, WhoIsTooFastHurriesNobodyOnItsClock) {
  PushedByKeys app;
  app.publish_every(2ms);
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  const ModuleReport &a = report->modules[0], &t = report->modules[1];
  // Of the time grid alone: some 32 in 300 ms, whatever comes on the clock. They were 160.
  EXPECT_LE(t.activations + t.dropped, 45u);
  EXPECT_GT(t.activations, 20u);
  // Each message is a release, and each result that of its own.
  EXPECT_EQ(a.activations + a.dropped + too_late(*report),
            static_cast<std::uint64_t>(app.published));
  EXPECT_GT(a.activations, 60u);
  EXPECT_GE(report->account.chains[0].latency_us.count(), a.activations);
  std::string broken;
  for (const Assumption& one : report->account.assumptions)
    for (const std::string& line : one.words) broken += line + "\n";
  EXPECT_NE(broken.find("source 'camera' was up to "), std::string::npos) << broken;
  EXPECT_NE(broken.find("came sooner than its period and jitter allow"), std::string::npos);
  EXPECT_NE(broken.find(" came in the time of "), std::string::npos) << broken;
}

TEST(Pushed, InLockstepMessagesWaitTheirTurnAndNothingIsLost) {
  PushedApp app;
  app.session.releases.activations = 100;
  app.driver = [&] {
    for (int k = 0; k < 100; ++k) EXPECT_TRUE(app.camera->publish(k));
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete) << report->note;
  EXPECT_EQ(report->num_releases, 100u);
  EXPECT_EQ(report->lost_releases, 0u);
}

/// Of several rates: polled releases are not late by what is pushed before them, and both drain.
TEST(Pushed, InLockstepPolledReleasesComeWhenTheyAreSaidTo) {
  PushedByKeys app;
  app.session.releases.lockstep = true;
  app.session.releases.duration_us = 0;
  app.session.releases.activations = 4;
  std::atomic<int> inside{0}, most{0};
  app.exec = [&](const std::string&, std::uint64_t) -> Status {
    most = std::max(most.load(), ++inside);
    std::this_thread::sleep_for(2ms);
    --inside;
    return {};
  };
  app.driver = [&] {
    for (int k = 0; k < 6; ++k) EXPECT_TRUE(app.camera->publish(k));
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->modules[1].activations, 4u);
  EXPECT_GE(report->modules[0].activations, 1u);
  EXPECT_EQ(most.load(), 1) << "each release waits for the one before";
  for (const std::size_t chain : {0u, 1u}) {
    const ChainAccount& route = report->account.chains[chain];
    EXPECT_EQ(route.latency_us.count(), report->modules[chain].activations);
    EXPECT_EQ(route.not_measured, 0u);
  }
  // The run waits 100 ms between two of them; that is nobody's latency. Of the fastest one, since a machine may stall.
  const std::vector<std::int64_t> us = report->account.chains[1].latency_us.exact();
  ASSERT_FALSE(us.empty());
  EXPECT_LT(*std::min_element(us.begin(), us.end()), 90'000);
}

TEST(Pushed, WhatComesTooEarlyIsReleasedAndCounted) {
  PushedApp app(1h);
  app.session.releases.activations = 4;
  app.driver = [&] {
    for (int k = 0; k < 4; ++k) EXPECT_TRUE(app.camera->publish(k));
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->num_releases, 4u);
  EXPECT_NE(report->note.find("source 'camera': 3 of 4 messages came less than the declared "
                              "3600000000 us after the one before"),
            std::string::npos)
      << report->note;
}

TEST(Pushed, OutsideOfARunAMessageIsAnErrorAndIsNotKept) {
  PushedApp app;
  const Status before = app.camera->publish(1);
  ASSERT_FALSE(before);
  EXPECT_EQ(before.error().code, ErrorCode::kUnavailable);
  EXPECT_EQ(before.error().where, "topic 'camera'");
  app.session.releases.activations = 2;
  app.driver = [&] {
    for (int k = 0; k < 2; ++k) EXPECT_TRUE(app.camera->publish(k));
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->num_releases, 2u);
  EXPECT_FALSE(app.camera->publish(3));
  EXPECT_EQ(app.camera->publish(std::shared_ptr<const int>()).error().code, ErrorCode::kInvalid);
}

TEST(Pushed, TooManyThatWaitAreRefused) {
  std::atomic<std::uint32_t> bell{0};
  detail::Inlet inlet("camera", 1);
  inlet.open(bell, detail::Inlet::Keep::kAll);
  const Source<int> camera(std::shared_ptr<detail::Inlet>(std::shared_ptr<void>(), &inlet));
  for (std::size_t k = 0; k < detail::Inlet::kMaxWaiting; ++k) EXPECT_TRUE(camera.publish(0));
  const Status refused = camera.publish(0);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUnavailable);
  EXPECT_EQ(inlet.close(), detail::Inlet::kMaxWaiting);
}

TEST(Pushed, BesideAPolledSourceBothReleaseOnTheirOwn) {
  PushedApp app;
  const Topic<int> slow("slow");
  app.spec.sources.push_back(
      {*detail::topic_spec(slow), Period{20'000},
       [](std::uint64_t k, detail::MessageMemory*) -> std::shared_ptr<const void> {
         return std::make_shared<const int>(static_cast<int>(k));
       }});
  app.spec.modules[1]->inputs = {*detail::topic_spec(slow)};  // B
  app.session.releases.lockstep = false;
  app.session.releases.activations = 5;  // of the polled one
  app.session.deployment.defaults.overload = Overload{Overload::Kind::kQueue, 64};
  int published = 0;
  app.driver = [&] {
    while (app.camera->publish(published)) {
      ++published;
      std::this_thread::sleep_for(3ms);
    }
  };
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete) << report->note;
  EXPECT_TRUE(report->several_rates);
  EXPECT_EQ(report->modules[1].activations, 5u);
  // Some that were published while the run ended may have been too late; the report counts them.
  const std::uint64_t released = report->modules[0].activations + report->modules[0].dropped;
  EXPECT_EQ(released + too_late(*report), static_cast<std::uint64_t>(published));
  EXPECT_GT(published, 5);
}

TEST(Pushed, AStopEndsARunThatNobodyPublishesInto) {
  PushedApp app;
  app.session.releases.activations = 0;
  std::atomic<bool> begun{false};
  app.spec.on_start.emplace_back([&] { begun = true; });
  app.stop_when = &begun;
  const auto report = app.run();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->num_releases, 0u);
}

TEST(Pushed, OnStartThatThrowsEndsTheRun) {
  PushedApp app;
  app.spec.on_start.emplace_back([] { throw std::runtime_error("no camera"); });
  int stops = 0;
  app.spec.on_stop.emplace_back([&] { ++stops; });
  const auto report = app.run();
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().what, "on_start threw: no camera");
  EXPECT_EQ(stops, 1);  // what had been started is stopped
}

}  // namespace
}  // namespace xauto::runtime
