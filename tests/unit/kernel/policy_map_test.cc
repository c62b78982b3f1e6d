// SPDX-License-Identifier: Apache-2.0
// The policy's BPF map and the folder that it is in, on this machine's kernel; left out without the right to bpf(2).
#include "kernel/policy_map.h"

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <unistd.h>

#include "kernel/run_folder.h"
#include "kernel/run_maps.h"

namespace xauto::kernel {
namespace {

class InBpffs : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!may_use_bpf() || !mount_bpffs()) GTEST_SKIP() << bpf_hint();
  }
  static bool is_alive(const std::string& run) {
    const auto runs = RunFolder::alive();
    return std::find(runs.begin(), runs.end(), run) != runs.end();
  }
  const std::string run_ = std::to_string(getpid()) + "-policy";
};

xauto_bpf_policy row(const char* xnode, std::int64_t value) {
  xauto_bpf_policy row{};
  std::string(xnode).copy(row.xnode, sizeof row.xnode - 1);
  row.value = value;
  return row;
}

using Policies = InBpffs;

TEST_F(Policies, WhoOpensWhatIsPinnedSeesAndReplacesWhatIsInForce) {
  const auto folder = RunFolder::make(run_);
  ASSERT_TRUE(folder) << folder.error().to_string();
  const auto made = PolicyMap::create({row("a", 1), row("b", 2)});
  ASSERT_TRUE(made) << made.error().to_string();
  ASSERT_TRUE(made->pin(RunFolder::path_of(run_)));
  auto other = PolicyMap::open(run_);
  ASSERT_TRUE(other) << other.error().to_string();
  ASSERT_EQ(other->rows().size(), 2u) << "a row per XNode, and none to spare";
  EXPECT_STREQ(other->rows()[1].xnode, "b");
  ASSERT_TRUE(other->put({row("a", 10), row("b", -20)}));
  EXPECT_EQ(made->rows()[1].value, -20);
  EXPECT_FALSE(other->put({row("a", 10)})) << "it has as many rows as the app";
  const auto runs = RunMaps::runs();
  EXPECT_EQ(std::count(runs.begin(), runs.end(), run_), 0) << "it has no maps to be traced by";
}

TEST_F(Policies, TooManyXNodesAndNoneAreRefused) {
  EXPECT_FALSE(PolicyMap::create({}));
  EXPECT_FALSE(PolicyMap::create(std::vector<xauto_bpf_policy>(XAUTO_BPF_MAX_XNODES + 1)));
}

TEST_F(Policies, TheFolderGoesWithTheRunAndADeadOnesIsTakenAwayByTheNext) {
  {
    auto folder = RunFolder::make(run_);
    ASSERT_TRUE(folder) << folder.error().to_string();
    EXPECT_TRUE(is_alive(run_));
    RunFolder moved = std::move(*folder);
    EXPECT_TRUE(is_alive(run_));
  }
  EXPECT_FALSE(is_alive(run_));
  EXPECT_FALSE(std::filesystem::exists(RunFolder::path_of(run_)));
  std::filesystem::create_directories(RunFolder::path_of(run_ + "-dead"));
  const auto next = RunFolder::make(run_);
  EXPECT_FALSE(std::filesystem::exists(RunFolder::path_of(run_ + "-dead")));
  EXPECT_TRUE(std::filesystem::exists(RunFolder::path_of(run_)));
}

TEST(RunNames, OthersThanLettersDigitsAndDashesAreRefused) {
  for (const std::string& name :
       {std::string(), std::string("../x"), std::string("a b"), std::string(65, 'a')})
    EXPECT_FALSE(RunFolder::check_name(name)) << name;
  EXPECT_TRUE(RunFolder::check_name("12-0"));
}

}  // namespace
}  // namespace xauto::kernel
