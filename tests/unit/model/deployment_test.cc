// SPDX-License-Identifier: Apache-2.0
// deployment.json: what holds for a module, who is in which process, what is refused and how.
#include "model/deployment.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

AppSpec make_app() {
  return {"drive",
          false,
          {{"a1", "A", {{"cpu", 10}}},
           {"a2", "A", {{"gpu", 10}}},
           {"b1", "B", {{"cpu", 10}}},
           {"c1", "C", {{"cpu", 10}}}},
          {{0, 1}},
          {}};
}

Result<Deployment> parse(const std::string& body) {
  return parse_deployment(
      R"({"schema": "xauto.deployment", "version": 1, "app": "drive")" + body + "}", "d.json",
      make_app());
}

std::string refusal(const std::string& body) {
  const auto d = parse(body);
  return d ? "" : d.error().where + ": " + d.error().what;
}

TEST(Deployment, WhatIsSaidOfAModuleGoesBeforeTheDefaults) {
  const auto d = parse(R"(, "defaults": {"isolate": true, "restarts": 3, "overload": "skip",
                            "hang_pct": 1000, "on_hang": "restart"},
      "modules": {"B": {"overload": "queue:4", "hang_us": 7000},
                  "C": {"isolate": false, "on_hang": "drop"}})");
  ASSERT_TRUE(d) << d.error().to_string();
  EXPECT_EQ(d->of("A"), d->defaults);
  const ModuleDeployment b = d->of("B");
  EXPECT_EQ(b.overload->to_string(), "queue:4");
  EXPECT_EQ(b.hang_us, 7000);
  EXPECT_FALSE(b.hang_pct);  // one of the two
  EXPECT_EQ(b.restarts, 3);
  EXPECT_EQ(b.on_hang, OnHang::kRestart);
  EXPECT_EQ(d->of("C").isolate, false);
  EXPECT_EQ(d->of("C").on_hang, OnHang::kDrop);
}

TEST(Deployment, ModulesOfOneProcessNameShareAProcess) {
  const auto d = parse(R"(, "defaults": {"isolate": true},
      "modules": {"A": {"process": "left"}, "C": {"process": "left"}})");
  ASSERT_TRUE(d);
  EXPECT_EQ(d->processes(make_app()), (std::vector<std::vector<std::string>>{{"A", "C"}, {"B"}}));
  EXPECT_EQ(parse("")->processes(make_app()).size(), 0u);
}

TEST(Deployment, WhatIsWrittenIsReadAgain) {
  const auto d = parse(R"(, "queue_depth": 4, "keep": 2,
      "defaults": {"budget_pct": 120, "hang_us": 5, "on_hang": "log", "match_us": 0},
      "modules": {"B": {"process": "x", "restarts": 1, "parameters":
          {"a": true, "b": -3, "c": 0.5, "d": 1.0, "e": "day", "f": -9223372036854775808},
          "remap": {"image": "camera/left", "x": "y"}}}, "instances": {"B": "b", "C": "b"}, "budgets_us": {"a2": 900},
      "chains": [{"name": "n", "from": "camera", "to": "C", "deadline_us": 5, "max_age_us": 6}],
      "transport": {"camera": "cyclonedds:feed", "objects": "cyclonedds",
          "imu": {"via": "cyclonedds", "feed": true, "qos": {"profile": "sensor_data", "deadline_us": 7}},
          "map": {"via": "cyclonedds", "qos": {"reliability": "best_effort",
                  "durability": "transient_local", "depth": 3}}})");
  ASSERT_TRUE(d) << d.error().to_string();
  const auto again = parse_deployment(to_json(*d), "again", make_app());
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, *d);
}

TEST(Deployment, TransportIsAWordOrAnObjectThatSaysMore) {
  const auto d = parse(R"(, "transport": {"a": "cyclonedds", "b": {"via": "cyclonedds"},
      "c": {"via": "cyclonedds", "feed": true}, "d": "cyclonedds:feed"})");
  ASSERT_TRUE(d) << d.error().to_string();
  EXPECT_EQ(d->transport.at("a"), d->transport.at("b"));
  EXPECT_EQ(d->transport.at("c"), d->transport.at("d"));
  EXPECT_TRUE(d->transport.at("c").feed);
}

