// SPDX-License-Identifier: Apache-2.0
// The machine's XPUs and all apps that have joined xauto-system there: what each was admitted with, what it has had, and
// what is left. From the service's answers and its records (coord/record.h); nobody needs rights to another's run.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "coord/record.h"
#include "model/json_value.h"

namespace xauto::cli {

/// What xauto-system says; null: nobody listens there, or not to this user.
[[nodiscard]] Json ask_machine(const std::string& socket);

struct AppOnXpu {
  std::int64_t lease = 0, uid = -1;
  std::string app;
  bool regulated = false;
  /// Of the XPU's time in the long run, what its demand asks for: sum of work / period, with the preemptions that it is
  /// charged.
  double admitted_pct = 0;
  /// Since it joined, of its workers that are there: for how long jobs that are over have had the XPU.
  std::int64_t had_us = 0;
  /// Of the time between two looks: for how long jobs that ended in it have had the XPU. None: it was not there at both,
  /// or a job that ended has had it for longer than that.
  std::optional<double> had_pct;
};

struct MachineXpu {
  std::string xpu;
  /// What all together leave, in percent: solver::keys::slack_together, which has the formula. None: not computed, since
  /// the test takes long.
  std::optional<std::int64_t> slack_pct;
  std::vector<AppOnXpu> apps;
};

/// By XPU. `before`: the first of two looks; null: there was none.
[[nodiscard]] std::vector<MachineXpu> machine_xpus(const Json& now, const Json& before);
/// `now`, with `had_pct` beside each `had_us`.
[[nodiscard]] Json machine_json(Json now, const Json& before);
/// A table for people; empty: nobody has joined.
[[nodiscard]] std::string machine_text(const Json& now, const Json& before);

/// Who has had which XPU: a track for each, with a slice for each time, named after the app. Threads: one.
class MachineRecord {
 public:
  explicit MachineRecord(std::string socket) : socket_(std::move(socket)) {}
  /// Who is there now. Often: leases that come and go between two calls have no name. Errors as launch::watch_machine.
  [[nodiscard]] Status follow(const Json& machine);
  /// Every few milliseconds: of each worker the last 32 jobs are kept.
  void look();
  [[nodiscard]] std::string perfetto() const;

 private:
  struct Followed {
    coord::Record record;
    coord::RecordReader reader;
    std::vector<coord::RecordedTime> times;
    std::uint64_t missed = 0;  ///< by readers before this one
  };
  std::string socket_;
  std::map<std::string, Followed> xpus_;
  std::map<std::uint32_t, std::string> names_;  ///< by lease
};

/// Of times that overlap, who has the XPU at each instant: whoever began last. In the order of time, none overlaps
/// another.
[[nodiscard]] std::vector<coord::RecordedTime> one_at_a_time(
    std::vector<coord::RecordedTime> times);

}  // namespace xauto::cli
