// SPDX-License-Identifier: Apache-2.0
// What the profiler reads of the machine, in a folder that looks like one.
#include "profile/machine_readings.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <stdlib.h>

namespace xauto::runtime {
namespace {

namespace fs = std::filesystem;
using Of = Reading::Of;

class MachineFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    // A root whose name would be a pattern.
    std::string name = ::testing::TempDir() + "xauto-[m]*-XXXXXX";
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
  }
  void TearDown() override { fs::remove_all(root_); }

  void say(const std::string& file, const std::string& text) {
    const fs::path path = root_ + file;
    fs::create_directories(path.parent_path());
    std::ofstream(path) << text;
  }
  static const Reading* find(const std::vector<Reading>& readings, const std::string& file) {
    for (const Reading& reading : readings)
      if (reading.file == file) return &reading;
    return nullptr;
  }

  std::string root_;
};

constexpr const char* kGpu = "/sys/class/devfreq/17000000.gpu/cur_freq";
constexpr const char* kGpuGovernor = "/sys/class/devfreq/17000000.gpu/governor";
constexpr const char* kCpu = "/sys/devices/system/cpu/cpufreq/policy4/scaling_cur_freq";
constexpr const char* kEmc = "/sys/kernel/debug/bpmp/debug/clk/emc/rate";
constexpr const char* kDla = "/sys/kernel/debug/clk/dla0_core/clk_rate";
constexpr const char* kZone = "/sys/class/thermal/thermal_zone1/temp";
constexpr const char* kMode = "/var/lib/nvpmodel/status";

TEST_F(MachineFiles, ABoardsClocksModeAndTemperaturesAreReadUnderTheirOwnNames) {
  say(kGpu, "1300500000\n");
  say(kGpuGovernor, "nvhost_podgov\n");
  say(kCpu, "2201600\n");
  say(kEmc, "3199000000");
  say(kDla, "1600000000\n");
  say(kZone, "51500\n");
  say("/sys/class/thermal/thermal_zone1/type", "gpu-thermal\n");
  say(kMode, "pmode:0000\n");
  MachineReadings machine(root_);
  machine.look();
  const std::vector<Reading> readings = machine.taken();
  ASSERT_EQ(readings.size(), 7u);
  for (const auto& [file, of, value] : {std::tuple(kGpu, Of::kClock, 1300500000),
                                        {kCpu, Of::kClock, 2201600},
                                        {kDla, Of::kClock, 1600000000},
                                        {kZone, Of::kTemperature, 51500}}) {
    const Reading* reading = find(readings, file);
    ASSERT_NE(reading, nullptr) << file;
    EXPECT_EQ(reading->of, of) << file;
    EXPECT_EQ(reading->first, value) << file;
    EXPECT_EQ(reading->max, value) << file;
    EXPECT_FALSE(reading->changed()) << file;
  }
  EXPECT_EQ(find(readings, kEmc)->min, 3199000000);
  EXPECT_EQ(find(readings, kZone)->name, "gpu-thermal");
  EXPECT_EQ(find(readings, kMode)->texts, std::vector<std::string>{"pmode:0000"});
  EXPECT_EQ(find(readings, kGpuGovernor)->of, Of::kGovernor);
}

TEST_F(MachineFiles, WhatChangesBetweenLooksIsKept) {
  say(kGpu, "1000000000\n");
  say(kCpu, "1000000\n");
  say(kZone, "40000\n");
  say(kMode, "pmode:0000\n");
  MachineReadings machine(root_);
  machine.look();
  say(kGpu, "300000000\n");
  say(kCpu, "990000\n");
  say(kZone, "-2000\n");
  say(kMode, "pmode:0002\n");
  machine.look();
  say(kGpu, "900000000\n");
  say(kMode, "pmode:0000\n");
  machine.look();
  const std::vector<Reading> readings = machine.taken();
  const Reading& gpu = *find(readings, kGpu);
  EXPECT_EQ(gpu.first, 1000000000);
  EXPECT_EQ(gpu.min, 300000000);
  EXPECT_EQ(gpu.max, 1000000000);
  EXPECT_EQ(gpu.last, 900000000);
  EXPECT_TRUE(gpu.changed());
  EXPECT_FALSE(find(readings, kCpu)->changed()) << "one percent is how a measured rate jitters";
  EXPECT_EQ(find(readings, kZone)->min, -2000);
  EXPECT_FALSE(find(readings, kZone)->changed()) << "a temperature may";
  EXPECT_EQ(find(readings, kMode)->texts, (std::vector<std::string>{"pmode:0000", "pmode:0002"}));
  EXPECT_TRUE(find(readings, kMode)->changed());
}

TEST_F(MachineFiles, WhatSaysNothingComparableIsPassedOver) {
  say(kGpu, "fast\n");
  say(kCpu, "");
  say(kEmc, "99999999999999999999\n");
  say(kMode, "pmode:0000\nfan:quiet\n");
  say(kZone, "\n");
  say(kGpuGovernor, "caf\xe9\n");
  say(kDla, "5\n");
  MachineReadings machine(root_);
  machine.look();
  const std::vector<Reading> readings = machine.taken();
  ASSERT_EQ(readings.size(), 1u);
  EXPECT_EQ(readings[0].file, kDla);
  MachineReadings nothing(root_ + "/none");
  nothing.look();
  EXPECT_TRUE(nothing.taken().empty());
}

}  // namespace
}  // namespace xauto::runtime
