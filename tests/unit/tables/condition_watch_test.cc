// SPDX-License-Identifier: Apache-2.0
// In which scenario the machine says it is: files that are here in words; and how the watch hears of them,
// with files in a folder.
#include "tables/condition_watch.h"

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>
#include <stdlib.h>

#include "../no_more_threads.h"
#include "tests/unit/tables_of.h"

namespace xauto::runtime {
namespace {

class Files {
 public:
  std::map<std::string, std::string> text;
  [[nodiscard]] ReadText reader() const {
    return [this](const std::string& path) -> std::optional<std::string> {
      const auto at = text.find(path);
      return at == text.end() ? std::nullopt : std::optional(at->second);
    };
  }
};

Scenario when(std::vector<Condition> conditions) {
  Scenario scenario{"some"};
  scenario.when = std::move(conditions);
  return scenario;
}

/// One XNode, on the GPU. A scenario takes `pct` percent of its time, and its table is the variant `small` if
/// `loses`.
struct Point {
  std::int64_t pct, worst_case_us;
  bool loses;
  std::vector<Condition> when;
};
class Points {
 public:
  explicit Points(const std::vector<Point>& points) {
    app.xnodes.push_back({"a", "m", {{"gpu", 1000}}});
    app.xnodes[0].variants = {{"small", 50, {{"gpu", 400}}}};
    tables.tables = {test::table_of(app, "whole", {0}, {1000}),
                     test::table_of(app, "small", {0}, {1000}, {{0}, {}})};
    for (const Point& point : points) {
      Scenario scenario{std::to_string(point.pct) + " %", {{"gpu", point.pct}}};
      scenario.when = point.when;
      tables.scenarios.push_back(scenario);
      test::serve(tables, app, point.loses ? 1 : 0);
      tables.serves.back().worst_case_us = point.worst_case_us;
    }
  }
  [[nodiscard]] MachineState in(const Files& files) const {
    return machine_in(tables, ScenarioOrder(app, tables), files.reader());
  }
  AppSpec app;
  Tables tables;
};
std::vector<Condition> at_least(std::int64_t clock) {
  return {{"/clock", clock, {}, {}}};
}

TEST(Conditions, ANumberIsComparedAsAWholeAndSpaceAroundItIsNone) {
  Files files;
  const Scenario s = when({{"/clock", 450, 900, {}}});
  for (const auto& [text, expected] :
       std::map<std::string, std::optional<bool>>{{"450\n", true},
                                                  {" 900", true},
                                                  {"449", false},
                                                  {"901\n", false},
                                                  {"-5", false},
                                                  {"", std::nullopt},
                                                  {"600 MHz", std::nullopt},
                                                  {"99999999999999999999", std::nullopt},
                                                  {"0x258", std::nullopt}}) {
    files.text["/clock"] = text;
    const auto passed = passed_by(s, files.reader());
    EXPECT_EQ(passed ? std::optional(*passed == 0) : std::nullopt, expected) << "'" << text << "'";
  }
}

TEST(Conditions, AllHaveToHoldAndNoneIsGuessed) {
  Files files;
  const Scenario s = when({{"/clock", 450, {}, {}}, {"/mode", {}, {}, "pmode:0002"}});
  files.text = {{"/clock", "500\n"}, {"/mode", "pmode:0002\n"}};
  EXPECT_EQ(passed_by(s, files.reader()), 0);
  files.text["/mode"] = "pmode:0001\n";
  EXPECT_EQ(passed_by(s, files.reader()), 1);
  files.text.erase("/mode");
  EXPECT_EQ(passed_by(s, files.reader()), std::nullopt) << "a file that is not there says nothing";
  EXPECT_EQ(passed_by(when({}), files.reader()), std::nullopt);
}

TEST(Conditions, TheLeastScenarioThatHoldsElseTheOneThatCoversMost) {
  const Points points({{100, 10, false, at_least(900)},
                       {150, 20, false, at_least(600)},
                       {300, 30, false, at_least(300)},
                       {400, 5, false, {}}});
  const auto at = [&](const std::string& clock) {
    Files files;
    files.text["/clock"] = clock;
    return points.in(files);
  };
  EXPECT_EQ(at("950").scenario, 0);
  EXPECT_EQ(at("700").scenario, 1);
  EXPECT_EQ(at("300").scenario, 2);
  EXPECT_TRUE(at("300").outside.empty());
  EXPECT_EQ(at("299").scenario, 2);
  EXPECT_FALSE(at("299").outside.empty());
  EXPECT_EQ(at("fast").scenario, -1) << "nobody can tell";
  EXPECT_TRUE(at("fast").outside.empty());
}

/// At full clock all hold. Worst cases of one release, in which what is lost makes the slowest scenario's the
/// shortest; and of tables of keys, which have one for all that they serve.
TEST(Conditions, NothingIsLostAtFullClockAndMostOutside) {
  for (const std::vector<std::int64_t>& worst :
       {std::vector<std::int64_t>{20, 30, 16, 18}, {20, 20, 20, 20}, {20, 20, 10, 10}}) {
    // In an order in which the first is not the answer by itself.
    const Points points({{500, worst[3], true, at_least(200)},
                         {150, worst[1], false, at_least(666)},
                         {300, worst[2], true, at_least(333)},
                         {100, worst[0], false, at_least(1000)}});
    Files files;
    for (const auto& [clock, pct] : std::map<std::string, std::string>{
             {"1000", "100 %"}, {"999", "150 %"}, {"400", "300 %"}, {"200", "500 %"}}) {
      files.text["/clock"] = clock;
      const MachineState machine = points.in(files);
      ASSERT_GE(machine.scenario, 0);
      EXPECT_EQ(points.tables.scenarios[static_cast<std::size_t>(machine.scenario)].name, pct)
          << clock << ", " << worst[2];
      EXPECT_TRUE(machine.outside.empty());
    }
    files.text["/clock"] = "100";
    EXPECT_EQ(points.in(files).scenario, 0) << worst[2];
  }
}

TEST(Conditions, WhatIsThereIsTheLeastInWcetsThoughAnotherHasAShorterWorstCase) {
  const Points points({{200, 10, false, at_least(500)}, {100, 20, false, at_least(1000)}});
  Files files;
  files.text["/clock"] = "1000";
  EXPECT_EQ(points.in(files).scenario, 1);
}

TEST(Conditions, WhatIsOutsideIsNamedWithTheLimitThatItPasses) {
  Points points({{100, 10, false, {{"/clock", 900, {}, {}}, {"/mode", {}, {}, "MAXN"}}},
                 {200, 20, false, {{"/clock", 600, 1000, {}}, {"/mode", {}, {}, "MAXN"}}}});
  Files files;
  files.text = {{"/clock", "318\n"}, {"/mode", "MAXN\n"}};
  MachineState machine = points.in(files);
  ASSERT_EQ(machine.outside.size(), 1u);
  EXPECT_EQ(machine.outside[0].file, "/clock");
  EXPECT_EQ(machine.outside[0].words, "/clock is 318, every scenario needs at least 600");
  files.text = {{"/clock", "1200\n"}, {"/mode", "15\xff W\n"}};
  machine = points.in(files);
  EXPECT_EQ(machine.scenario, 1);
  ASSERT_EQ(machine.outside.size(), 2u);
  EXPECT_EQ(machine.outside[0].words, "/clock is 1200, '200 %' needs at most 1000");
  EXPECT_EQ(machine.outside[1].words, "/mode is '15? W', every scenario needs 'MAXN'");
}

TEST(Conditions, OfThoseThatNoOtherCoversTheOneThatIsPassedByLeast) {
  Points points({{100, 10, false, {{"/gpu", 900, {}, {}}, {"/cpu", 900, {}, {}}}},
                 {200, 20, false, {{"/gpu", 450, {}, {}}, {"/cpu", 900, {}, {}}}},
                 {100, 40, false, {{"/gpu", 900, {}, {}}, {"/cpu", 450, {}, {}}}}});
  points.app.xnodes.push_back({"b", "m", {{"cpu", 1000}}});
  points.tables.scenarios[2].wcet_scale_pct["cpu"] = 200;
  for (Table& table : points.tables.tables) {
    table.keys.placements.push_back({1, {1000}});
    if (!table.loss.variant.empty()) table.loss.variant.push_back(-1);
  }
  Files files;
  files.text = {{"/gpu", "300\n"}, {"/cpu", "900\n"}};
  EXPECT_EQ(points.in(files).scenario, 1);
  files.text = {{"/gpu", "900\n"}, {"/cpu", "300\n"}};
  EXPECT_EQ(points.in(files).scenario, 2);
}

TEST(Conditions, FilesAreReadWithinAPeriodAndNotMoreOftenThanClocksChange) {
  EXPECT_EQ(read_every_ns(0), kReadSeldomNs);
  EXPECT_EQ(read_every_ns(100'000'000), kReadSeldomNs);
  EXPECT_EQ(read_every_ns(1'000'000), kReadOftenNs);
  for (std::int64_t period = 33'400'000; period < 200'000'000; period += 1'234'567)
    EXPECT_LE(read_every_ns(period), period * 3 / 4);
}

/// A folder with one scenario's file, and what the watch sees of it.
class Watched : public ::testing::Test {
 protected:
  Watched() {
    std::string path = ::testing::TempDir() + "xauto-watch-XXXXXX";
    folder_ = mkdtemp(path.data());
    put("900");
    tables_.scenarios = {when({{file(), 900, {}, {}}})};
    tables_.tables = {test::table_of({}, "one", {}, {})};
    test::serve(tables_, {}, 0);
  }
  const ScenarioOrder& order() { return order_.emplace(AppSpec{}, tables_); }
  ~Watched() override { std::filesystem::remove_all(folder_); }
  [[nodiscard]] std::string file() const { return folder_ + "/cur_freq"; }
  void put(const std::string& text) const { std::ofstream(file()) << text; }
  /// As programs do that want no reader to see half of it.
  void replace(const std::string& text) const {
    std::ofstream(file() + ".new") << text;
    std::filesystem::rename(file() + ".new", file());
  }
  /// From inotify, as the kernel's own are: the file then lies behind a link to another folder.
  void hide_writes() const {
    const std::string other = folder_ + "/other";
    std::filesystem::create_directory(other);
    std::filesystem::rename(file(), other + "/cur_freq");
    std::filesystem::create_symlink(other + "/cur_freq", file());
  }
  /// What the watch says, once it says something else than `before`.
  static MachineState next(const ConditionWatch& watch, bool outside) {
    while (watch.now().outside.empty() == outside)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return watch.now();
  }

