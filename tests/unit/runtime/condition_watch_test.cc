// SPDX-License-Identifier: Apache-2.0
// In which scenario the machine says it is: files that are here in words; and how the watch hears of them,
// with files in a folder.
#include "runtime/condition_watch.h"

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <stdlib.h>

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
    EXPECT_EQ(holds(s, files.reader()), expected) << "'" << text << "'";
  }
}

TEST(Conditions, AllHaveToHoldAndNoneIsGuessed) {
  Files files;
  const Scenario s = when({{"/clock", 450, {}, {}}, {"/mode", {}, {}, "pmode:0002"}});
  files.text = {{"/clock", "500\n"}, {"/mode", "pmode:0002\n"}};
  EXPECT_EQ(holds(s, files.reader()), true);
  files.text["/mode"] = "pmode:0001\n";
  EXPECT_EQ(holds(s, files.reader()), false);
  files.text.erase("/mode");
  EXPECT_EQ(holds(s, files.reader()), std::nullopt) << "a file that is not there says nothing";
  EXPECT_EQ(holds(when({}), files.reader()), std::nullopt);
}

TEST(Conditions, TheLeastScenarioThatHoldsElseTheGreatestThatIsKnown) {
  Files files;
  Tables tables;
  tables.scenarios = {when({{"/clock", 900, {}, {}}}), when({{"/clock", 600, {}, {}}}),
                      when({{"/clock", 300, {}, {}}}), when({})};
  tables.serves = {{0, 10, 1}, {0, 20, 1}, {0, 30, 1}, {0, 5, 1}};
  const auto at = [&](const std::string& clock) {
    files.text["/clock"] = clock;
    return machine_in(tables, files.reader());
  };
  EXPECT_EQ(at("950").scenario, 0);
  EXPECT_EQ(at("700").scenario, 1);
  EXPECT_EQ(at("300").scenario, 2);
  EXPECT_FALSE(at("300").outside);
  EXPECT_EQ(at("299").scenario, 2);
  EXPECT_TRUE(at("299").outside);
  EXPECT_EQ(at("fast").scenario, -1) << "nobody can tell";
  EXPECT_FALSE(at("fast").outside);
}

TEST(Conditions, FilesAreReadWithinAPeriodAndNotMoreOftenThanClocksChange) {
  EXPECT_EQ(read_every_ns(0), kReadSeldomNs);
  EXPECT_EQ(read_every_ns(100'000'000), kReadSeldomNs);
  EXPECT_EQ(read_every_ns(1'000'000), kReadOftenNs);
  for (std::int64_t period = 33'400'000; period < 200'000'000; period += 1'234'567)
    EXPECT_LE(read_every_ns(period), period * 3 / 4);
}

/// A folder with one scenario's file, and what the watch sees of it.
class Watched : public testing::Test {
 protected:
  Watched() {
    std::string path = testing::TempDir() + "xauto-watch-XXXXXX";
    folder_ = mkdtemp(path.data());
    put("900");
    tables_.scenarios = {when({{file(), 900, {}, {}}})};
    tables_.serves = {{0, 10, 1}};
  }
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
  static Machine next(const ConditionWatch& watch, bool outside) {
    while (watch.now().outside != outside)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return watch.now();
  }

  std::string folder_;
  Tables tables_;
  static constexpr std::int64_t kNeverNs = 3'600'000'000'000;
};

TEST_F(Watched, WhatAProgramWritesShowsWithoutWaitingForTheClock) {
  // Nothing but inotify can end these waits within the test's time limit.
  const ConditionWatch watch(tables_, {kNeverNs, kNeverNs}, [](const Machine&) { return false; });
  EXPECT_FALSE(watch.now().outside);
  put("100");
  EXPECT_EQ(next(watch, true).scenario, 0);
  replace("900");
  next(watch, false);
  put("100");  // into the file that took its place
  next(watch, true);
}

TEST_F(Watched, AFileOfTheKernelIsReadByTheClock) {
  hide_writes();
  const ConditionWatch watch(tables_, {1'000'000, kNeverNs}, [](const Machine&) { return false; });
  put("100");
  next(watch, true);
}

TEST_F(Watched, AJobThatIsTooLongHasTheFilesReadAtOnceAndIsToldWhatTheySay) {
  hide_writes();
  std::atomic<bool> too_long{false}, told{false};
  std::atomic<int> glances{0};
  const ConditionWatch watch(tables_, {kNeverNs, 1'000'000}, [&](const Machine& machine) {
    ++glances;
    if (machine.outside) told = true;
    return too_long.load();
  });
  while (glances < 2) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  put("100");  // the first read is over, and no other is due
  too_long = true;
  EXPECT_TRUE(next(watch, true).outside);
  while (!told) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

TEST_F(Watched, WhoWritesWithoutEndDoesNotDriveTheWatch) {
  std::atomic<int> glances{0};
  const auto begin = std::chrono::steady_clock::now();
  int writes = 0;
  {
    const ConditionWatch watch(tables_, {kNeverNs, kNeverNs}, [&](const Machine&) {
      ++glances;
      return false;
    });
    for (; std::chrono::steady_clock::now() - begin < std::chrono::milliseconds(500); ++writes)
      put("900");
  }
  const auto took = std::chrono::steady_clock::now() - begin;
  EXPECT_LE(glances, took / std::chrono::nanoseconds(kHeardApartNs) + 2) << writes << " writes";
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
