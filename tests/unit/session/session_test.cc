// SPDX-License-Identifier: Apache-2.0
#include "session/session.h"

#include <gtest/gtest.h>

#include "model/periodic.h"
#include "session/run_report.h"

namespace xauto::runtime {
namespace {

Session steady() {
  Session session;
  session.app.version = 2;
  session.app.name = "two";
  session.app.clocks = {{"main", 0}, {"other", 50}};
  session.app.sources = {{"s", {100'000, 3}, 2'000, 10}, {"t", {10'000}, 0, 0, 1}};
  session.app.xnodes = {{"a", "A", {{"cpu", 100}}, {0}}, {"b", "B", {{"cpu", 200}}, {1}}};
  session.app.modules = {{"A"}, {"B"}};
  session.app.samples = {{0, 1}};
  session.app.chains = {{"c", 0, 1}};
  session.platform = {"one", {{"cpu0", "cpu"}}};
  return session;
}

TEST(Session, PrioritiesTravelWithAnAppOfVersion2) {
  Session session = steady();
  const AppSpec once = as_version_1(session.app);
  EXPECT_TRUE(validate(once));
  EXPECT_EQ(once.sources, (std::vector<SourceSpec>{{"s", {33'333}}, {"t", {10'000}}}));
  EXPECT_TRUE(once.samples.empty() && once.chains.empty());
  session.policy.app = "two";
  session.policy.app_hash = once.hash();
  session.policy.platform = "one";
  session.policy.method = "test";
  session.policy.placements = {{0, 2, 0, 100}, {0, 1, 100, 300}};
  session.policy.latency_us = 300;
  session.policy.lower_bound_us = 100;
  const auto read = parse_session(to_json(session));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_FALSE(read->keys);
  EXPECT_EQ(read->policy, session.policy);
  EXPECT_EQ(read->app, session.app);
  session.policy.app_hash = session.app.hash();  // of another app
  EXPECT_FALSE(parse_session(to_json(session)));
}

TEST(Session, KeysTravelAsKeys) {
  Session session = steady();
  session.keys = KeyPolicy{"two",  session.app.hash(),         "one",
                           "test", {{0, {5'000}}, {0, {300}}}, {{"c", 50'000, 300}},
                           0};
  session.policy = assignment_of(*session.keys);
  const auto read = parse_session(to_json(session));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->keys, session.keys);
  EXPECT_EQ(read->policy, session.policy);
}

TEST(RunReport, WhatWasNotSuspendedTravels) {
  RunReport report;
  report.contexts = {1, 2, 3, 4, 5, 6};
  const auto read = parse_run_report(to_json(report));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->contexts.partial, 1u);
  EXPECT_EQ(read->contexts.unclaimed, 2u);
  EXPECT_EQ(read->contexts.assumed, 3u);
  EXPECT_EQ(read->contexts.shared, 4u);
  EXPECT_EQ(read->contexts.gated, 5u);
  EXPECT_EQ(read->contexts.held_up, 6u);
}

}  // namespace
}  // namespace xauto::runtime
