// SPDX-License-Identifier: Apache-2.0
// A run in one process, from its parts: what it is made of (Wiring), what it releases (Releaser),
// what became of that (Ledger), who hangs (HangWatch), and which process of the app this is (RunRole).
#pragma once

#include <atomic>
#include <memory>
#include <span>
#include <vector>

#include <xauto/result.h>

#include "account/ledger.h"
#include "base/thread_safety.h"
#include "engine/hang_watch.h"
#include "engine/run_role.h"
#include "graph/app_spec.h"
#include "graph/graph.h"
#include "grid/context.h"
#include "processes/plan.h"
#include "releases/releaser.h"
#include "runtime/placing.h"
#include "runtime/wiring.h"
#include "session/run_report.h"
#include "session/session.h"
#include "trace/trace.h"

namespace xauto::runtime {

/// Threads: one.
class Engine final : private ModuleHost {
 public:
  /// All three outlive it. `stop`: no further releases; what is in flight is finished. Anybody sets
  /// it, a signal handler, too; so does the engine where it cannot go on.
  [[nodiscard]] static Result<std::unique_ptr<Engine>> create(const detail::AppSpecErased& app,
                                                              const Session& session,
                                                              std::atomic<bool>& stop);
  ~Engine() override;

  /// Releases until the session's end, waits for what is in flight, stops the workers. In a member
  /// (run_role.h): until the hub says so; its report is part of the hub's.
  [[nodiscard]] Result<RunReport> run();
  [[nodiscard]] bool member() const { return !role_->leads(); }
  /// After `run`: an exec has not returned and never may. Its thread uses this engine, so it must
  /// not be destroyed.
  [[nodiscard]] bool stuck() const { return stuck_; }

 private:
  Engine(const detail::AppSpecErased& app, const Session& session, Graph graph,
         std::atomic<bool>& stop)
      : app_(app), session_(session), graph_(std::move(graph)), stop_(stop) {}
  // ModuleHost, called by the modules on the workers' threads.
  void activate(int module, Activation& activation) override;
  void proceed(int module, Activation& activation, std::size_t node) override;
  void done(int module, const Activation& activation) override;
  void dropped(int module, std::uint64_t sequence, std::uint32_t reason) override;
  void left(int module) override;
  void passed(int module, const Activation& activation, int node) override;
  void sampled(int module, std::span<const detail::Envelope> messages) override;
  void skip(int module, std::uint64_t sequence) override;

  [[nodiscard]] Status open_trace(bool leads);
  void count_in_flight(int module, int change);
  void trace_inputs(int module, Activation& activation);
  [[nodiscard]] std::uint32_t publisher_of(int topic) const;
  [[nodiscard]] Result<RunReport> run_all();
  [[nodiscard]] Result<RunReport> run_part();
  [[nodiscard]] Result<bool> begin_part();
  void note_chain_ends();
  [[nodiscard]] std::vector<std::size_t> waiting() const;
  void note_lockstep(RunReport& into) const;
  void stop_workers();
  void tell_notes(RunReport& into);
  void tell_preemptions(RunReport& into) const;
  void tell_assumptions(RunReport& into);
  static void say_not_complete(const std::string& why, RunReport& into);
  void tell_cores(Account& into) const;
  [[nodiscard]] RunReport report();

  OneThread thread_;
  const detail::AppSpecErased& app_;
  const Session& session_;
  const Graph graph_;
  Grid grid_;
  Plan plan_;
  std::atomic<bool>& stop_;
  bool stuck_ = false;
  std::string left_behind_;  ///< for people
  std::unique_ptr<trace::Writer> trace_;
  Placing placing_;
  std::unique_ptr<Context> context_;
  std::unique_ptr<Ledger> ledger_;
  std::unique_ptr<Wiring> wiring_;
  std::unique_ptr<Releaser> releaser_;  ///< null in a member
  std::unique_ptr<HangWatch> hangs_;
  std::unique_ptr<RunRole> role_;
};

}  // namespace xauto::runtime
