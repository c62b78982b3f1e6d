// SPDX-License-Identifier: Apache-2.0
// In which scenario the machine says it is: files that are here, in words.
#include "runtime/condition_watch.h"

#include <map>

#include <gtest/gtest.h>

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

TEST(Conditions, AFileThatCannotBeReadIsNamed) {
  Files files;
  Tables tables;
  tables.scenarios = {when({}), when({{"/clock", 900, {}, {}}, {"/emc", 1, {}, {}}})};
  files.text = {{"/clock", "1\n"}, {"/emc", "not even a number"}};
  EXPECT_EQ(unreadable(tables, files.reader()), std::nullopt) << "whatever they say";
  files.text.erase("/emc");
  EXPECT_EQ(unreadable(tables, files.reader()), "/emc");
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

}  // namespace
}  // namespace xauto::runtime
