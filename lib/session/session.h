// SPDX-License-Identifier: Apache-2.0
// What the `xauto` tool asks of an app that it starts (run_report.h: what the app answers). The
// request travels as JSON in an inherited memfd (environment XAUTO_SESSION = its number), the answer
// in another one, so nothing is left behind however either of them ends.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/deployment.h"
#include "model/platform.h"
#include "model/policy.h"
#include "model/priority_plan.h"
#include "model/tables.h"

namespace xauto::runtime {

enum class Mode : std::uint8_t {
  kDescribe,  ///< print the graph
  kProfile,   ///< time each XNode alone
  kRun,
  kLoad,  ///< run the XNodes of one XPU again and again, for a profile of others (profile/corun.h)
};

enum class Scheduling : std::uint8_t {
  kXAuto,      ///< the policy's assignment and priorities, coordinators decide
  kTimeshare,  ///< the policy's assignment, nobody schedules
  kRos2,       ///< each stage on its fastest XPU type, nobody schedules
};
[[nodiscard]] const char* to_string(Scheduling scheduling);
[[nodiscard]] std::optional<Scheduling> scheduling_from(const std::string& name);

/// How threads of CPU XNodes are scheduled when the CPUs are real.
enum class CpuSched : std::uint8_t { kFifo, kOther, kExt };

/// kProfile: what is timed, and how often.
struct ProfileRequest {
  std::uint64_t warmup = 3, repetitions = 30;
  std::int64_t margin_pct = 20;
  std::int64_t exec_limit_s = 30;   ///< one that takes longer ends it
  std::uint64_t stable_rounds = 0;  ///< further rounds of repetitions for wide spreads
  bool contended = false;           ///< also beside a load of each type of XPU (profile/corun.h)
  bool audit = false;               ///< how busy other XPUs are meanwhile (profile/audit.h)
  std::string
      machine_root;  ///< where the machine's /sys, /proc and /var are; empty: where they belong
};

/// kLoad: which XPU is kept busy.
struct LoadRequest {
  int xpu = -1;
  int fd = -1;             ///< memfd with the LoadWords
  std::vector<int> cores;  ///< where its threads may run
};

/// kRun: what is released, out of what, and for how long; and what of it is recorded.
struct ReleaseRequest {
  /// Releases of the slowest source, of the others as many as fit into that time; 0: until told to
  /// stop, or the input's end.
  std::uint64_t activations = 0;
  std::int64_t duration_us = 0;  ///< release for so long instead; 0: count
  bool lockstep = false;         ///< the next release comes when the last one has drained
  bool phases = false;     ///< clocks begin apart, as far off as stated (releases/clock_starts.h)
  std::uint64_t seed = 1;  ///< of `phases`
  std::int64_t period_us = 0;         ///< instead of the sources' own; 0: theirs
  std::string input;                  ///< recorded input; empty: the sources' own messages
  double input_rate = 1;              ///< replayed so much faster than it was recorded
  std::int64_t input_max_gap_us = 0;  ///< no longer between two of its releases; 0: as recorded
  std::string record;                 ///< record the sources' messages into this file; empty: don't
  bool record_outputs = false;        ///< ... and what modules publish
};

/// How real CPUs keep the policy: what whoever starts the run has decided, once.
struct CpuPlan {
  CpuSched sched = CpuSched::kFifo;
  std::string run;                ///< the run's BPF maps (kernel/run_maps.h); empty: none
  std::uint32_t first_xnode = 0;  ///< number of XNode 0 there: another run's maps have its own
  int scheduler_pid = 0;  ///< xauto-cpusched holds the sched_ext scheduler; 0: there is none
  bool partial = false;   ///< ... which schedules only threads that ask for SCHED_EXT
  /// They follow keys by SCHED_FIFO: the coordinator admits one job per core and has the others
  /// lowered. Of a policy of keys, where that is permitted and sched_ext does not do it.
  bool by_keys = false;
  /// ... and it is the machine's coordinators that give a core to a thread, and take it: the run is not trusted.
  bool regulated = false;
  /// Who has pinned the policy's map (kernel/policy_map.h), which a change of the table has to be told to; empty:
  /// nobody.
  std::string policy;
};

/// The app in several processes.
struct ProcessPlan {
  /// Modules by process, beside the hub; empty: all in one. See processes/plan.h.
  std::vector<std::vector<std::string>> modules;
  std::string hub;  ///< abstract socket
  int hub_fd = -1;  ///< the same, listening, inherited by the hub; -1: it makes it
  int process = 0;  ///< which of them this is (environment XAUTO_PROCESS); 0: the hub
};

/// One host's part of an app over several computers (lib/parts/).
struct HostPart {
  std::string name;       ///< of Platform::hosts; empty: all XPUs are here
  std::uint64_t run = 0;  ///< what the parts of this run have in common, and no other run has
  [[nodiscard]] bool there() const { return !name.empty(); }
};

struct Session {
  Mode mode = Mode::kRun;
  AppSpec app;  ///< kRun
  Platform platform;
  /// kRun with kXAuto, kTimeshare; set by take_policy or take_tables: assignment_of() of what was taken.
  PriorityPlan policy;
  std::optional<Policy>
      keys;  ///< what was taken, unless it has priorities; of tables that of the first
  /// Several policies, of which each release gets one (tables/table_switch.h); then `policy` is that of
  /// the first scenario's table. With kXAuto; set by take_tables.
  std::optional<Tables> tables;
  std::vector<PriorityPlan> by_table;  ///< [table]; empty: `policy` alone
  Scheduling scheduling = Scheduling::kXAuto;
  CpuPlan cpu;
  std::vector<Presence> presence;  ///< [XPU]; empty: all are real
  bool emulator_modules = false;   ///< emulated GPUs and DLAs are those of kmod/emu/
  /// XPU id -> where its coordinator is (coord/door.h); empty: none
  std::map<std::string, std::string> coordinators;
  std::string own_sockets;  ///< what the names of all abstract sockets of this run begin with
  ReleaseRequest releases;
  ProfileRequest profile;
  LoadRequest load;
  ProcessPlan parts;
  HostPart host;
  int answer_fd = -1;       ///< memfd for the Answer
  int trace_fd = -1;        ///< memfd for the trace; -1: none
  int board_fd = -1;        ///< memfd for the board (board.h); -1: nobody looks
  double trace_keep_s = 0;  ///< for so long the trace holds what happens (if memory allows)

