// SPDX-License-Identifier: Apache-2.0
// The xauto tool's side of CPU scheduling: makes the run's BPF maps, fills the table from the
// policy, starts xauto-cpusched, and says what it settled for and why: sched_ext, else SCHED_FIFO.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "kernel/run_maps.h"
#include "kernel/scx_process.h"
#include "model/app.h"
#include "model/platform.h"
#include "model/priority_plan.h"
#include "session/session.h"
#include "xpu/policy_view.h"

namespace xauto::launch {

/// The map of a run's policy, for as long as this lives: in the folder of the run's other maps, or in one of its own.
struct DeployedPolicy {
  std::optional<kernel::RunFolder> folder;
  xpu::PolicyView map;
};
/// Of a session that runs, whatever its XPUs are. `maps`: those of the run that are this run's own; null: it has none.
[[nodiscard]] Result<DeployedPolicy> deploy_policy(const runtime::Session& session,
                                                   const std::string& run,
                                                   const kernel::RunMaps* maps);

struct CpuRunRequest {
  std::string run;  ///< name for the maps
  std::string bin;  ///< folder of xauto-cpusched
  const AppSpec& app;
  const Platform& platform;
  std::vector<const PriorityPlan*> tables;  ///< a row for each task; empty: nobody schedules
  bool keys = false;                        ///< each job tells its own: a policy of keys
  std::vector<bool> real;                   ///< [XPU]; of the CPUs, those that the kernel schedules
  bool want_ext = false;
  /// A job's budget is its WCET times this; 0: no budgets. Only sched_ext enforces it.
  std::int64_t budget_pct = 0;
};

/// Goes with the run: unpins the maps, ends the scheduler.
struct CpuRun {
  std::optional<kernel::RunMaps> maps;  ///< none: nobody can observe this run
  std::optional<kernel::ScxProcess> scheduler;
  bool partial = false;
  std::string note;  ///< one line for people, if something was done differently than asked
  std::string info;  ///< one line: how it is scheduled
};

/// Never fails: what is missing is left out, and said if it was asked for.
[[nodiscard]] CpuRun prepare_cpus(const CpuRunRequest& request);

/// Sets Session::cpu_by_keys: whether coordinators, with SCHED_FIFO, keep a policy of keys on real
/// CPUs. They need not where sched_ext does, and cannot without the right. After it is known which
/// it is.
void decide_cpu_by_keys(runtime::Session& session);

/// Who keeps the policy's order on real CPUs, for people; empty if there is none to keep. After
/// decide_cpu_by_keys.
[[nodiscard]] std::string cpu_keeper(const runtime::Session& session);

/// Rows for the table. `cores`: the kernel's numbers of the platform's CPUs, in order.
[[nodiscard]] std::vector<kernel::TableRow> table_rows(const CpuRunRequest& request,
                                                       const std::vector<int>& cores);

}  // namespace xauto::launch
