// SPDX-License-Identifier: Apache-2.0
// The part that needs no libbpf: whether sched_ext can be used, and in which mode.
#include "kernel/scx_scheduler.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <unistd.h>

#include "base/first_line.h"
#include "base/unique_fd.h"

namespace xauto::kernel {
namespace {

/// One for the machine, gone with the next boot.
constexpr const char* kDump = "/run/xauto/sched_ext.dump";

std::string cache_of(const std::string& cpu, int index) {
  return cpu + "/cache/index" + std::to_string(index);
}

}  // namespace

std::string scx_refusal(const std::string& root) {
  std::error_code error;
  const std::string scx = root + "/sys/kernel/sched_ext";
  if (!std::filesystem::exists(scx, error))
    return "this kernel has no sched_ext (6.12 and later have it with CONFIG_SCHED_CLASS_EXT)";
  if (first_line(root + "/sys/kernel/realtime") == "1")
    return "a PREEMPT_RT kernel refuses sched_ext";
  const std::string state = first_line(scx + "/state");
  if (state != "disabled" && !state.empty()) {
    const std::string who = first_line(scx + "/root/ops");
    return "another sched_ext scheduler is loaded" + (who.empty() ? "" : ": '" + who + "'");
  }
  if (!std::filesystem::exists(root + "/sys/kernel/btf/vmlinux", error))
    return "this kernel has no BTF (/sys/kernel/btf/vmlinux; CONFIG_DEBUG_INFO_BTF)";
  return {};
}

std::vector<int> parse_cpu_list(const std::string& text) {
  std::vector<int> cpus;
  const char* at = text.c_str();
  while (*at != '\0') {
    char* end = nullptr;
    const long first = std::strtol(at, &end, 10);
    if (end == at || first < 0 || first >= XAUTO_BPF_MAX_CPUS) break;
    long last = first;
    at = end;
    if (*at == '-') {
      last = std::strtol(at + 1, &end, 10);
      if (end == at + 1 || last < first || last >= XAUTO_BPF_MAX_CPUS) break;
      at = end;
    }
    for (long cpu = first; cpu <= last; ++cpu) cpus.push_back(static_cast<int>(cpu));
    if (*at != ',') break;
    ++at;
  }
  return cpus;
}

ScxChoice choose_scx_mode(const std::string& root, const ScxOptions& options) {
  if (options.mode == ScxMode::kFull) return {false, "full mode, as asked"};
  if (options.mode == ScxMode::kPartial) return {true, "partial mode, as asked"};
  const std::vector<int> isolated =
      parse_cpu_list(first_line(root + "/sys/devices/system/cpu/isolated"));
  for (const int cpu : options.cpus)
    if (std::find(isolated.begin(), isolated.end(), cpu) == isolated.end())
      return {false, "full mode: CPU " + std::to_string(cpu) +
                         " is not isolated, and the kernel ranks SCHED_EXT below ordinary threads"};
  if (options.cpus.empty()) return {false, "full mode: no CPU was named"};
  return {true, "partial mode: all CPUs of the policy are isolated"};
}

std::vector<std::uint8_t> scx_clusters(const std::string& root, std::size_t cpus) {
  std::vector<std::uint8_t> clusters(cpus);
  for (std::size_t cpu = 0; cpu < cpus; ++cpu) {
    const std::string folder = root + "/sys/devices/system/cpu/cpu" + std::to_string(cpu);
    std::string level, highest, list;
    for (int i = 0; !(level = first_line(cache_of(folder, i) + "/level")).empty(); ++i)
      if (level >= highest) {
        highest = level;
        list = first_line(cache_of(folder, i) + "/shared_cpu_list");
      }
    // A kernel that knows no caches knows packages. A CPU that is away has neither.
    if (list.empty()) list = first_line(folder + "/topology/package_cpus_list");
    const std::vector<int> near = parse_cpu_list(list);
    clusters[cpu] = static_cast<std::uint8_t>(near.empty() ? cpu : near.front());
  }
  return clusters;
}

Status keep_scx_dump(const std::string& root, const std::string& run, const std::string& why,
                     const std::string& dump) {
  std::error_code error;
  const std::string path = root + kDump;
  std::filesystem::create_directories(std::filesystem::path(path).parent_path(), error);
  // Names of all users' threads are in it.
  const UniqueFd file(
      open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600));
  const std::string text = "run " + run + ": " + why + "\n" + dump;
  if (file.get() < 0 || write(file.get(), text.data(), text.size()) < 0)
    return fail(ErrorCode::kIo, path + ": " + strerror(errno));
  return {};
}

std::optional<ScxDump> kept_scx_dump(const std::string& root, const std::string& run) {
  const std::string path = root + kDump;
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return std::nullopt;
  ScxDump kept{kDump, first_line(path)};
  if (!run.empty() && kept.about.rfind("run " + run + ":", 0) != 0) return std::nullopt;
  return kept;
}

bool scx_asks_restart(const xauto_bpf_sched& sched) {
  constexpr std::uint64_t kActRestart = std::uint64_t{1} << 48;  // SCX_ECODE_ACT_RESTART
  return scx_exit_of(sched).has_value() && (sched.exit_code & kActRestart) != 0;
}

std::optional<std::string> scx_exit_of(const xauto_bpf_sched& sched) {
  auto& kind = const_cast<__u64&>(sched.exit_kind);
  if (std::atomic_ref(kind).load(std::memory_order_acquire) == 0) return std::nullopt;
  std::string text(sched.exit_reason, strnlen(sched.exit_reason, sizeof sched.exit_reason));
  const std::string message(sched.exit_msg, strnlen(sched.exit_msg, sizeof sched.exit_msg));
  if (!message.empty()) text += " (" + message + ")";
  return text.empty() ? "ended without a reason" : text;
}

}  // namespace xauto::kernel
