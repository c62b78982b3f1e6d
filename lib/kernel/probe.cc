// SPDX-License-Identifier: Apache-2.0
#include "kernel/probe.h"

#include <filesystem>
#include <fstream>

#include <sys/resource.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "base/first_line.h"
#include "base/rt.h"
#include "kernel/bpf_sys.h"
#include "kernel/device_nodes.h"
#include "kernel/run_maps.h"
#include "kernel/scx_scheduler.h"

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

class Probe {
 public:
  Probe(std::string root, const Permitted& limits, const std::vector<Device>& devices)
      : root_(std::move(root)), limits_(limits), devices_(devices) {}

  std::vector<Finding> run() {
    kernel();
    jetson();
    cores();
    realtime();
    throttling();
    real_time_groups();
    memory_lock();
    sched_ext();
    sched_ext_dump();
    btf();
    bpf();
    module();
    for (std::size_t i = 0; i < devices_.size(); ++i) device(i);
    governor();
    opencl();
    return std::move(findings_);
  }

 private:
  [[nodiscard]] bool there(const std::string& path) const {
    std::error_code error;
    return fs::exists(root_ + path, error);
  }
  [[nodiscard]] std::string first_line(const std::string& path) const {
    return xauto::first_line(root_ + path);
  }
  void add(std::string id, Verdict verdict, std::string found, std::string meaning,
           std::string advice = {}) {
    findings_.push_back(
        {std::move(id), verdict, std::move(found), std::move(meaning), std::move(advice)});
  }

  void kernel() {
    const bool rt = first_line("/sys/kernel/realtime") == "1";
    add("kernel", Verdict::kOk, limits_.kernel_release + (rt ? ", PREEMPT_RT" : ""),
        rt ? "real-time kernel: sched_ext is refused, CPU XNodes use SCHED_FIFO"
           : "general kernel");
  }

  /// What its release has by NVIDIA's configuration; the other findings say what is there.
  void jetson() {
    const std::string line =
        first_line("/etc/nv_tegra_release");  // "# R36 (release), REVISION: 4.3, ..."
    if (line.rfind("# R", 0) != 0) return;
    const std::string release = line.substr(3, line.find(' ', 2) - 3);
    const std::size_t revision = line.find("REVISION: ");
    std::string found = "L4T " + release;
    if (revision != std::string::npos)
      found += "." + line.substr(revision + 10, line.find(',', revision) - revision - 10);
    const std::string board = first_line("/proc/device-tree/model");
    if (!board.empty()) found += std::string(", ") + board.c_str();  // it ends by a NUL
    std::string meaning = "a release that nobody has read for XAuto";
    if (release == "35")
      meaning =
          "its own kernel has no BPF (no sched_ext, no `xauto top --record`) and RT groups; nvdla "
          "is "
          "built in";
    else if (release == "36")
      meaning = "its own kernel has no BTF: no sched_ext";
    else if (release == "38" || release == "39")
      meaning = rm()
                    ? "its GPU driver is NVIDIA's RM: xauto.ko suspends nothing here, each process "
                      "its own work"
                    : "Linux 6.8: no sched_ext; the GPU driver is nvgpu";
    add("jetson", Verdict::kOk, found, meaning, "docs/jetson.md has the list for the first board");
  }

  /// NVIDIA's RM driver, and no nvgpu.
  [[nodiscard]] bool rm() const { return there(rm::kControlNode) && !there(kNvgpuFolder); }

  void cores() {
    const std::string isolated = first_line("/sys/devices/system/cpu/isolated");
    add("cores", Verdict::kOk,
        std::to_string(limits_.cores) + " usable" +
            (isolated.empty() ? "" : ", isolated: " + isolated),
        "XNodes that compute themselves have up to " + std::to_string(limits_.cores) +
            " CPUs of a platform; stand-ins any number, emulated");
  }

  void realtime() {
    const std::string limit = "rtprio limit " + std::to_string(limits_.rtprio_limit);
    constexpr int kEnough = 60;  // of the coordinators; lib/model/fifo_range.h
    if (limits_.highest_fifo >= kEnough)
      add("realtime", Verdict::kOk, "SCHED_FIFO permitted", "CPU XNodes run by priority");
    else if (limits_.highest_fifo > 0)
      add("realtime", Verdict::kOk,
          "SCHED_FIFO permitted up to " + std::to_string(limits_.highest_fifo),
          "CPU XNodes run by priority; those beyond what the range has room for share one");
    else
      add("realtime", Verdict::kDegraded, "SCHED_FIFO refused, " + limit,
          "CPU XNodes run as ordinary threads: priorities are not enforced on real CPUs",
          group_has_no_runtime() ? "see rt_groups" : rt::way_to_fifo(limits_.root));
  }

