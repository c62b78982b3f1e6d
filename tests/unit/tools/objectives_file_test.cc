// SPDX-License-Identifier: Apache-2.0
// The solver's keys of app.json: what is read, and how malformed ones are refused, with the place.
#include "xauto/objectives_file.h"

#include <gtest/gtest.h>

#include "solver/random.h"

namespace xauto::cli {
namespace {

std::string refusal(const std::string& text) {
  const auto objectives = parse_objectives(text, "app.json");
  return objectives ? "" : objectives.error().to_string();
}

TEST(ObjectivesFile, ReadsEveryKey) {
  const auto read = parse_objectives(R"({
    "pins": [{"xnode": "camera", "xpu": "cpu0"}], "forbids": [{"xnode": "detect", "xpu": "dla"}],
    "groups": [["a", "b"], ["c", "d", "e"]]})",
                                     "app.json");
  ASSERT_TRUE(read.has_value()) << read.error().to_string();
  EXPECT_EQ(read->pins.at(0), std::pair(std::string("camera"), std::string("cpu0")));
  EXPECT_EQ(read->forbids.at(0), std::pair(std::string("detect"), std::string("dla")));
  EXPECT_EQ(read->groups.size(), 2U);
  EXPECT_EQ(read->groups[1], (std::vector<std::string>{"c", "d", "e"}));
}

TEST(ObjectivesFile, NothingAskedIsNothing) {
  const auto read = parse_objectives(R"({"name": "x", "xnodes": []})", "app.json");
  ASSERT_TRUE(read.has_value());
  EXPECT_TRUE(read->empty());
}

TEST(ObjectivesFile, ChainsAreTheAppsOwn) {
  const auto read = parse_objectives(R"({"chains": [{"name": "brake", "from": "cam",
    "to": "x"}], "pins": [{"xnode": "x", "xpu": "cpu"}]})",
                                     "app.json");
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_TRUE(read->chains.empty());
  EXPECT_EQ(read->pins.size(), 1u);
}

TEST(ObjectivesFile, RefusesWhatIsMalformedAndSaysWhere) {
  const std::pair<const char*, const char*> cases[] = {
      {R"({"pins": "camera"})", "/pins"},
      {R"({"pins": [["camera", "cpu0"]]})", "/pins/0/xnode"},
      {R"({"pins": [{"xnode": "camera"}]})", "/pins/0/xpu"},
      {R"({"pins": [{"xnode": "a", "xpu": "cpu0"}, {"xnode": "b", "xpu": 0}]})", "/pins/1/xpu"},
      {R"({"forbids": [{"xpu": "cpu0"}]})", "/forbids/0/xnode"},
      {R"({"groups": ["a", "b"]})", "/groups/0"},
      {R"({"groups": [["a", 1]]})", "/groups/0"},
      {R"({"groups": null})", "/groups"},
  };
  for (const auto& [text, where] : cases) {
    const std::string said = refusal(text);
    EXPECT_NE(said.find(where), std::string::npos) << text << "\n  said: " << said;
    EXPECT_NE(said.find("app.json"), std::string::npos) << text;
    EXPECT_NE(said.find("expected"), std::string::npos) << text << "\n  said: " << said;
  }
}

TEST(ObjectivesFile, NoDamagedTextCrashesIt) {
  const std::string good = R"({"pins":[{"xnode":"a","xpu":"cpu0"}],"groups":[["a","b"]]})";
  solver::Random random(1);
  for (int round = 0; round < 20'000; ++round) {
    std::string damaged = good;
    for (std::uint64_t k = random.below(4) + 1; k > 0; --k) {
      const std::size_t at = random.below(damaged.size());
      switch (random.below(3)) {
        case 0:
          damaged[at] = static_cast<char>(random.below(256));
          break;
        case 1:
          damaged.erase(at, random.below(6) + 1);
          break;
        default:
          damaged.insert(at, good.substr(random.below(good.size()), random.below(8)));
      }
      if (damaged.empty()) damaged = "{";
    }
    const auto read = parse_objectives(damaged, "app.json");
    if (read) {
      EXPECT_TRUE(read->chains.empty());
    }
  }
}

TEST(ObjectivesFile, AnAssignmentHasTwoSides) {
  EXPECT_EQ(*parse_assignment("a=b", "--pin"), std::pair(std::string("a"), std::string("b")));
  EXPECT_EQ(*parse_assignment("a=b=c", "--pin"), std::pair(std::string("a=b"), std::string("c")));
  for (const char* bad : {"", "=", "a", "a=", "=b"}) {
    const auto parsed = parse_assignment(bad, "--pin");
    ASSERT_FALSE(parsed.has_value()) << bad;
    EXPECT_NE(parsed.error().to_string().find("--pin"), std::string::npos);
  }
}

TEST(ObjectivesFile, WishesComeOnTopOfTheFile) {
  auto objectives = *parse_objectives(R"({"pins": [{"xnode": "a", "xpu": "cpu"}]})", "app.json");
  Wishes wishes;
  wishes.pins = {"b=gpu0"};
  wishes.forbids = {"c=dla"};
  wishes.groups = {"a,b", "c"};
  ASSERT_TRUE(add_to_objectives(wishes, objectives));
  EXPECT_EQ(objectives.pins.size(), 2U);
  EXPECT_EQ(objectives.forbids.size(), 1U);
  EXPECT_EQ(objectives.groups.at(0), (std::vector<std::string>{"a", "b"}));
  wishes.forbids = {"c"};
  EXPECT_FALSE(add_to_objectives(wishes, objectives));
}

}  // namespace
}  // namespace xauto::cli
