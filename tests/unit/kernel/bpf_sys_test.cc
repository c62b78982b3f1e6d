// SPDX-License-Identifier: Apache-2.0
#include "kernel/bpf_sys.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

namespace xauto::kernel {
namespace {

class PossibleCpus : public ::testing::Test {
 protected:
  void SetUp() override {
    root_ = std::filesystem::temp_directory_path() / ("xauto-bpf-sys-" + std::to_string(getpid()));
    std::filesystem::create_directories(root_ / "sys/devices/system/cpu");
  }
  void TearDown() override { std::filesystem::remove_all(root_); }
  void put(const std::string& list) {
    std::ofstream(root_ / "sys/devices/system/cpu/possible") << list << '\n';
  }
  std::filesystem::path root_;
};

TEST_F(PossibleCpus, TheLastNumberOfTheListTellsHowManyValuesThereAreAtMost) {
  put("0");
  EXPECT_EQ(possible_cpus(root_).value(), 1u);
  put("0-127");
  EXPECT_EQ(possible_cpus(root_).value(), 128u);
  put("0,2-5");
  EXPECT_EQ(possible_cpus(root_).value(), 6u);
}

TEST_F(PossibleCpus, NonsenseIsRefusedWithItsText) {
  const auto missing = possible_cpus(root_);
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().where.find("cpu/possible"), std::string::npos);
  for (const char* list : {"", "0-", "none", "123456789"}) {
    put(list);
    const auto bad = possible_cpus(root_);
    ASSERT_FALSE(bad) << list;
    EXPECT_EQ(bad.error().what, "'" + std::string(list) + "' is no list of CPUs");
  }
}

}  // namespace
}  // namespace xauto::kernel