  void throttling() {
    const std::string runtime = first_line("/proc/sys/kernel/sched_rt_runtime_us");
    const std::string period = first_line("/proc/sys/kernel/sched_rt_period_us");
    if (runtime.empty()) return;
    if (runtime == "-1" || runtime == period)
      add("rt_throttling", Verdict::kOk, "off", "real-time threads may use a whole core");
    else
      add("rt_throttling", Verdict::kDegraded, runtime + " of " + period + " us",
          "a core that real-time threads keep busy for longer is taken from them for the rest of "
          "the period",
          "keep CPU XNodes below that load, or `sysctl kernel.sched_rt_runtime_us=-1`");
  }

  /// CONFIG_RT_GROUP_SCHED, as JetPack 5 has it: in a group without a runtime of its own no thread
  /// may be a real-time one, not even root's. The group's file; "": no such configuration.
  [[nodiscard]] std::string runtime_file() const {
    const std::string top = "/sys/fs/cgroup/cpu", file = "/cpu.rt_runtime_us";
    if (!there(top + file)) return {};
    std::ifstream groups(root_ + "/proc/self/cgroup");  // "4:cpu,cpuacct:/user.slice"
    std::string own;
    for (std::string line; std::getline(groups, line);) {
      const std::size_t name = line.find(':'), path = line.find(':', name + 1);
      if (path == std::string::npos) continue;
      const std::string controllers = "," + line.substr(name + 1, path - name - 1) + ",";
      if (controllers.find(",cpu,") != std::string::npos) own = line.substr(path + 1);
    }
    return top + (own == "/" ? "" : own) + file;
  }
  [[nodiscard]] bool group_has_no_runtime() const {
    const std::string file = runtime_file();
    return !file.empty() && first_line(file) == "0" &&
           first_line("/proc/sys/kernel/sched_rt_runtime_us") != "-1";
  }

  void real_time_groups() {
    const std::string file = runtime_file();
    if (file.empty()) return;
    if (!group_has_no_runtime())
      return add("rt_groups", Verdict::kOk, file + ": " + first_line(file),
                 "CPU XNodes run by priority where SCHED_FIFO is permitted");
    add("rt_groups", Verdict::kDegraded, file + ": 0",
        "this group may run no real-time thread, not even root's: priorities are not enforced on "
        "real CPUs",
        "write a runtime to that file, or `sysctl kernel.sched_rt_runtime_us=-1`");
  }

  void memory_lock() {
    constexpr unsigned long long kEnough = 256ull << 20;
    const bool unlimited = limits_.memlock_bytes == ~0ull;
    if (unlimited || limits_.memlock_bytes >= kEnough)
      add("memlock", Verdict::kOk,
          unlimited ? "unlimited" : std::to_string(limits_.memlock_bytes >> 20) + " MiB",
          "coordinators keep their memory resident");
    else
      add("memlock", Verdict::kDegraded, std::to_string(limits_.memlock_bytes >> 20) + " MiB",
          "coordinators may be paged out: rare long decisions",
          "put '@GROUP - memlock unlimited' into /etc/security/limits.d/xauto.conf");
  }

  void sched_ext() {
    if (!there("/sys/kernel/sched_ext")) {
      add("sched_ext", Verdict::kMissing, "not in this kernel", "CPU XNodes use SCHED_FIFO",
          "a kernel from 6.12 on with CONFIG_SCHED_CLASS_EXT has it");
      return;
    }
    if (const std::string refusal = scx_refusal(root_); !refusal.empty())
      return add("sched_ext", Verdict::kDegraded, refusal, "CPU XNodes use SCHED_FIFO",
                 refusal.rfind("another", 0) == 0 ? "stop it to use XAuto's" : "");
    const std::string isolated = first_line("/sys/devices/system/cpu/isolated");
    add("sched_ext", Verdict::kOk, "available",
        "`xauto run --cpu-sched ext` schedules CPU XNodes" +
            (isolated.empty() ? std::string(" and everything else beside them (full mode)")
                              : "; alone on isolated CPUs (" + isolated +
                                    "), else with everything beside them"));
  }

  void sched_ext_dump() {
    if (const auto kept = kept_scx_dump(root_))
      add("sched_ext dump", Verdict::kDegraded,
          kept->about.empty() ? "the kernel ended a scheduler of ours; only root reads why"
                              : kept->about,
          "CPU XNodes of that run went on under SCHED_FIFO",
          "see " + kept->path + "; the file goes with the next boot, or remove it");
  }

