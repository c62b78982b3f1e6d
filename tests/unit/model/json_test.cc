// SPDX-License-Identifier: Apache-2.0
// What the golden files cannot show: leniency, size limits, files on disk.
#include "model/json.h"

#include <filesystem>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "model/periodic.h"

#include "app_text.h"

namespace xauto {
namespace {

using test::app_text;

class Folder {
 public:
  Folder()
      : path_(std::filesystem::temp_directory_path() /
              ("xauto_json_test." + std::to_string(getpid()))) {
    std::filesystem::create_directories(path_);
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  [[nodiscard]] std::string operator/(const std::string& name) const {
    return (path_ / name).string();
  }

 private:
  std::filesystem::path path_;
};

TEST(Json, UnknownKeysAndNullOptionsAreIgnored) {
  const auto app =
      parse_app(app_text(R"(,"deadline_us":null,"colour":{"a":[1.5,null]})"), "a.json");
  ASSERT_TRUE(app) << app.error().to_string();
  EXPECT_FALSE(app->deadline_us);
}

TEST(Json, PlatformKeysThatOtherToolsLeaveOutHaveDefaults) {
  const auto platform = parse_platform(
      R"({"schema":"xauto.platform","version":1,"name":"p","xpus":[{"id":"npu0","type":"npu"}]})",
      "p.json");
  ASSERT_TRUE(platform) << platform.error().to_string();
  EXPECT_TRUE(platform->xpus[0].preemptive);
  EXPECT_EQ(platform->xpus[0].preempt_us, 0);
  EXPECT_EQ(platform->xpus[0].timeslice_us, 0);
  EXPECT_EQ(platform->xpus[0].effective_switch_us(), 0);
}

TEST(Json, ByteOrderMarkIsAccepted) {
  EXPECT_TRUE(parse_app("\xef\xbb\xbf" + app_text(""), "a.json"));
}

TEST(Json, MessagesStayShortHoweverLongTheValue) {
  const std::string endless(1 << 20, 'y');
  for (const std::string& text :
       {"{\"schema\":\"" + endless + "\"}", "{\"" + endless + "\":1,\"" + endless + "\":2}",
        "{\"schema\":\"" + endless, "[" + endless,
        app_text(",\"deadline_us\":\"" + endless + "\"")}) {
    const auto app = parse_app(text, "a.json");
    ASSERT_FALSE(app);
    EXPECT_LT(app.error().to_string().size(), 600u);
  }
}

TEST(Json, LargeAppRoundTrips) {
  AppSpec app;
  app.name = "large";
  app.one_at_a_time = true;
  app.sources = {{"s", kNoRate}};
  for (int i = 0; i < 1000; ++i) {
    app.xnodes.push_back(
        {"n" + std::to_string(i), "M" + std::to_string(i / 10), {{"cpu", 1 + i}, {"gpu", 2}}});
    for (int j = std::max(0, i - 5); j < i; ++j) app.edges.emplace_back(j, i);
  }
  app.xnodes[0].sources = {0};
  complete_modules(app);
  complete_chains(app);
  const std::string text = to_json(app);
  const auto again = parse_app(text, "large.json");
  ASSERT_TRUE(again) << again.error().to_string();
  EXPECT_EQ(*again, app);
  EXPECT_EQ(to_json(*again), text);
}

// nlohmann's callback parser looks at all of a list for each object in it: 6.2 s for 50 000 of them.
TEST(Json, AListOfAMillionObjectsIsReadAtOnce) {
  std::string list = R"(,"extra":[{})";
  for (int i = 1; i < 1'000'000; ++i) list += ",{}";
  const auto app = parse_app(app_text(list + "]"), "a.json");
  EXPECT_TRUE(app) << app.error().to_string();
}

TEST(Json, PolicyMayListXNodesInAnyOrder) {
  const Platform platform = Platform::builtin("small").value();
  AppSpec app = parse_app(app_text(""), "a.json").value();
  app.xnodes.push_back({"y", "N", {{"gpu", 5}}, {0}});
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.method = "heft";
  policy.placements = {{0, {}}, {platform.find("gpu0"), {}}};
  policy.placements[0].priority = 2;
  policy.placements[1].priority = 1;
  policy.certified = false;
  std::string text = to_json(policy, app, platform);
  const std::size_t x = text.find(R"({ "name": "x")"), y = text.find(R"({ "name": "y")");
  ASSERT_LT(x, y);
  std::swap(text[x + 11], text[y + 11]);
  const auto swapped = parse_policy(text, "p.json", app, platform);
  ASSERT_FALSE(swapped);
  EXPECT_EQ(swapped.error().where, "p.json: /xnodes/1/xpu") << swapped.error().to_string();
  EXPECT_EQ(parse_policy(to_json(policy, app, platform), "p.json", app, platform).value(), policy);
}

TEST(Json, LevelsAreOfAPreemptiveXpuAlone) {
  const auto with = [](const std::string& rest) {
    return parse_platform(R"({"schema": "xauto.platform", "version": 1, "name": "p", "xpus": [)"
                          R"({"id": "gpu0", "type": "gpu", )" +
                              rest + "}]}",
                          "p.json");
  };
  const auto three = with(R"("levels": 3)");
  ASSERT_TRUE(three) << three.error().to_string();
  EXPECT_EQ(three->xpus[0].levels, 3);
  EXPECT_EQ(parse_platform(to_json(*three), "again")->xpus, three->xpus);
  EXPECT_EQ(with(R"("levels": 0)")->xpus[0].levels, 0);
  for (const char* wrong : {R"("levels": 1)", R"("levels": -3)", R"("levels": 1025)",
                            R"("levels": 2.5)", R"("levels": 3, "preemptive": false)"}) {
    const auto refused = with(wrong);
    ASSERT_FALSE(refused) << wrong;
    EXPECT_EQ(refused.error().where, "p.json: /xpus/0/levels") << refused.error().to_string();
  }
}

TEST(Platform, IsThePolicysUnlessToldOtherwise) {
  const Folder folder;
  const std::string path = folder / "policy.json";
  const auto name_of = [&](const char* policy, const std::string& given) {
    EXPECT_TRUE(write_file(path, policy));
    const auto platform = load_platform_of(path, given);
    return platform ? platform->name : platform.error().to_string();
  };
  EXPECT_EQ(name_of(R"({"platform": "large"})", ""), "large");
  EXPECT_EQ(name_of(R"({"platform": "large"})", "small"), "small");
  EXPECT_EQ(name_of("{}", ""), "small");
  EXPECT_EQ(name_of("no JSON", ""), "small") << "who reads all of it tells what is wrong";
  const std::string refused = name_of(R"({"platform": "/etc/passwd"})", "");
  EXPECT_NE(refused.find("was made for platform '/etc/passwd', which does not come with XAuto"),
            std::string::npos)
      << refused;
}

TEST(File, IsReplacedAsAWhole) {
  const Folder folder;
  const std::string path = folder / "out.json";
  ASSERT_TRUE(write_file(path, "first, and longer"));
  ASSERT_TRUE(write_file(path, "second"));
  EXPECT_EQ(read_file(path).value(), "second");
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder / ""))
    files += entry.exists() ? 1 : 0;
  EXPECT_EQ(files, 1) << "nothing is left beside it";
}

TEST(File, ThatIsMissingAFolderOrAPipeIsRefusedAtOnce) {
  const Folder folder;
  EXPECT_EQ(read_file(folder / "none").error().code, ErrorCode::kNotFound);
  EXPECT_EQ(read_file(folder / "").error().code, ErrorCode::kInvalid);
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  EXPECT_EQ(read_file(folder / "pipe").error().code, ErrorCode::kInvalid);
  EXPECT_EQ(load_platform(folder / "none").error().hint, std::string("use ") + kPlatformNames);
  EXPECT_FALSE(write_file(folder / "no/such/folder", "x"));
}

}  // namespace
}  // namespace xauto