  [[nodiscard]] std::unique_ptr<ConditionWatch> start(const ConditionWatch::Timing& timing,
                                                      ConditionWatch::Glance glance) {
    auto started = ConditionWatch::start(tables_, order(), timing, std::move(glance));
    EXPECT_TRUE(started);
    return std::move(*started);
  }

  std::string folder_;
  Tables tables_;
  std::optional<ScenarioOrder> order_;
  static constexpr std::int64_t kNeverNs = 3'600'000'000'000;
};

TEST_F(Watched, WhatAProgramWritesShowsWithoutWaitingForTheClock) {
  // Nothing but inotify can end these waits within the test's time limit.
  const auto watch = start({kNeverNs, kNeverNs}, [](const MachineState&) { return false; });
  EXPECT_TRUE(watch->now().outside.empty());
  put("100");
  EXPECT_EQ(next(*watch, true).scenario, 0);
  replace("900");
  next(*watch, false);
  put("100");  // into the file that took its place
  next(*watch, true);
}

TEST_F(Watched, AFileOfTheKernelIsReadByTheClock) {
  hide_writes();
  const auto watch = start({1'000'000, kNeverNs}, [](const MachineState&) { return false; });
  put("100");
  next(*watch, true);
}

TEST_F(Watched, AJobThatIsTooLongHasTheFilesReadAtOnceAndIsToldWhatTheySay) {
  hide_writes();
  std::atomic<bool> too_long{false}, told{false};
  std::atomic<int> glances{0};
  const auto watch = start({kNeverNs, 1'000'000}, [&](const MachineState& machine) {
    ++glances;
    if (!machine.outside.empty()) told = true;
    return too_long.load();
  });
  while (glances < 2) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  put("100");  // the first read is over, and no other is due
  too_long = true;
  EXPECT_FALSE(next(*watch, true).outside.empty());
  while (!told) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

TEST_F(Watched, WhoWritesWithoutEndDoesNotDriveTheWatch) {
  std::atomic<int> glances{0};
  const auto begin = std::chrono::steady_clock::now();
  int writes = 0;
  {
    const auto watch = start({kNeverNs, kNeverNs}, [&](const MachineState&) {
      ++glances;
      return false;
    });
    for (; std::chrono::steady_clock::now() - begin < std::chrono::milliseconds(500); ++writes)
      put("900");
  }
  const auto took = std::chrono::steady_clock::now() - begin;
  EXPECT_LE(glances, took / std::chrono::nanoseconds(kHeardApartNs) + 2) << writes << " writes";
}

TEST_F(Watched, WhereThreadsEndItSaysSo) {
  const NoMoreThreads none;
  const auto watch = ConditionWatch::start(tables_, order(), {kNeverNs, kNeverNs},
                                           [](const MachineState&) { return false; });
  ASSERT_FALSE(watch);
  EXPECT_EQ(watch.error().what.find("no more threads: "), 0u) << watch.error().what;
}

TEST_F(Watched, OtherFilesOfTheFolderAreNobodysBusiness) {
  FileChanges changes({file()});
  ASSERT_GE(changes.fd(), 0);
  std::ofstream(folder_ + "/else") << "1";
  EXPECT_FALSE(changes.take());
  put("1");
  EXPECT_TRUE(changes.take());
  EXPECT_FALSE(changes.take()) << "taken is taken";
  std::filesystem::remove(file());
  EXPECT_TRUE(changes.take());
}

}  // namespace
}  // namespace xauto::runtime
