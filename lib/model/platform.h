// SPDX-License-Identifier: Apache-2.0
// Platform: the XPU instances that a policy may use. File format: docs/formats.md, platform.json.
// Value type: no invariant is held by the struct itself; `validate` says whether it makes sense,
// and every reader calls it, so code behind the readers may rely on it.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

namespace xauto {

/// One XPU instance: a CPU core, a GPU, a DLA, or any other processor that runs one job at a time.
struct Xpu {
  std::string id;    ///< unique, "gpu0"
  std::string type;  ///< "cpu", "gpu", "dla", or any other word; XNodes name types, not instances
  bool preemptive = true;
  /// Cost of suspending a running job and starting another, paid on the XPU by the job that starts.
  std::int64_t preempt_us = 0;
  /// Round-robin time slice of the hardware when nobody schedules it; 0: ideal processor sharing.
  std::int64_t timeslice_us = 0;
  /// Cost of one hardware context switch between time slices; -1 (the default): as preempt_us.
  std::int64_t switch_us = -1;
  /// Nobody suspends its work, but its hardware preempts by as many priority levels: one job runs,
  /// and each of at most levels - 1 others was preempted by the next. A job that is more urgent than
  /// all of them then waits until the one that runs has ended. 0: there is no such limit.
  int levels = 0;
  /// preempt_us was measured on this kind of machine. If not, whoever claims by it says so, and a run compares it with
  /// what suspending takes.
  bool preempt_measured = true;
  int host = 0;  ///< index into Platform::hosts, if there are any
  /// Emulated or real, whatever this machine has; unset: emulated where this machine lacks it, see
  /// xpu/presence.h.
  std::optional<bool> emulated = {};

  [[nodiscard]] std::int64_t effective_switch_us() const {
    return switch_us >= 0 ? switch_us : preempt_us;
  }
  bool operator==(const Xpu&) const = default;
};

/// One of several computers that an app is spread over. Keys on its XPUs are read on its own clock.
struct Host {
  std::string name;
  std::int64_t rate_ppm = 0;  ///< how much faster or slower its clock may run than true time
  bool operator==(const Host&) const = default;
};

/// How messages get from one host to another: after base_us, and what the link's messages take at mbit_s, all of them
/// together (docs/keys.md, "Hosts").
struct HostLink {
  int from = -1, to = -1;  ///< indices into Platform::hosts
  std::int64_t base_us = 0;
  std::int64_t mbit_s = 0;  ///< megabits a second; 0: the size of a message costs nothing
  bool operator==(const HostLink&) const = default;
};

struct Platform {
  std::string name;
  std::vector<Xpu> xpus;
  std::vector<Host> hosts = {};  ///< empty: all XPUs are of one machine
  std::vector<HostLink> links = {};

  /// Index into `xpus`, or -1.
  [[nodiscard]] int find(std::string_view id) const;
  /// Indices into `xpus` of the instances of `type`, ascending.
  [[nodiscard]] std::vector<int> instances_of(std::string_view type) const;
  [[nodiscard]] int find_host(std::string_view host) const;    ///< index into `hosts`, or -1
  [[nodiscard]] const HostLink* link(int from, int to) const;  ///< null: there is none
  /// Distinct types in order of first appearance.
  [[nodiscard]] std::vector<std::string> types() const;
  bool operator==(const Platform&) const = default;

  /// The paper's configurations: "small" = 4 cpu + 1 gpu + 1 dla, "large" = 8 cpu + 1 gpu + 2 dla.
  /// GPU: preempt 275 us, DLA: 132 us, both with a time slice of 1 ms. "core-ultra", an Intel Core
  /// Ultra 7 155H: its 6 P-cores, its GPU with the three priority levels of i915 with GuC submission,
  /// and its NPU, which preempts nothing. The boards of NVIDIA's data sheets: "orin" (Jetson AGX Orin 64GB),
  /// "orin-nx" (16GB), "orin-nano" (8GB), "xavier" (AGX Xavier), "thor" (T5000); VICs and PVAs preempt nothing.
  /// Elsewhere than on the paper's Orin its costs stand in for those that nobody has measured.
  [[nodiscard]] static Result<Platform> builtin(std::string_view name);
};

/// What a `--platform` may be, for people.
inline constexpr const char* kPlatformNames =
    "small, large, orin, orin-nx, orin-nano, xavier, thor, core-ultra, or a platform.json";

/// Limits of a platform file.
inline constexpr std::size_t kMaxXpus = 256;
/// The co-run class in which all types are loaded at once that can be (XNodeProfile::beside). No name of a type.
inline constexpr const char* kEveryType = "*";
inline constexpr int kMaxLevels = 1024;
inline constexpr std::size_t kMaxHosts = 16;
inline constexpr std::int64_t kMaxHostPpm =
    10'000;  ///< a servo that corrects a clock stays below 500
inline constexpr std::int64_t kMaxMbitS = 1'000'000;
inline constexpr std::int64_t kMaxTimeUs =
    1'000'000'000'000;  ///< about 11 days; sums stay far from overflow

/// That its preempt_us is nobody's measurement, for people; empty: it is, or nothing is preempted there.
[[nodiscard]] std::string unmeasured(const Xpu& xpu);

/// ids unique and non-empty, types non-empty, times in [0, kMaxTimeUs], levels 0 or in 2..kMaxLevels
/// and only where it is preemptive, 1..kMaxXpus instances. Hosts: at least two or none, each with an XPU, names unique;
/// links between two of them, one for each way.
[[nodiscard]] Status validate(const Platform& platform);

/// Whether an XPU of the platform is there in a run.
enum class Presence : std::uint8_t {
  kReal,
  kEmulated,
  kEither,  ///< only while profiling: both are there, the handle that `init` returns decides
  kAbsent,  ///< neither here nor to be emulated: no XNode can run there
};

/// Who keeps the priorities of an XPU's jobs.
enum class Discipline : std::uint8_t {
  kPreemptive,  ///< the coordinator: the most urgent job runs, the others are suspended
  kGate,        ///< the coordinator: one job at a time, to its end
  kKernel,      ///< Linux: every job runs, its thread has the job's priority
  /// The coordinator and the hardware: the most urgent job is started on a level above all that have
  /// started, as long as there is one; the hardware preempts by levels
  kLevels,
};
[[nodiscard]] const char* to_string(Discipline discipline);

}  // namespace xauto
