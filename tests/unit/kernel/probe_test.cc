// SPDX-License-Identifier: Apache-2.0
// Other machines, as folders.
#include "kernel/probe.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "kernel/device_nodes.h"

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

class Machine : public ::testing::Test {
 protected:
  void SetUp() override {
    root_ = fs::temp_directory_path() / ("xauto-probe-" + std::to_string(getpid()));
    fs::remove_all(root_);
    fs::create_directories(root_);
  }
  void TearDown() override { fs::remove_all(root_); }
  void file(const std::string& path, const std::string& text = "") {
    fs::create_directories((root_ / path).parent_path());
    std::ofstream(root_ / path) << text;
  }
  Finding find(const std::string& id) {
    for (const Finding& f : probe(root_.string(), limits_, devices_))
      if (f.id == id) return f;
    return {"absent", Verdict::kOk, "", "", ""};
  }
  const std::vector<Device> devices_ = {
      {"gpu", {kGpuNodes, kGpuNodes + 2}, "a Jetson's GPU", "nvgpu", "needs a Jetson"},
      {"gpu", {kRmNodes[0]}, "a GPU of NVIDIA's RM driver", "nvidia", ""},
      {"dla", {kDlaNodes, kDlaNodes + 4}, "a Jetson's DLA", "nvdla", "needs a Jetson"}};
  fs::path root_;
  Permitted limits_{"6.1.0", 4, 99, 99, ~0ull, false};
};

TEST_F(Machine, LaptopLacksWhatAJetsonHas) {
  for (const char* id : {"gpu", "dla", "xauto.ko", "sched_ext", "btf", "opencl"})
    EXPECT_EQ(find(id).verdict, Verdict::kMissing) << id;
  EXPECT_EQ(find("realtime").verdict, Verdict::kOk);
}

TEST_F(Machine, OrinIsRecognised) {
  file("dev/nvgpu/igpu0/tsg");
  file("dev/nvhost-ctrl-nvdla0");
  file("dev/nvhost-ctrl-nvdla1");
  file("proc/modules", "nvgpu 1 0 - Live 0x0\nxauto 16384 0 - Live 0x0\n");
  EXPECT_EQ(find("gpu").found, "/dev/nvgpu/igpu0/tsg");
  EXPECT_EQ(find("dla").found, "/dev/nvhost-ctrl-nvdla0 /dev/nvhost-ctrl-nvdla1");
  EXPECT_EQ(find("xauto.ko").verdict, Verdict::kOk);
}

TEST_F(Machine, ReleasesOfL4TAreToldApart) {
  EXPECT_EQ(find("jetson").id, "absent");
  const auto release = [&](const std::string& of) {
    file("etc/nv_tegra_release", "# R" + of + ", GCID: 1, BOARD: generic, EABI: aarch64\n");
    return find("jetson");
  };
  file("proc/device-tree/model", std::string("NVIDIA Jetson AGX Orin\0", 23));
  Finding f = release("35 (release), REVISION: 6.0");
  EXPECT_EQ(f.found, "L4T 35.6.0, NVIDIA Jetson AGX Orin");
  EXPECT_NE(f.meaning.find("no BPF"), std::string::npos);
  EXPECT_NE(f.meaning.find("nvdla is built in"), std::string::npos);
  f = release("36 (release), REVISION: 4.3");
  EXPECT_EQ(f.found, "L4T 36.4.3, NVIDIA Jetson AGX Orin");
  EXPECT_NE(f.meaning.find("no BTF"), std::string::npos);
  file("dev/nvgpu/igpu0/tsg");
  EXPECT_NE(release("39 (release), REVISION: 2.0").meaning.find("nvgpu"), std::string::npos);
  EXPECT_NE(release("41 (release), REVISION: 0.0").meaning.find("nobody"), std::string::npos);
  EXPECT_EQ(find("gpu").verdict, Verdict::kOk);
}

TEST_F(Machine, ThorHasNoTsg) {
  file("etc/nv_tegra_release", "# R38 (release), REVISION: 4.0, GCID: 1\n");
  file("dev/nvidiactl");
  EXPECT_NE(find("jetson").meaning.find("RM"), std::string::npos);
  EXPECT_EQ(find("gpu").verdict, Verdict::kOk);
  EXPECT_EQ(find("gpu").found, "/dev/nvidiactl");
  EXPECT_EQ(find("dla").found, "no nvdla device node");
}

TEST_F(Machine, AKernelWithoutBpfIsNotAQuestionOfRights) {
  limits_.has_bpf = false;
  EXPECT_EQ(find("bpf").found, "this kernel has no bpf(2)");
  EXPECT_EQ(find("btf").verdict, Verdict::kMissing);
}