TEST(Deployment, ProfileIsWhatHoldsWhereNothingElseIsSaid) {
  EXPECT_EQ(TopicQos{}.resolved(), TopicQos{});
  // The values of rmw/qos_profiles.h, rmw_qos_profile_sensor_data and rmw_qos_profile_default.
  EXPECT_EQ(TopicQos{.profile = QosProfile::kSensorData}.resolved(),
            (TopicQos{.reliability = Reliability::kBestEffort,
                      .durability = Durability::kVolatile,
                      .depth = 5}));
  EXPECT_EQ((TopicQos{.profile = QosProfile::kDefault,
                      .reliability = Reliability::kBestEffort,
                      .deadline_us = 9}
                 .resolved()),
            (TopicQos{.reliability = Reliability::kBestEffort,
                      .durability = Durability::kVolatile,
                      .depth = 10,
                      .deadline_us = 9}));
}

TEST(Deployment, ParametersKeepTheTypesThatTheyAreWrittenWith) {
  const auto d = parse(R"(, "modules": {"B": {"parameters": {"i": 1, "r": 1.0, "t": "1"}}})");
  ASSERT_TRUE(d) << d.error().to_string();
  const auto& given = d->modules.at("B").parameters;
  EXPECT_EQ(given.at("i"), ParameterValue(std::int64_t{1}));
  EXPECT_EQ(given.at("r"), ParameterValue(1.0));
  EXPECT_EQ(given.at("t"), ParameterValue(std::string("1")));
  EXPECT_TRUE(d->of("A").parameters.empty());
  EXPECT_EQ(refusal(R"(, "defaults": {"parameters": {"i": 1}})"),
            "d.json: /defaults/parameters: is for all modules, and parameters are of one");
  EXPECT_EQ(
      refusal(R"(, "modules": {"B": {"parameters": {"i": [1]}}})"),
      "d.json: /modules/B/parameters/i: must be true, false, a number or a string, is an array");
  EXPECT_NE(refusal(R"(, "modules": {"B": {"parameters": {"i": 18446744073709551615}}})"), "");
  EXPECT_NE(refusal(R"(, "modules": {"B": {"parameters": {"": 1}}})"), "");
}

TEST(Deployment, InstancesAreModulesOfTheAppIfThereIsOne) {
  const std::string text = R"({"schema": "xauto.deployment", "version": 1, "app": "drive",
      "instances": {"left": "lanes"}, "modules": {"left": {"remap": {"a": "b"}}}})";
  EXPECT_EQ(parse_deployment(text, "d.json", make_app()).error().to_string(),
            "d.json: /instances/left: instance 'left' is not in the app\n"
            "  hint: `xauto profile --deployment` of this file writes an app that has it");
  const auto d = parse_deployment(text, "d.json");
  ASSERT_TRUE(d) << d.error().to_string();
  EXPECT_EQ(d->instances.at("left"), "lanes");
  EXPECT_EQ(d->modules.at("left").remap.at("a"), "b");
  EXPECT_EQ(parse_deployment(to_json(*d), "again").value(), *d);
  EXPECT_EQ(refusal(R"(, "defaults": {"remap": {"a": "b"}})"),
            "d.json: /defaults/remap: is for all modules, and topics are renamed of one");
  EXPECT_EQ(refusal(R"(, "modules": {"B": {"remap": {"a": ""}}})"),
            "d.json: /modules/B/remap/a: must not be empty");
  EXPECT_EQ(refusal(R"(, "instances": {"": "A"})"),
            "d.json: /instances/: is of an instance without a name");
  EXPECT_EQ(refusal(R"(, "instances": {"B": ""})"),
            "d.json: /instances/B: must be the name of an XModule");
}

