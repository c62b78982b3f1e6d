// SPDX-License-Identifier: Apache-2.0
// The parent of a run: starts the emulator, the coordinators and the app, watches over them, and
// leaves nothing behind. Whatever dies, the rest is ended or goes on as docs/runtime.md says:
//   coordinator  started again; the next one goes on where it was (its memory outlives it). If
//                that fails its XPU's jobs go on unscheduled, and the result says so. One that
//                hangs is killed first (pulse.h)
//   emulator     likewise; if that fails its XPUs are gone and the app is stopped
//   app          everything is stopped; a module process of it: its modules' activations are
//                dropped, the rest runs, and it is started again if the deployment says so
//   this process everything is killed by the kernel (PR_SET_PDEATHSIG)
// Shared memory, sessions and answers are memfds, sockets are abstract: the file system is not
// used.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/process.h"
#include "launch/daemons.h"
#include "launch/meeting.h"
#include "launch/system_lease.h"
#include "model/emulation_script.h"
#include "processes/board.h"
#include "session/session.h"
#include "trace/trace.h"

namespace xauto::launch {

/// Of the tool: answers any packet with one line of JSON about the run and the board's memfd, to be
/// read (`Board::observe`).
inline constexpr const char* kLiveName = "live";

/// Of the tool: where parameters and the scenario are changed (desk.h).
inline constexpr const char* kDeskName = "desk";

/// A deadline miss or a hang, and what was traced around it.
struct Incident {
  bool hang = false;
  trace::Event event{};  ///< XAUTO_EV_MISS or XAUTO_EV_HANG
  trace::Recording trace;
  std::vector<std::string> modules;  ///< names, as events number them; those of other hosts, too
};

struct Supervision {
  runtime::Session session;          ///< addresses and descriptors are filled in
  std::vector<std::string> command;  ///< the app and its arguments
  EmulationScript emulation;         ///< of the emulated XPUs; without steps: none
  std::string bin;  ///< where xauto-coordinator and xauto-emud are; empty: beside us
  const std::atomic<bool>* stop = nullptr;  ///< set by Ctrl-C: drain; see stop_count for more
  /// About five times a second. `board` is null until the app has made it.
  std::function<void(double elapsed_s, const runtime::Board* board)> on_tick;
  std::optional<LeaseRequest> joins;  ///< the machine's coordinators; none: the run brings its own
  double trace_keep_s = 0;            ///< the trace keeps the newest events of so long; 0: no trace
  /// Of the first few of each kind, shortly after it happened. Called on the caller's thread.
  std::function<void(const Incident&)> on_incident;
  Meeting* meeting =
      nullptr;  ///< of one host's part (session.host), to its end; null: there are no parts
  std::int64_t time_limit_s = 0;    ///< 0: none; then the app is stopped
  std::int64_t cpu_budget_pct = 0;  ///< sched_ext: of a job's WCET; 0: no budgets
};

struct Outcome {
  std::string answer;  ///< of the app; empty if it died first
  Exit app;
  trace::Recording trace;
  std::vector<std::string> notes;  ///< what died or was done differently, for people
  std::string real_cpus;           ///< cpu_keeper()
  bool emulator_died = false;
  std::uint64_t deaths = 0;  ///< of daemons and modules' processes, before their time
  std::vector<std::string>
      gone;  ///< modules' processes that died and were not started again, a line each
  std::vector<std::string> dead_daemons;  ///< which of these were daemons, a line each
  /// Of one CPU, by all coordinators together: from the first release to the last look, without start-up and end.
  /// None: the run was too short to look twice.
  std::optional<double> coordinators_share;
  double wall_s = 0;  ///< of the app
};

/// Errors: something could not be started, or the app answered with an error (that very error).
[[nodiscard]] Result<Outcome> supervise(Supervision request);

}  // namespace xauto::launch