TEST_F(Machine, AGroupWithoutRuntimeMayRunNoRealTimeThread) {
  EXPECT_EQ(find("rt_groups").id, "absent");
  file("sys/fs/cgroup/cpu/cpu.rt_runtime_us", "950000\n");
  file("proc/self/cgroup", "5:cpuset:/\n4:cpu,cpuacct:/\n0::/user.slice\n");
  EXPECT_EQ(find("rt_groups").verdict, Verdict::kOk);
  file("proc/self/cgroup", "5:cpuset:/\n4:cpu,cpuacct:/user.slice\n0::/user.slice\n");
  file("sys/fs/cgroup/cpu/user.slice/cpu.rt_runtime_us", "0\n");
  const Finding f = find("rt_groups");
  EXPECT_EQ(f.verdict, Verdict::kDegraded);
  EXPECT_EQ(f.found, "/sys/fs/cgroup/cpu/user.slice/cpu.rt_runtime_us: 0");
  limits_.highest_fifo = 0;
  EXPECT_EQ(find("realtime").advice, "see rt_groups");
  file("proc/sys/kernel/sched_rt_runtime_us", "-1\n");
  EXPECT_EQ(find("rt_groups").verdict, Verdict::kOk);
}

TEST_F(Machine, ModuleOfASimilarNameIsNotOurs) {
  file("proc/modules", "xauto_nvgpu_emu 1 0 - Live 0x0\n");
  EXPECT_EQ(find("xauto.ko").verdict, Verdict::kMissing);
}

TEST_F(Machine, SchedExtThatIsTakenSaysByWhom) {
  file("sys/kernel/sched_ext/state", "enabled\n");
  file("sys/kernel/sched_ext/root/ops", "scx_lavd\n");
  const Finding f = find("sched_ext");
  EXPECT_EQ(f.verdict, Verdict::kDegraded);
  EXPECT_EQ(f.found, "another sched_ext scheduler is loaded: 'scx_lavd'");
  file("sys/kernel/sched_ext/state", "disabled\n");
  EXPECT_NE(find("sched_ext").found.find("no BTF"), std::string::npos);
  file("sys/kernel/btf/vmlinux", "");
  EXPECT_EQ(find("sched_ext").verdict, Verdict::kOk);
  file("sys/devices/system/cpu/isolated", "2-3\n");
  EXPECT_NE(find("sched_ext").meaning.find("isolated CPUs (2-3)"), std::string::npos);
  file("sys/kernel/realtime", "1\n");
  EXPECT_EQ(find("sched_ext").verdict, Verdict::kDegraded);
}

TEST_F(Machine, TheDumpOfASchedulerThatTheKernelEndedIsNamed) {
  EXPECT_EQ(find("sched_ext dump").id, "absent");
  file("run/xauto/sched_ext.dump", "run 12-0: runnable task stall\nmore\n");
  const Finding f = find("sched_ext dump");
  EXPECT_EQ(f.verdict, Verdict::kDegraded);
  EXPECT_EQ(f.found, "run 12-0: runnable task stall");
  EXPECT_NE(f.advice.find("/run/xauto/sched_ext.dump"), std::string::npos);
}

TEST_F(Machine, UnprivilegedUserIsToldHowToGetMore) {
  limits_.highest_fifo = 0;
  limits_.rtprio_limit = 0;
  limits_.memlock_bytes = 8u << 20;
  EXPECT_EQ(find("realtime").verdict, Verdict::kDegraded);
  EXPECT_NE(find("realtime").advice.find("rtprio 60"), std::string::npos);
  EXPECT_NE(find("realtime").advice.find("/etc/security/limits.d/xauto.conf"), std::string::npos);
  EXPECT_NE(find("realtime").advice.find("LimitRTPRIO=60"), std::string::npos);
  EXPECT_EQ(find("memlock").verdict, Verdict::kDegraded);
  limits_.root = true;  // in a container, say
  EXPECT_NE(find("realtime").advice.find("CAP_SYS_NICE"), std::string::npos);
}

TEST_F(Machine, RangeOfPrioritiesThatIsPermittedIsTold) {
  limits_.highest_fifo = 20;
  EXPECT_EQ(find("realtime").verdict, Verdict::kOk);
  EXPECT_EQ(find("realtime").found, "SCHED_FIFO permitted up to 20");
  limits_.highest_fifo = 60;
  EXPECT_EQ(find("realtime").found, "SCHED_FIFO permitted");
}

TEST_F(Machine, ThrottlingAndClocksAreSeen) {
  file("proc/sys/kernel/sched_rt_runtime_us", "950000\n");
  file("proc/sys/kernel/sched_rt_period_us", "1000000\n");
  file("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "schedutil\n");
  EXPECT_EQ(find("rt_throttling").verdict, Verdict::kDegraded);
  EXPECT_EQ(find("cpufreq").verdict, Verdict::kDegraded);
  file("proc/sys/kernel/sched_rt_runtime_us", "-1\n");
  file("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n");
  EXPECT_EQ(find("rt_throttling").verdict, Verdict::kOk);
  EXPECT_EQ(find("cpufreq").verdict, Verdict::kOk);
}

}  // namespace
}  // namespace xauto::kernel
