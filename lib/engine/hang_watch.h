// SPDX-License-Identifier: Apache-2.0
// Jobs past their hang limits, and processes that do not look after themselves. See watchdog.h.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "account/foreign_watch.h"
#include "account/thread_watch.h"
#include "base/thread_safety.h"
#include "engine/run_role.h"
#include "engine/watchdog.h"
#include "grid/context.h"
#include "runtime/wiring.h"

namespace xauto::runtime {

/// Threads: one, apart from its own.
class HangWatch {
 public:
  /// `limits`: [table][graph node]. Starts a thread if anything has a hang limit, if worst cases are claimed of
  /// jobs within their WCETs, or if the times of jobs decide which table is next and another process decides.
  [[nodiscard]] static Result<std::unique_ptr<HangWatch>> make(
      const Context& context, const Wiring& wiring, RunRole& role,
      const std::vector<std::vector<Limits>>& limits);
  void stop();
  /// What took time away from the run in this process. After `stop`.
  void report(RunReport& into) const;
  /// What hung, for people. After `stop`.
  [[nodiscard]] const std::string& note() const;

 private:
  HangWatch(const Context& context, const Wiring& wiring, RunRole& role)
      : context_(context), wiring_(wiring), role_(role) {}
  [[nodiscard]] Status start(const std::vector<std::vector<Limits>>& limits);
  void look_at_jobs(std::int64_t now_ns, bool tells, bool claims);
  void look_at_threads(std::int64_t now_ns);
  void hung(const Worker& worker, const JobTimes::Hung& job);

  OneThread thread_;
  const Context& context_;
  const Wiring& wiring_;
  RunRole& role_;
  std::string note_;                       ///< of the watchdog's thread
  std::unique_ptr<ThreadWatch> threads_;   ///< of the watchdog's thread; null: nothing is claimed
  std::unique_ptr<ForeignWatch> foreign_;  ///< likewise
  std::int64_t looked_ns_ = 0;             ///< likewise
  std::unique_ptr<Watchdog> watchdog_;
};

}  // namespace xauto::runtime
