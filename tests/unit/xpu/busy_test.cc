// SPDX-License-Identifier: Apache-2.0
// What drivers' files say of how busy an XPU was, and what they do not.
#include "xpu/busy.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <stdlib.h>

namespace xauto::xpu {
namespace {

namespace fs = std::filesystem;

class Busy : public ::testing::Test {
 protected:
  void SetUp() override {
    root_ = ::testing::TempDir() + "xauto-XXXXXX";
    ASSERT_NE(mkdtemp(root_.data()), nullptr);
  }
  void TearDown() override { fs::remove_all(root_); }
  void say(const std::string& file, const std::string& text) const {
    const fs::path path = root_ + file;
    fs::create_directories(path.parent_path());
    std::ofstream(path) << text;
  }
  [[nodiscard]] std::unique_ptr<BusyMeter> meter(const std::vector<int>& cores = {0, 2}) const {
    return busy_by_drivers(small_, root_, cores);
  }
  const Platform small_ = Platform::builtin("small").value();
  const int cpu1_ = small_.find("cpu1"), cpu2_ = small_.find("cpu2"), gpu_ = small_.find("gpu0"),
            dla_ = small_.find("dla0");
  std::string root_;
};

TEST_F(Busy, ACoreIsBusyInAllThatIsNeitherIdleNorWaitingForADisk) {
  say("/proc/stat",
      "cpu  9 9 9 9 9 9 9 9 9 9\ncpu0 1 1 1 1 1 1 1 0 0 0\n"
      "cpu2 100 20 3 70000 5000 4 5 0 0 0\nintr 1\n");
  EXPECT_EQ(meter()->looks_back_ns(cpu1_), 0);
  EXPECT_EQ(meter()->busy_ns(cpu1_).value(), 132 * 10'000'000) << "ticks of USER_HZ, 100";
  EXPECT_FALSE(meter()->looks_back_ns(cpu2_)) << "this process has two cores";
  say("/proc/stat", "cpu2 100 x\n");
  EXPECT_FALSE(meter()->busy_ns(cpu1_));
  say("/proc/stat", "cpu20 1 1 1 1 1 1 1\n");
  EXPECT_FALSE(meter()->busy_ns(cpu1_));
}

TEST_F(Busy, ALoadOfTheGpuIsOfTheLastSamplesWhereverTheBusHasIt) {
  EXPECT_FALSE(meter()->looks_back_ns(gpu_));
  for (const char* file : {"/sys/devices/gpu.0/load", "/sys/devices/platform/gpu.0/load",
                           "/sys/class/devfreq/17000000.gpu/device/load"}) {
    say(file, "250\n");
    EXPECT_EQ(meter()->looks_back_ns(gpu_), 283'900'000) << file;
    EXPECT_EQ(meter()->busy_ns(gpu_).value(), 70'975'000) << file;
    for (const char* wrong : {"1001\n", "-1\n", "", "25 %\n"}) {
      const auto before = meter();
      say(file, wrong);
      EXPECT_FALSE(before->busy_ns(gpu_)) << wrong;
      say(file, "250\n");
    }
    fs::remove_all(root_ + "/sys");
  }
}

TEST_F(Busy, NobodyTellsOfADla) {
  say("/sys/devices/platform/host1x/15880000.nvdla0/power/runtime_active_time", "12345\n");
  EXPECT_FALSE(meter()->looks_back_ns(dla_)) << "it has power for long after its work";
}

}  // namespace
}  // namespace xauto::xpu
