// SPDX-License-Identifier: Apache-2.0
// Files of trtexec and CARET, answers to TODOs, and the program to fill in.
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numeric>

#include <gtest/gtest.h>

#include "model/json.h"

#include "import/answers.h"
#include "import/architecture.h"
#include "import/skeleton.h"
#include "import/trtexec.h"
#include "import/yaml.h"

namespace xauto::import {
namespace {

namespace fs = std::filesystem;

const fs::path kTrtexec = fs::path(XAUTO_SOURCE_DIR) / "../shared/data/trtexec";

std::string whole_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

ImportedApp nets(std::vector<std::int64_t> times_us) {
  const std::vector<EngineTimes> engines = {{"net", "gpu", std::move(times_us)}};
  ImportedApp made = app_of_engines(engines, "nets");
  std::vector<std::string> lines;
  EXPECT_TRUE(add_engines(engines, 0, made, lines));
  return made;
}

TEST(Trtexec, TimesAreMillisecondsRoundedUp) {
  const auto times =
      parse_trtexec_times(R"([{"latencyMs": 0.2251, "computeMs": 0.2}, {"latencyMs": 1}])", "f");
  ASSERT_TRUE(times);
  EXPECT_EQ(*times, (std::vector<std::int64_t>{226, 1000}));
}

TEST(Trtexec, WhatIsNoneOfItsFilesIsRefused) {
  for (const char* text :
       {"", "{}", "[]", "[1]", R"([{"latencyMs": -1}])", R"([{"latencyMs": 1e99}])",
        R"([{"latencyMs": "1"}])", R"([{"name": "a"}])"}) {
    EXPECT_FALSE(parse_trtexec_times(text, "f")) << text;
    EXPECT_FALSE(parse_trtexec_profile(text, "f")) << text;
  }
}

TEST(Trtexec, RealFilesAreRead) {
  if (!fs::exists(kTrtexec)) GTEST_SKIP() << "no ../shared/data";
  for (const std::string net : {"resnet18", "mobilenet_v2"}) {
    const auto times = parse_trtexec_times(whole_file(kTrtexec / (net + ".timing.json")), net);
    ASSERT_TRUE(times) << times.error().to_string();
    EXPECT_EQ(times->size(), 300u);
    const auto layers = parse_trtexec_profile(whole_file(kTrtexec / (net + ".profile.json")), net);
    ASSERT_TRUE(layers) << layers.error().to_string();
    EXPECT_GT(layers->size(), 20u);
  }
}

TEST(Trtexec, AnImplementationHasTheLongestTimeAndTheMedian) {
  const ImportedApp made = nets({300, 100, 200});
  EXPECT_EQ(made.app.xnodes[0].wcet_us.at("gpu"), 300);
  EXPECT_EQ(made.app.xnodes[0].typical_us.at("gpu"), 200);
  EXPECT_TRUE(parse_imported(to_json(made), "again"));
}

TEST(Trtexec, StagesAreAsEvenAsLayersAllow) {
  ImportedApp made = nets({1000});
  std::vector<EngineLayer> layers;
  for (const double us : {10, 40, 10, 10, 30}) layers.push_back({"layer", us});
  std::vector<std::string> lines;
  ASSERT_TRUE(cut_at_layers("net", layers, 2, made, lines));
  // All cuts in two: 10|90, 50|50, 60|40, 70|30; the longest part is least at 50|50.
  ASSERT_EQ(made.app.xnodes.size(), 2u);
  EXPECT_EQ(made.app.xnodes[0].wcet_us.at("gpu"), 500);
  EXPECT_EQ(made.app.xnodes[1].wcet_us.at("gpu"), 500);
  EXPECT_EQ(made.app.edges, (std::vector<std::pair<int, int>>{{0, 1}}));
  EXPECT_TRUE(parse_imported(to_json(made), "again"));
  EXPECT_FALSE(cut_at_layers("net", layers, 2, made, lines)) << "it is cut already";
}

TEST(Trtexec, AllCutsAreTriedByHandToo) {
  // Against every cut of eight layers in three.
  const std::vector<double> us = {7, 3, 9, 1, 8, 2, 6, 5};
  double least = 1e9;
  for (std::size_t a = 1; a < us.size(); ++a)
    for (std::size_t b = a + 1; b < us.size(); ++b) {
      const auto sum = [&](std::size_t from, std::size_t to) {
        return std::accumulate(us.begin() + static_cast<std::ptrdiff_t>(from),
                               us.begin() + static_cast<std::ptrdiff_t>(to), 0.0);
      };
      least = std::min(least, std::max({sum(0, a), sum(a, b), sum(b, us.size())}));
    }
  ImportedApp made = nets({41'000});  // 1000 us for each of the 41
  std::vector<EngineLayer> layers;
  for (const double one : us) layers.push_back({"layer", one});
  std::vector<std::string> lines;
  ASSERT_TRUE(cut_at_layers("net", layers, 3, made, lines));
  std::int64_t longest = 0;
  for (const XNodeSpec& x : made.app.xnodes) longest = std::max(longest, x.wcet_us.at("gpu"));
  EXPECT_NEAR(static_cast<double>(longest), 1000 * least, 1);
}

TEST(Answers, GoToTheirPlaces) {
  ImportedApp made = nets({300});
  ASSERT_EQ(made.todo.at(0).at, "/sources/0/rate_hz");
  EXPECT_FALSE(with_answer(made, 0, "often"));
  EXPECT_FALSE(with_answer(made, 0, "-3"));
  const auto rate = with_answer(made, 0, "30");
  ASSERT_TRUE(rate) << rate.error().to_string();
  EXPECT_EQ(rate->app.sources[0].period, *Period::of_rate("30"));
  EXPECT_EQ(rate->todo.size(), made.todo.size() - 1);
  made.todo = {{"/xnodes/0/wcet_us", "where else?"},
               {"/samples/-", "who reads whom?"},
               {"", "told"},
               {"/xnodes/9/wcet_us", "nowhere"}};
  const auto beside = with_answer(made, 0, R"({"dla": 700})");
  ASSERT_TRUE(beside) << beside.error().to_string();
  EXPECT_EQ(beside->app.xnodes[0].wcet_us.at("dla"), 700);
  EXPECT_EQ(beside->app.xnodes[0].wcet_us.at("gpu"), 300);
  EXPECT_FALSE(with_answer(made, 1, R"(["net", "nobody"])"));
  EXPECT_FALSE(with_answer(made, 2, "1"));
  EXPECT_FALSE(with_answer(made, 3, "1"));
}

TEST(Skeleton, NamesAreNeverCode) {
  ImportedApp made = nets({300});
  made.app.xnodes[0].name = R"(a"b\);int x=0;//)";
  made.app.xnodes[0].module = "1 module";
  made.app.modules = {{"1 module"}};
  const auto files = skeleton(made, "0.2");
  ASSERT_TRUE(files) << files.error().to_string();
  ASSERT_EQ(files->at(1).name, "main.cc");
  const std::string& main = files->at(1).text;
  EXPECT_NE(main.find(R"(("a\"b\\);int x=0;//"))"), std::string::npos) << main;
  EXPECT_EQ(main.find("\\\n"), std::string::npos);
}

TEST(Skeleton, AnEdgeThatNoProgramHasIsRefused) {
  ImportedApp made = nets({300});
  made.app.xnodes.push_back({"second", "net", {{"gpu", 1}}});
  made.app.xnodes.push_back({"third", "other", {{"gpu", 1}}});
  made.app.edges = {{0, 1}, {0, 2}};  // into another module from the first XNode of this one
  made.app.modules = {{"net"}, {"other"}};
  EXPECT_FALSE(skeleton(made, "0.2"));
}

#ifdef XAUTO_HAVE_LIBYAML
TEST(Yaml, IsATree) {
  const auto file = parse_yaml("a: 1\nb:\n- x\n- y: z\n", "f");
  ASSERT_TRUE(file) << file.error().to_string();
  EXPECT_EQ((*file)["a"].text, "1");
  ASSERT_EQ((*file)["b"].list.size(), 2u);
  EXPECT_EQ((*file)["b"].list[1]["y"].text, "z");
  EXPECT_EQ((*file)["nothing"]["more"].text, "");
}

TEST(Yaml, WhatGrowsOrIsBrokenIsRefused) {
  EXPECT_FALSE(parse_yaml("a: &x [1]\nb: *x\n", "f")) << "aliases grow without bound";
  EXPECT_FALSE(parse_yaml("[a", "f"));
  EXPECT_FALSE(parse_yaml("a: b: c", "f"));
  EXPECT_FALSE(parse_yaml("? [a]\n: b", "f"));
  EXPECT_FALSE(parse_yaml(std::string(200, '['), "f"));
  EXPECT_FALSE(parse_architecture("a: 1", "f"));
}
#endif

}  // namespace
}  // namespace xauto::import
