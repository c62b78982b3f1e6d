// SPDX-License-Identifier: Apache-2.0
// Every format against the files under tests/golden: what we write stays byte for byte what it was,
// and every malformed file is refused with the message that stands beside it.
#include <gtest/gtest.h>

#include "model/json.h"

#include "../golden_cases.h"

namespace xauto {
namespace {

using test::golden;
using test::slurp;

AppSpec golden_app() {
  return parse_app(slurp(golden() / "app.json"), "app.json").value();
}
Platform golden_platform() {
  return parse_platform(slurp(golden() / "platform.json"), "platform.json").value();
}

TEST(Golden, AppIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "app.json");
  const auto app = parse_app(text, "app.json");
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_EQ(app->xnodes.size(), 4u);
  EXPECT_EQ(app->xnodes[1].wcet_on("dla"), 11000);
  EXPECT_EQ(app->deadline_us, 100000);
  EXPECT_EQ(to_json(*app), text);
}

// Version 1 knew no sources: without them a file stays byte for byte what it was (above), and with
// them the app is the same app.
TEST(Golden, SourcesAreWrittenAsTheyWereReadAndDoNotChangeTheHash) {
  const std::string text = slurp(golden() / "app-sources.json");
  const auto app = parse_app(text, "app-sources.json");
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_EQ(app->sources, (std::vector<SourceSpec>{{"camera", {33333}}, {"lidar/größe", {100000}}}));
  EXPECT_EQ(app->rates(), 2u);
  EXPECT_EQ(app->xnodes[3].sources, (std::vector<int>{0, 1}));
  // A join waits for its slowest input.
  EXPECT_EQ(app->periods(), (std::vector<std::int64_t>{33333, 33333, 33333, 100000}));
  EXPECT_EQ(to_json(*app), text);
  EXPECT_EQ(app->hash(), golden_app().hash());

  const std::string measured = slurp(golden() / "profile-sources.json");
  const auto profile = parse_profile(measured, "profile-sources.json");
  ASSERT_TRUE(profile) << profile.error().to_string();
  EXPECT_EQ(profile->sources, app->sources);
  EXPECT_EQ(to_json(*profile), measured);
}

TEST(Golden, PlatformIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "platform.json");
  const auto platform = parse_platform(text, "platform.json");
  ASSERT_TRUE(platform) << platform.error().to_string();
  EXPECT_EQ(platform->xpus[3].effective_switch_us(), 40);
  EXPECT_EQ(platform->xpus[2].effective_switch_us(), 275);
  EXPECT_EQ(to_json(*platform), text);
}

TEST(Golden, PolicyIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "policy.json");
  const AppSpec app = golden_app();
  const Platform platform = golden_platform();
  const auto policy = parse_policy(text, "policy.json", app, platform);
  ASSERT_TRUE(policy) << policy.error().to_string();
  EXPECT_EQ(policy->placements[0].xpu, 2);
  EXPECT_EQ(policy->order, (std::vector<std::pair<int, int>>{{3, 2}}));
  EXPECT_EQ(policy->worst_case_us, 9400);
  EXPECT_EQ(to_json(*policy, app, platform), text);
}

TEST(Golden, ProfileIsWrittenAsItWasRead) {
  const std::string text = slurp(golden() / "profile.json");
  const auto profile = parse_profile(text, "profile.json");
  ASSERT_TRUE(profile) << profile.error().to_string();
  EXPECT_EQ(profile->xnodes[0].on.at("gpu0").max_us, 750);
  EXPECT_EQ(to_json(*profile), text);
}

// The hash goes into files that outlive a release: it may not change by accident.
TEST(Golden, HashOfTheGoldenAppIsWhatItWas) {
  EXPECT_EQ(golden_app().hash(), "d80a96965b585030");
}

template <class Parse>
void every_case(const std::string& format, std::size_t at_least, Parse parse) {
  const auto cases = test::malformed(format);
  EXPECT_GE(cases.size(), at_least);
  for (const auto& path : cases) {
    const auto result = parse(slurp(path), path.filename().string());
    if (result)
      ADD_FAILURE() << path << " is accepted";
    else
      test::expect_message(path, result.error());
  }
}

TEST(Golden, EveryMalformedAppIsRefusedWithItsMessage) {
  every_case("app", 40, [](const std::string& text, const std::string& name) {
    return parse_app(text, name);
  });
}

TEST(Golden, EveryMalformedPlatformIsRefusedWithItsMessage) {
  every_case("platform", 15, [](const std::string& text, const std::string& name) {
    return parse_platform(text, name);
  });
}

TEST(Golden, EveryMalformedProfileIsRefusedWithItsMessage) {
  every_case("profile", 10, [](const std::string& text, const std::string& name) {
    return parse_profile(text, name);
  });
}

TEST(Golden, EveryMalformedPolicyIsRefusedWithItsMessage) {
  const AppSpec app = golden_app();
  const Platform platform = golden_platform();
  every_case("policy", 20, [&](const std::string& text, const std::string& name) {
    return parse_policy(text, name, app, platform);
  });
}

}  // namespace
}  // namespace xauto
