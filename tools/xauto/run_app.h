// SPDX-License-Identifier: Apache-2.0
// One run of an app under one policy, from files and flags to numbers and bars: what `xauto run`
// and `xauto compare` share.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "cli/cli.h"
#include "launch/supervisor.h"
#include "model/deployment.h"
#include "model/emulation_script.h"
#include "model/tables.h"
#include "session/run_report.h"
#include "session/session.h"
#include "solver/simulate.h"
#include "story/story.h"

#include "xauto/emulation.h"

namespace xauto::cli {

/// Set by SIGINT, SIGTERM and SIGHUP while a `StopOnSignal` lives: the run drains, its answer is still
/// written. A second signal, half a second later or more, ends the tool at once (and the kernel its
/// children).
class StopOnSignal {
 public:
  StopOnSignal();
  ~StopOnSignal();
  [[nodiscard]] const std::atomic<bool>* flag() const;
};

/// Flags of every verb that starts an app.
/// What is executed for the words after --: `xauto-standin` is the one beside this program.
[[nodiscard]] std::vector<std::string> app_command(std::vector<std::string> command);

struct RunFlags {
  std::string app_path, platform, input, cpu_sched = "fifo", record_path;
  bool record_outputs = false;
  std::uint64_t activations = 200, seed = 1;
  double seconds = 0;  ///< 0: `activations` counts
  double input_rate = 1, input_max_gap_s = 0;
  std::int64_t period_us = 0, cpu_budget_pct = 0;
  bool lockstep = false, phases = false, isolate = false, emulator_modules = false;
  EmulationOptions emulation;
  std::string script_path;  ///< emulation.json
  std::string system;       ///< socket of the machine's coordinators, or "off"; see join_machine
  int restarts = 0;
  std::string deployment_path;
  std::vector<std::string> overload;
  std::vector<std::string> fail_on;  ///< of `run`: see gate.h
  double trace_keep_s = 30;
  std::vector<std::string> command;
  std::string part, meet;  ///< of `run`: see parts.h; empty: the whole app is here
  double meet_limit_s = 60;

  void declare(Verb verb);
  /// Loads what the flags name; decides between emulated and real XPUs, and says so on stderr.
  /// `policy_path`: whose platform it is where none is given; empty: `small`.
  [[nodiscard]] Status prepare(const std::string& policy_path = {});
  [[nodiscard]] Status prepare_deployment();
  [[nodiscard]] Status prepare_script();

  AppSpec app;
  Platform spec;
  EmulationScript script;               ///< without steps: there is none
  Deployment deployment;                ///< the file's, with what other flags say
  std::vector<Presence> presence;       ///< [XPU]
  [[nodiscard]] bool emulates() const;  ///< some of them
  /// Nobody of ours does, and nobody sees who preempts whom there: real CPUs.
  [[nodiscard]] bool kernel_schedules(std::size_t xpu) const;
};

/// Nearest-rank quantiles of the releases that were completed (see runtime/distribution.h).
/// Without a release no number is a measurement: look at `count` first.
struct Latency {
  std::int64_t p50_us = 0, p99_us = 0, max_us = 0, mean_us = 0;
  std::size_t count = 0;
  std::int64_t p10_us = 0, p90_us = 0;
};
[[nodiscard]] Latency summarise(const runtime::Distribution& latencies_us);

struct PolicyRun {
  std::string id;    ///< "ros2", "heft", "xauto"; of a policy file its name
  std::string name;  ///< for people
  runtime::Scheduling scheduling = runtime::Scheduling::kXAuto;
  std::optional<PriorityPlan> policy;  ///< none for ros2; else assignment_of() what was taken
  std::optional<Policy> keys;          ///< what was taken, unless it has priorities
  void take(Policy made);
  /// Several policies, of which each release gets one; then `policy` is that of the first scenario.
  std::optional<Tables> tables;
  /// It goes by keys that are not certified: it is held against nothing, and says so.
  [[nodiscard]] bool uncertified() const { return keys && !keys->certified; }
  /// Of a part: CLOCK_TAI, which all parts have, less CLOCK_MONOTONIC; 0: it is none.
  std::int64_t tai_offset_ns = 0;
  std::string untrue;  ///< why `xauto check` refuses the policy here; empty: not known
  // Filled in by `execute`.
  runtime::RunReport report;
  launch::Outcome outcome;
  Latency latency;
  Result<xauto::story::Story> story;  ///< error: the run left no trace
};

/// The modules of the run, as events name them.
[[nodiscard]] std::vector<story::ModuleInfo> modules_of(const runtime::RunReport& report);

/// Runs it. `dump` gets what surrounds a deadline miss or a hang, while the run goes on.
using Dump = std::function<void(const launch::Incident&)>;
[[nodiscard]] Status execute(const RunFlags& flags, PolicyRun& run, const std::atomic<bool>* stop,
                             Dump dump = {});

/// The rows of a picture. Under the ROS 2 model the CPUs are one pool: one row, named so, in the
/// place of its first core.
struct Rows {
  std::vector<std::string> names;
  std::vector<int> of;  ///< XPU -> row
};
[[nodiscard]] Rows rows_of(const Platform& platform, runtime::Scheduling scheduling);

}  // namespace xauto::cli
