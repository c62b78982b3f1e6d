// SPDX-License-Identifier: Apache-2.0
// What a run in one process is made of, and how it hangs together: topics, modules, their chains of
// XNodes, and the workers that run them. Built once; then only started and stopped.
//
//   source ─────┐
//   Receiver ───┴─► Channel ─► ModuleRuntime ─► Chain ─► Worker ... ─► ModuleRuntime ─► Channel
//                      └─► Publisher ─► another process, or a program outside
//
// A Receiver brings what other processes and programs outside have published.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "grid/context.h"
#include "processes/board.h"
#include "processes/interop.h"
#include "processes/role.h"
#include "runtime/early_start.h"
#include "runtime/held_up.h"
#include "runtime/placing.h"
#include "runtime/worker.h"
#include "runtime/xmodule.h"
#include "session/run_report.h"
#include "transport/receiver.h"
#include "xpu/cpu_threads.h"

#include "parts/crossings.h"

namespace xauto::runtime {

/// Threads: one; the objects that it hands out have their own rules.
class Wiring {
 public:
  /// `host` is told what the modules do. Nothing runs yet.
  [[nodiscard]] static Result<std::unique_ptr<Wiring>> build(const Context& context,
                                                             const Placing& placing, Role& role,
                                                             ModuleHost& host);
  ~Wiring();
  Wiring(const Wiring&) = delete;
  Wiring& operator=(const Wiring&) = delete;

  /// Starts the workers and runs each XNode's `init`.
  [[nodiscard]] Status start();
  /// From here on messages of other processes come in; with one process there are none.
  [[nodiscard]] Status open_inputs();
  void close_inputs();
  /// Ends the workers, with patience for an exec that is running. Returns what never returned; its
  /// threads use these objects, which must then outlive the process. Idempotent.
  std::vector<std::string> stop();

  /// Ends the workers, however long their jobs take.
  void join();

  [[nodiscard]] transport::Channel& channel(std::size_t topic) { return channels_[topic]; }
  /// Where messages of `topic` for other processes are made; null: it stays inside.
  [[nodiscard]] transport::Publisher* publisher(std::size_t topic) const {
    return publishers_[topic].get();
  }
  /// Null: no program outside hears or feeds this process.
  [[nodiscard]] Interop* interop() const { return interop_.get(); }
  /// Null: the run is not one host's part of several.
  [[nodiscard]] parts::Crossings* crossings() const { return crossings_.get(); }
  /// From here on messages of other hosts come in; modules begin with the first releases that are for us.
  [[nodiscard]] Status begin_part(const parts::PartStart& start);
  /// Null: holds are waited for to their end.
  [[nodiscard]] EarlyStart* early_start() const { return early_.get(); }
  /// Null: none was opened.
  [[nodiscard]] transport::Receiver* receiver() const { return receiver_.get(); }
  /// Null: another process has it.
  [[nodiscard]] ModuleRuntime* module(std::size_t index) const { return modules_[index].get(); }
  /// Of activation number `index` of the module.
  [[nodiscard]] const NodeRow& chain(std::size_t module, int index) const {
    return *chains_[module][static_cast<std::size_t>(index)];
  }
  [[nodiscard]] const std::vector<std::unique_ptr<Worker>>& workers() const { return workers_; }
  /// No XNode of `module` starts a job of an activation up to `sequence` any more.
  void skip(int module, std::uint64_t sequence);
  /// sched_ext ended before the run did.
  [[nodiscard]] bool lost_scheduler() const;
  /// What its parts have to tell, apart from counts. Ends the way to programs outside.
  void report(RunReport& into);

 private:
  Wiring(const Context& context, const Placing& placing, Role& role)
      : context_(context), placing_(placing), role_(role) {}
  [[nodiscard]] Status place_module(std::size_t module, int index);
  [[nodiscard]] Result<Placed> place_node(std::size_t module, std::size_t table, int n);
  void tell_order(const Placed& placed, int xpu);
  [[nodiscard]] Status open_topics();
  [[nodiscard]] Status make_module(std::size_t module, ModuleHost& host);
  void connect(std::size_t topic);

  OneThread thread_;
  const Context& context_;
  const Placing& placing_;
  Role& role_;
  std::vector<std::unique_ptr<BoardRinger>> ringers_;
  std::vector<std::shared_ptr<transport::Publisher>> publishers_;  ///< [topic]
  std::vector<transport::Channel> channels_;                       ///< [topic]
  std::unique_ptr<Interop> interop_;
  std::unique_ptr<parts::Crossings> crossings_;
  std::unique_ptr<transport::Receiver> receiver_;
  std::vector<std::unique_ptr<ModuleRuntime>> modules_;        ///< [module]
  std::vector<std::vector<std::unique_ptr<NodeRow>>> chains_;  ///< [module][in flight]
  std::unique_ptr<HeldUp> held_up_;                            ///< null: nobody schedules
  std::unique_ptr<EarlyStart> early_;                          ///< outlives the workers
  std::unique_ptr<xpu::CpuThreads> threads_;                   ///< outlives the workers
  std::vector<Crew> crews_;                                    ///< [XPU]; they, too
  std::vector<std::unique_ptr<Worker>> workers_;
};

}  // namespace xauto::runtime
