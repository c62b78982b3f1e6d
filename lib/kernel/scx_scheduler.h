// SPDX-License-Identifier: Apache-2.0
// The sched_ext scheduler (bpf/xauto_scx.bpf.c) loaded by this process, for as long as the object
// lives: when it, or the process, goes, the kernel goes back to its own scheduler by itself.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "kernel/run_maps.h"

namespace xauto::kernel {

enum class ScxMode : std::uint8_t { kAuto, kFull, kPartial };

struct ScxOptions {
  ScxMode mode = ScxMode::kAuto;
  std::vector<int> cpus;  ///< that the policy gives to XNodes; decides the mode
  std::uint32_t timeout_ms = 10'000;
  std::uint32_t floor_permille = 50;
  std::uint32_t floor_burst_us = 5'000;
  std::uint32_t xnode_slice_us = 4'000;
  std::uint32_t age_ms = 1'000;
};

/// Why sched_ext cannot be used here, one line; empty if nothing speaks against it. `root`: "" for
/// this machine, or a folder that stands for / in tests.
[[nodiscard]] std::string scx_refusal(const std::string& root);

struct ScxChoice {
  bool partial = false;
  std::string why;  ///< for people
};
/// Full mode, unless every CPU is isolated: then ordinary threads are not there to be ranked above
/// ours, and need not be scheduled by us.
[[nodiscard]] ScxChoice choose_scx_mode(const std::string& root, const ScxOptions& options);

/// "0-2,5" -> 0 1 2 5; nonsense ends the list.
[[nodiscard]] std::vector<int> parse_cpu_list(const std::string& text);

/// [CPU]: one CPU of those that it shares its last cache with, the same for all of them; `cpus` at most.
[[nodiscard]] std::vector<std::uint8_t> scx_clusters(const std::string& root, std::size_t cpus);

class ScxScheduler {
 public:
  /// Loads and attaches; returns when the kernel says that it is enabled. Begins again if the kernel
  /// asks for it: a CPU that comes or goes meanwhile.
  [[nodiscard]] static Result<ScxScheduler> load(const RunMaps& maps, const ScxOptions& options);
  ScxScheduler(ScxScheduler&&) noexcept;
  ~ScxScheduler();

  [[nodiscard]] const ScxChoice& choice() const { return choice_; }
  /// The kernel's, of the error that ended it; empty if none did.
  [[nodiscard]] std::string dump() const;

 private:
  ScxScheduler();
  [[nodiscard]] static Result<ScxScheduler> load_once(const RunMaps& maps,
                                                      const ScxOptions& options);
  struct Loaded;
  std::unique_ptr<Loaded> loaded_;
  ScxChoice choice_;
};

/// Whether it ended because of something that a new one does not have: the kernel asks for a restart.
[[nodiscard]] bool scx_asks_restart(const xauto_bpf_sched& sched);

/// Keeps the dump of an error, in place of the one before it: of what went wrong the last is left.
/// `run`: whose scheduler it was.
[[nodiscard]] Status keep_scx_dump(const std::string& root, const std::string& run,
                                   const std::string& why, const std::string& dump);
struct ScxDump {
  std::string path;
  std::string about;  ///< "run 1234-0: runnable task stall (...)"; empty: it may not be read
};
/// The one that is kept; `run` not empty: if it is about that one.
[[nodiscard]] std::optional<ScxDump> kept_scx_dump(const std::string& root,
                                                   const std::string& run = {});

/// Why the scheduler ended, if it has: "runnable task stall (...)"; nullopt while it runs.
[[nodiscard]] std::optional<std::string> scx_exit_of(const xauto_bpf_sched& sched);

}  // namespace xauto::kernel
