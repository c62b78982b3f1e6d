// SPDX-License-Identifier: Apache-2.0
// Which scenario a run with tables counts with. Asked before each release. Pure: time comes from
// outside, so tests need none.
//
//   floor      the scenario that people ask for (`xauto param`, App::request_mode), and the one that
//              the machine's clocks say (condition_watch.h)
//   lost       XPUs from which a job did not return within its hang limit, where a scenario does
//              without them; until people ask anew, as nothing is seen of an XPU that nobody uses
//   evidence   for how long jobs have had their XPUs, in the last dwell at least
//
//                a job past its WCET, a higher floor, an XPU that is lost: at once
//        ┌───────────────────────────────────────────────────────────────┐
//        │                                                               ▼
//   a scenario that covers the floor                    the least one that covers the floor,
//   and fits the evidence                               the scenario before, and the evidence
//        ▲                                                               │
//        └───────────────────────────────────────────────────────────────┘
//          after a dwell in which nothing took longer than the lower one allows, less a margin
//
// A scenario whose XNodes run elsewhere cannot be seen from here: XNodes that left a throttled GPU
// tell nothing of it. So going back is a trial, and each trial that fails doubles the dwell.
// Where none fits: the one that covers most. Which is the least and which covers most, scenario_order.h says.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/platform.h"
#include "model/tables.h"
#include "tables/scenario_order.h"

namespace xauto::runtime {

/// What is in force, and what it was chosen for.
struct Choice {
  int scenario = 0;  ///< index into Tables::scenarios
  int table = 0;     ///< index into Tables::tables
  Why why = Why::kStart;
  /// kOverrun, kOutside: the job, how long it had its XPU, and what the scenario before (kOverrun) or
  /// this one (kOutside) allows. kLost: the job, and the XPU.
  int xnode = -1, xpu = -1;
  std::int64_t saw_ns = 0, allowed_ns = 0;
};

/// A job of `xnode` had its XPU for longer than a scenario allows.
struct Passing {
  int xnode = -1;
  std::int64_t saw_ns = 0, allowed_ns = 0;
};

struct ChoiceOptions {
  std::int64_t dwell_ns = 2'000'000'000;  ///< at least so long before it goes back
  /// It goes back where what was seen is so much below what the lower scenario allows. WCETs that were
  /// measured have a margin of their own.
  std::int64_t margin_pct = 0;
};

/// Threads: one at a time.
class ScenarioChoice {
 public:
  /// What a job may take before it counts as longer than its WCET on an XPU of this type, in ns: on
  /// emulated ones a little more.
  using Allow = std::function<std::int64_t(const std::string& type, std::int64_t wcet_us)>;
  /// `tables` are valid for `app` and `platform`.
  ScenarioChoice(const AppSpec& app, const Platform& platform, const Tables& tables,
                 const Allow& allow, const ChoiceOptions& options = {});

  /// People's wish; -1: none. Beyond the list: as none.
  void ask(int scenario);
  /// What the machine's clocks say; -1: nothing.
  void expect(int scenario);
  /// A job of `xnode` has had its XPU for so long, where `table` places it and as the variant that it
  /// has there. It may still have it.
  void saw(int table, std::size_t xnode, std::int64_t ns);
  /// A job of `xnode` does not return from where `table` places it.
  void hung(int table, std::size_t xnode);
  /// Whether what is in force still covers all that is known: nothing that was seen passes it.
  [[nodiscard]] bool holds() const;
  /// What `decide` would say now.
  [[nodiscard]] Choice foresee(std::int64_t now_ns) const;
  /// What shall be in force from now on. True: that is another scenario than before.
  bool decide(std::int64_t now_ns);
  [[nodiscard]] const Choice& now() const { return now_; }
  /// Of each XNode of which something was seen that passes `scenario`, what passes it most.
  [[nodiscard]] std::vector<Passing> passing(int scenario) const;
  [[nodiscard]] const ScenarioOrder& order() const { return *order_; }

 private:
  struct Evidence {
    std::size_t xnode = 0;
    int form = 0;  ///< of the XNode: its type of XPU, and its variant
    std::int64_t ns = 0;
  };
  struct Passed {
    double factor = 0;    ///< by this at most; at most 1: it is not
    Evidence worst = {};  ///< by that
    double excess = 0;    ///< of all XNodes, what is above 1
  };
  [[nodiscard]] bool does_without_gone(std::size_t scenario) const;
  [[nodiscard]] bool on_floor(std::size_t scenario) const;
  [[nodiscard]] bool fits(std::size_t scenario, std::int64_t margin_pct) const;
  template <class F>
  void each_seen(std::size_t scenario, F f) const;
  [[nodiscard]] Passed passed(std::size_t scenario) const;
  [[nodiscard]] std::int64_t allowed(std::size_t scenario, const Evidence& seen) const {
    return allowed_ns_[scenario][seen.xnode][static_cast<std::size_t>(seen.form)];
  }
  [[nodiscard]] int next_scenario() const;
  [[nodiscard]] int last_resort() const;
  void blame(const Evidence& seen, int judged);
  void put(int scenario, Why why, std::int64_t now_ns);
  void lose(int scenario, std::int64_t now_ns);
  void age(std::int64_t now_ns);

  const ChoiceOptions options_;
  std::shared_ptr<const ScenarioOrder> order_;                      ///< the same in each copy
  std::vector<int> table_;                                          ///< [scenario]
  std::vector<std::vector<std::vector<std::int64_t>>> allowed_ns_;  ///< [scenario][xnode][form]
  std::vector<std::vector<int>> form_, xpu_;  ///< [table][xnode]; -1: its module is off
  std::vector<std::vector<char>> lost_;       ///< [scenario][XPU]
  std::vector<char> gone_;                    ///< [XPU]
  struct Hung {
    int xnode = -1, xpu = -1;
  };
  Hung hung_;  ///< since the last choice
  /// [xnode][form] the longest, of this span of time and of the one before; 0: nothing.
  std::vector<std::vector<std::int64_t>> recent_ns_, older_ns_;
  std::int64_t span_since_ns_ = 0;
  bool begun_ = false;
  int asked_ = -1, expected_ = -1;
  bool asked_anew_ = false;
  std::int64_t since_ns_ = 0, dwell_ns_;
  Choice now_;
};

}  // namespace xauto::runtime
