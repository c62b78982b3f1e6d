// SPDX-License-Identifier: Apache-2.0
// Finding the run, asking those who know, attaching the tracer, naming things.
#pragma once

#include <atomic>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "kernel/run_maps.h"
#include "kernel/tracer.h"
#include "model/json_value.h"
#include "model/xpu_status.h"
#include "processes/board.h"

#include "xauto/counts.h"

namespace xauto::cli {

/// A run as its tool introduces it, whoever looks: no root, no BPF.
struct Watched {
  std::string run, app, platform, scheduling;
  unsigned uid = 0;  ///< whose it is
  std::string host;  ///< whose part of a run it is; empty: it has no parts
  std::shared_ptr<const runtime::Board> board;
};
/// Names of runs of this network namespace, or what anybody calls one.
[[nodiscard]] std::vector<std::string> running();
/// Those of `runs` that introduce themselves to this user.
[[nodiscard]] std::vector<Watched> introduced(const std::vector<std::string>& runs);
/// The run named `run`, or with an empty name this user's only one, waited for at most `wait_s`. If this user
/// has none, the only one of others: root is answered by them, too.
[[nodiscard]] Result<Watched> watch(const std::string& run, int wait_s,
                                    const std::atomic<bool>& stop);
[[nodiscard]] Result<Watched> find_run(const std::string& name, int wait_s);
/// Asks the run's tool to change something (launch/desk.h). Returns what was before.
[[nodiscard]] Result<Json> ask_desk(const Watched& run, const Json& request);
/// What a run's coordinators say of their workers.
struct Coordinated {
  unsigned uid = 0;  ///< whose it is
  std::vector<XpuStatus> xpus;
};
/// By the run's name, all runs' or of the one that is named; one that is just ending is left out.
[[nodiscard]] std::map<std::string, Coordinated> ask_coordinators(const std::string& run = {});

/// Of a run by keys: each chain's last and longest reaction of the whole run beside what is claimed
/// of it, and whether that holds so far. Empty of other runs.
[[nodiscard]] std::string claims_text(const Counts& counts);

struct Live {
  kernel::RunMaps maps;
  std::vector<kernel::XNodeName> names;
  kernel::Tracer tracer;
  /// "fcd.infer"; "-" for none.
  [[nodiscard]] std::string xnode_of(std::uint64_t job) const;
};

/// A run that is there.
[[nodiscard]] Result<Live> observe(const std::string& run, const kernel::TracerOptions& options);

/// One XNode's numbers over a time: the difference of two histograms.
struct XNodeNumbers {
  std::uint64_t jobs = 0, wakeups = 0, preemptions = 0, migrations = 0;
  /// -1: there was none.
  std::int64_t latency_p50_us = -1, latency_p99_us = -1, latency_max_us = -1;
  std::int64_t run_p50_us = -1, run_p99_us = -1, wait_p99_us = -1;
  double run_ms = 0, wait_ms = 0;
};
[[nodiscard]] XNodeNumbers numbers_of(const xauto_bpf_hist& now, const xauto_bpf_hist& before);

/// Null, and "-", where it is -1: no number that nobody measured.
[[nodiscard]] Json measured(std::int64_t us);
[[nodiscard]] std::string measured_text(std::int64_t us);

}  // namespace xauto::cli
