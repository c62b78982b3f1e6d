// SPDX-License-Identifier: Apache-2.0
// A run in one process, from its parts: what it is made of (Wiring), what it releases (Releaser),
// what became of that (Ledger), who hangs (HangWatch), and which process of the app this is (Role).
#pragma once

#include <atomic>
#include <memory>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "graph/app_spec.h"
#include "graph/graph.h"
#include "processes/plan.h"
#include "runtime/context.h"
#include "runtime/hang_watch.h"
#include "runtime/ledger.h"
#include "runtime/placing.h"
#include "runtime/releaser.h"
#include "runtime/role.h"
#include "runtime/wiring.h"
#include "session/run_report.h"
#include "session/session.h"
#include "trace/trace.h"

namespace xauto::runtime {

/// Threads: one, apart from `request_stop`, which is async-signal-safe.
class Engine final : private ModuleHost {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Engine>> create(const detail::AppSpecErased& app,
                                                              const Session& session);
  ~Engine() override;

  /// Releases until the session's end, waits for what is in flight, stops the workers. In a member
  /// (role.h): until the hub says so; its report is part of the hub's.
  [[nodiscard]] Result<RunReport> run();
  [[nodiscard]] bool member() const { return !role_->leads(); }
  /// After `run`: an exec has not returned and never may. Its thread uses this engine, so it must
  /// not be destroyed: end the process without it.
  [[nodiscard]] bool stuck() const { return stuck_; }
  /// No further releases; what is in flight is finished.
  void request_stop() { stop_.store(true); }

 private:
  Engine(const detail::AppSpecErased& app, const Session& session, Graph graph)
      : app_(app), session_(session), graph_(std::move(graph)) {}
  // ModuleHost, called by the modules on the workers' threads.
  void activate(int module) override;
  void done(int module, std::int64_t origin_ns, std::uint64_t sequence) override;
  void dropped(int module, std::uint64_t sequence, std::uint32_t reason) override;
  void skip(int module, std::uint64_t sequence) override;

  [[nodiscard]] Status open_trace(bool leads);
  void trace_inputs(int module, ModuleRuntime& runtime);
  [[nodiscard]] Result<RunReport> run_all();
  [[nodiscard]] Result<RunReport> run_part();
  void stop_workers();
  void tell_notes(RunReport& into);
  [[nodiscard]] RunReport report();

  OneThread thread_;
  const detail::AppSpecErased& app_;
  const Session& session_;
  const Graph graph_;
  Plan plan_;
  std::atomic<bool> stop_{false};
  bool stuck_ = false;
  std::string left_behind_;  ///< for people
  std::unique_ptr<trace::Writer> trace_;
  Placing placing_;
  std::unique_ptr<Context> context_;
  std::unique_ptr<Ledger> ledger_;
  std::unique_ptr<Wiring> wiring_;
  std::unique_ptr<Releaser> releaser_;  ///< null in a member
  std::unique_ptr<HangWatch> hangs_;
  std::unique_ptr<Role> role_;
};

}  // namespace xauto::runtime