TEST(Deployment, RefusalsNameThePlaceAndTheCause) {
  const std::pair<const char*, const char*> cases[] = {
      {R"(, "modules": {"Z": {}})", "d.json: /modules/Z: XModule 'Z' is not in the app"},
      {R"(, "modules": [])", "d.json: /modules: must be an object, is an array"},
      {R"(, "budgets_us": {"zz": 1})", "d.json: /budgets_us/zz: XNode 'zz' is not in the app"},
      {R"(, "budgets_us": {"a1": 0})",
       "d.json: /budgets_us/a1: must be an integer from 1 to 1000000000000, is 0"},
      {R"(, "defaults": {"isolate": true, "process": "p"})",
       "d.json: /defaults/process: excludes \"isolate\""},
      {R"(, "defaults": {"hang_us": 1, "hang_pct": 2})",
       "d.json: /defaults/hang_us: excludes \"hang_pct\""},
      {R"(, "modules": {"A": {"overload": "queue:0"}})",
       "d.json: /modules/A/overload: overload policy 'queue:0'"},
      {R"(, "modules": {"A": {"on_hang": "drop"}})",
       "d.json: /modules/A/on_hang: XModule 'A' has no hang limit"},
      {R"(, "defaults": {"hang_us": 1, "on_hang": "restart"})",
       "d.json: /defaults/on_hang: XModule 'A' has no process of its own to restart"},
      {R"(, "defaults": {"on_hang": "pray"})",
       "d.json: /defaults/on_hang: must be \"log\", \"drop\" or \"restart\""},
      {R"(, "chains": [{"name": "n", "from": "t", "to": "Q"}])",
       "d.json: /chains/0/to: XModule 'Q' is not in the app"},
      {R"(, "chains": [{"name": "n", "from": "t", "to": "A"}, {"name": "n", "from": "t", "to": "B"}])",
       "d.json: /chains/1/name: is the name of another chain, too"},
      {R"(, "transport": {"t": "pigeon"})",
       "d.json: /transport/t: must be \"cyclonedds\" or \"cyclonedds:feed\""},
      {R"(, "transport": {"t": 5})", "d.json: /transport/t: must be a string, is 5"},
      {R"(, "transport": {"t": {"feed": true}})", "d.json: /transport/t: key \"via\" is missing"},
      {R"(, "transport": {"t": {"via": "cyclonedds:feed"}})",
       "d.json: /transport/t/via: must be \"cyclonedds\""},
      {R"(, "transport": {"t": {"via": "cyclonedds", "feed": 1}})",
       "d.json: /transport/t/feed: must be true or false, is 1"},
      {R"(, "transport": {"t": {"via": "cyclonedds", "qos": "sensor_data"}})",
       "d.json: /transport/t/qos: must be an object"},
      {R"(, "transport": {"t": {"via": "cyclonedds", "qos": {"profile": "fast"}}})",
       "d.json: /transport/t/qos/profile: must be \"default\" or \"sensor_data\""},
      {R"(, "transport": {"t": {"via": "cyclonedds", "qos": {"reliability": "yes"}}})",
       "d.json: /transport/t/qos/reliability: must be \"reliable\" or \"best_effort\""},
      {R"(, "transport": {"t": {"via": "cyclonedds", "qos": {"durability": "persistent"}}})",
       "d.json: /transport/t/qos/durability: must be \"volatile\" or \"transient_local\""},
      {R"(, "transport": {"t": {"via": "cyclonedds", "qos": {"depth": 0}}})",
       "d.json: /transport/t/qos/depth: must be an integer from 1 to 256, is 0"},
      {R"(, "transport": {"t": {"via": "cyclonedds", "feed": true, "qos": {"depth": 5}}})",
       "d.json: /transport/t/qos/depth: is of what goes out: of what is fed the newest message "
       "waits"},
      {R"(, "transport": {"t": {"via": "cyclonedds", "qos": {"deadline_us": -1}}})",
       "d.json: /transport/t/qos/deadline_us: must be an integer from 1 to 1000000000000, is -1"},
      {R"(, "transport": {"": "cyclonedds"})",
       "d.json: /transport/: is for a topic without a name"},
  };
  for (const auto& [body, message] : cases) EXPECT_EQ(refusal(body), message) << body;
  const auto other = parse_deployment(
      R"({"schema": "xauto.deployment", "version": 1, "app": "fly"})", "d.json", make_app());
  ASSERT_FALSE(other);
  EXPECT_EQ(other.error().what, "is for app 'fly', not for 'drive'");
}

}  // namespace
}  // namespace xauto