  /// Of the other modes what names modules and topics, and parameters; of no app: none.
  Deployment deployment;

  void take_policy(Policy made);
  void take_tables(Tables all);
  [[nodiscard]] std::size_t num_tables() const { return std::max<std::size_t>(1, by_table.size()); }
  [[nodiscard]] const PriorityPlan& of_table(std::size_t table) const {
    return by_table.empty() ? policy : by_table[table];
  }
  /// Where there are `keys`.
  [[nodiscard]] const Policy& keys_of(std::size_t table) const {
    return tables ? tables->tables[table].keys : *keys;
  }
  /// Index into XNodeSpec::variants of what runs under `table`; -1: its own implementation.
  [[nodiscard]] int variant_of(std::size_t table, std::size_t xnode) const {
    return tables ? tables->tables[table].loss.variant_of(xnode) : -1;
  }
  /// An XNode as one table places it. Coordinators and the scheduler of real CPUs know it by this
  /// number, so each table has its own order and priorities there.
  [[nodiscard]] std::uint32_t task(std::size_t table, std::uint32_t xnode) const {
    return static_cast<std::uint32_t>(table * app.xnodes.size()) + xnode;
  }
  /// Order constraints of all tables on this XPU, between tasks.
  [[nodiscard]] std::vector<std::pair<std::uint32_t, std::uint32_t>> order_on(int xpu) const;

  /// Other runs use that XPU as well, under a coordinator of the machine.
  [[nodiscard]] bool shares(const std::string& xpu) const {
    const auto found = coordinators.find(xpu);
    return found != coordinators.end() && found->second.starts_with('/');
  }
  [[nodiscard]] bool shares() const {  ///< some XPU
    return std::any_of(coordinators.begin(), coordinators.end(),
                       [this](const auto& one) { return shares(one.first); });
  }
  [[nodiscard]] Presence presence_of(int xpu) const {
    return presence.empty() ? Presence::kReal : presence[static_cast<std::size_t>(xpu)];
  }
  /// Another host has that XPU.
  [[nodiscard]] bool elsewhere(std::size_t xpu) const {
    return host.there() &&
           platform.hosts[static_cast<std::size_t>(platform.xpus[xpu].host)].name != host.name;
  }
  [[nodiscard]] bool emulated(int xpu) const { return presence_of(xpu) == Presence::kEmulated; }
  [[nodiscard]] bool emulates() const {  ///< there is an emulator
    return std::any_of(presence.begin(), presence.end(), [](Presence p) {
      return p == Presence::kEmulated || p == Presence::kEither;
    });
  }
};
inline constexpr std::uint32_t kQueueDepth = 8, kKeep = 8;  ///< unless the deployment says more

inline constexpr const char* kSessionVariable = "XAUTO_SESSION";
inline constexpr const char* kProcessVariable = "XAUTO_PROCESS";
inline constexpr std::uint64_t kMaxActivations = 100'000'000;

/// kInvalid: a path is not UTF-8, and would not arrive as it is.
[[nodiscard]] Result<std::string> to_json(const Session& session);
[[nodiscard]] Result<Session> parse_session(const std::string& text);
/// Reads the memfd named by XAUTO_SESSION; nullopt if the variable is not set.
[[nodiscard]] Result<std::optional<Session>> inherited_session();

}  // namespace xauto::runtime
