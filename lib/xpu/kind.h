// SPDX-License-Identifier: Apache-2.0
// What an XPU is, in one table: a row per kind, a file per backend. It alone says by which nodes an
// XPU is found, who keeps its priorities, and how its work is suspended. A new kind is one row in
// kind.cc and one backend file; so is another driver of a kind, and another way to suspend its work
// is a line of its row. Only cores are asked for by name elsewhere: they are counted, and threads
// are pinned to them.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "kernel/probe.h"
#include "model/platform.h"
#include "xpu/backend.h"

namespace xauto::xpu {

/// A way to suspend work on a kind of XPU, or to have Linux do it.
struct Way {
  std::string name;  ///< "xauto.ko"; empty: it needs no word
  /// Who keeps the priorities on a preemptive instance.
  Discipline discipline = Discipline::kPreemptive;
  Result<std::unique_ptr<Backend>> (*backend)(const XpuId&) = nullptr;
  /// Whether this machine has it; `root` stands for / in tests. None: where the XPU is.
  bool (*there)(const std::string& root) = nullptr;
  /// Of Discipline::kLevels: how many levels the hardware gives this process; 0: no order is kept. None: the way is
  /// taken where the platform states levels, since the app's own queues have them.
  int (*levels)() = nullptr;
  /// Such levels order the work of one process alone.
  bool one_process = false;
  /// How many of them this machine has, for who writes a platform file; 0: nobody says. It may take a second.
  int (*ask)() = nullptr;
  bool watched = false;  ///< libxauto_watch.so must be in the app's process
  /// What it cannot promise, for `xauto doctor` and the report: "suspended by ...: ...".
  std::string caveat = {};
};

struct Kind {
  std::string type;  ///< "gpu"; empty: every type without a row of its own
  /// Device nodes, by instance; a machine with any of them has such an XPU. None: it needs no
  /// driver, so it is always there (CPUs are counted).
  std::vector<std::string> nodes = {};
  bool node_each = false;  ///< a node per instance; else any number may be behind one
  /// In the order of choice; where this machine has none of them an instance is gated.
  std::vector<Way> ways = {};
  /// What suspends its work in a run by keys where SCHED_FIFO keeps the order: it knows no keys.
  Result<std::unique_ptr<Backend>> (*backend_by_keys)(const XpuId&) = nullptr;
  /// Of an instance as `xauto doctor --platform-out` writes it: costs of a preemption.
  std::int64_t preempt_us = 0, timeslice_us = 0;
  bool measured = true;     ///< preempt_us
  std::string what = {};    ///< for people, if it is there: "a Jetson's GPU"
  std::string driver = {};  ///< ... if it is not: whose node is missing: "nvgpu"
  std::string advice = {};  ///< ... and where it would be
};

/// The table: cpu, gpu, dla, vic, pva, and what an app brings itself.
[[nodiscard]] const std::vector<Kind>& kinds();

/// How many levels a platform file of this machine states; 0: none, its work is suspended, or gated.
[[nodiscard]] int levels_to_state(const Kind& kind);

/// Those that need a driver, for `xauto doctor`.
[[nodiscard]] std::vector<kernel::Device> devices(const std::vector<Kind>& table = kinds());

/// The row of `type`; of several drivers' rows the first whose node is here.
[[nodiscard]] const Kind& kind_of(const std::string& type,
                                  const std::vector<Kind>& table = kinds());

/// How work on a preemptive XPU of this machine is suspended; null: it cannot be. `levels`: the platform states some.
[[nodiscard]] const Way* way_of(const Kind& kind, const std::string& root = {},
                                bool levels = false);

/// Of an XPU of a run: what is not preemptive is gated, what is emulated is preempted by the
/// emulator, else the row decides. `by_keys`: Session::cpu_by_keys.
[[nodiscard]] Discipline discipline_of(const Xpu& xpu, bool emulated, bool by_keys = false,
                                       const std::vector<Kind>& table = kinds());

/// On how many levels jobs are started on such an XPU, of those that the platform says and the
/// hardware has. 0: it is not by levels that it preempts.
[[nodiscard]] int levels_of(const Xpu& xpu, bool emulated,
                            const std::vector<Kind>& table = kinds());

/// Whether the order on it holds among the jobs of one process alone.
[[nodiscard]] bool orders_one_process(const Xpu& xpu, bool emulated,
                                      const std::vector<Kind>& table = kinds());

/// What cannot be promised of it in such a run, though it is preemptive: "suspended by each process
/// itself: ...", or "".
[[nodiscard]] std::string caveat_of(const Xpu& xpu, bool emulated,
                                    const std::vector<Kind>& table = kinds());

/// Whether an app on such an XPU needs libxauto_watch.so in its process.
[[nodiscard]] bool is_watched(const Xpu& xpu, bool emulated,
                              const std::vector<Kind>& table = kinds());

/// Whether kmod/emu/ has it in a run with the emulator modules: a driver's XPU, whose work is
/// suspended. All others xauto-emud emulates there, too.
[[nodiscard]] bool is_by_modules(const Xpu& xpu, const std::vector<Kind>& table = kinds());

/// How one worker's work on an XPU is suspended in a run.
struct BackendRequest {
  const Xpu& xpu;
  XpuId id;
  bool emulated = false;
  bool emulator_modules = false;  ///< what is_by_modules() is emulated by kmod/emu/
  bool scheduled = true;          ///< false: nobody will ever suspend anything
  bool by_keys = false;           ///< Session::cpu_by_keys
};
[[nodiscard]] Result<std::unique_ptr<Backend>> make_backend(
    const BackendRequest& request, const std::vector<Kind>& table = kinds());

}  // namespace xauto::xpu