  void bpf() {
    if (!limits_.has_bpf)
      add("bpf", Verdict::kMissing, "this kernel has no bpf(2)",
          "no sched_ext, no `xauto top --record`", "a kernel with CONFIG_BPF_SYSCALL has it");
    else if (const Status built = bpf_is_built_in(); !built)
      add("bpf", Verdict::kMissing, built.error().what, "no sched_ext, no `xauto top --record`",
          built.error().hint);
    else if (!limits_.may_use_bpf)
      add("bpf", Verdict::kDegraded, "built in, but not permitted to this user",
          "no sched_ext, no `xauto top --record`", bpf_hint());
    else
      add("bpf", Verdict::kOk, "built in and permitted", "`xauto top` sees the kernel");
  }

  void btf() {
    if (there("/sys/kernel/btf/vmlinux"))
      add("btf", Verdict::kOk, "/sys/kernel/btf/vmlinux",
          "BPF programs fit themselves to this kernel");
    else
      add("btf", Verdict::kMissing, "no /sys/kernel/btf/vmlinux",
          "no sched_ext; tracing sees no threads of containers",
          "a kernel with CONFIG_DEBUG_INFO_BTF has it");
  }

  void module() {
    if (module_is_loaded(root_))
      add("xauto.ko", Verdict::kOk, "loaded", "GPU TSGs and DLA queues can be suspended");
    else
      add("xauto.ko", Verdict::kMissing, "not loaded",
          "each process suspends its own TSGs and DLA queues: one that hangs resumes nobody until "
          "it is killed",
          "`insmod xauto.ko` on a Jetson (docs/kernel.md)");
  }

  [[nodiscard]] std::string nodes_of(const Device& device) const {
    std::string nodes;
    for (const std::string& node : device.nodes)
      if (there(node)) nodes += (nodes.empty() ? "" : " ") + node;
    return nodes;
  }

  /// Of several drivers of a type one that is there, else the first is what is missing.
  void device(std::size_t index) {
    const Device& device = devices_[index];
    const std::string nodes = nodes_of(device);
    if (nodes.empty())
      for (std::size_t i = 0; i < devices_.size(); ++i)
        if (devices_[i].type == device.type && (i < index || !nodes_of(devices_[i]).empty()))
          return;
    if (!nodes.empty())
      return add(device.type, Verdict::kOk, nodes,
                 device.what + (device.suspended ? ", " + device.suspended(root_) : ""));
    add(device.type, Verdict::kMissing, "no " + device.driver + " device node",
        "a platform's " + device.type + " is emulated on this machine", device.advice);
  }

  void governor() {
    const std::string governor =
        first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
    if (governor.empty())
      return add("cpufreq", Verdict::kOk, "no frequency scaling visible",
                 "clocks are fixed, or hidden by a hypervisor");
    if (governor == "performance")
      return add("cpufreq", Verdict::kOk, governor, "profiles hold at this clock");
    add("cpufreq", Verdict::kDegraded, "governor " + governor,
        "execution times change with the clock: a profile holds only while the clock does",
        "`cpupower frequency-set -g performance`, on a Jetson `jetson_clocks`, before `xauto "
        "profile`");
  }

  void opencl() {
    std::error_code error;
    std::size_t icds = 0;
    for (const auto& entry : fs::directory_iterator(root_ + "/etc/OpenCL/vendors", error))
      icds += entry.path().extension() == ".icd" ? 1 : 0;
    if (icds > 0)
      add("opencl", Verdict::kOk, std::to_string(icds) + " driver(s)", "OpenCL XNodes run, gated");
    else
      add("opencl", Verdict::kMissing, "no driver in /etc/OpenCL/vendors",
          "the pedestrians example needs one",
          "`apt-get install pocl-opencl-icd` runs OpenCL on the CPU");
  }

  const std::string root_;
  const Permitted& limits_;
  const std::vector<Device>& devices_;
  std::vector<Finding> findings_;
};

}  // namespace

Permitted Permitted::of_this_process() {
  Permitted limits;
  limits.root = geteuid() == 0;
  utsname name{};
  uname(&name);
  limits.kernel_release = name.release;
  limits.cores = static_cast<int>(rt::allowed_cores().size());
  limits.highest_fifo = rt::highest_fifo();
  limits.may_use_bpf = kernel::may_use_bpf();
  limits.has_bpf = kernel::has_bpf();
  rlimit limit{};
  getrlimit(RLIMIT_RTPRIO, &limit);
  limits.rtprio_limit = limit.rlim_cur;
  getrlimit(RLIMIT_MEMLOCK, &limit);
  limits.memlock_bytes = limit.rlim_cur == RLIM_INFINITY ? ~0ull : limit.rlim_cur;
  return limits;
}

bool module_is_loaded(const std::string& root) {
  std::ifstream modules(root + "/proc/modules");
  for (std::string line; std::getline(modules, line);)
    if (line.rfind("xauto ", 0) == 0) return true;
  return false;
}

std::vector<Finding> probe(const std::string& root, const Permitted& limits,
                           const std::vector<Device>& devices) {
  return Probe(root, limits, devices).run();
}

}  // namespace xauto::kernel
