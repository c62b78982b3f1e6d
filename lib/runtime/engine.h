// SPDX-License-Identifier: Apache-2.0
// The run itself: builds workers and modules from a graph and a session, releases the sensors,
// accounts for every release, and tells what happened.
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "record/recording.h"
#include "runtime/app_spec.h"
#include "runtime/graph.h"
#include "runtime/session.h"
#include "runtime/worker.h"
#include "runtime/xmodule.h"
#include "trace/trace.h"

namespace xauto::runtime {

/// Threads: one, apart from `request_stop`, which is async-signal-safe.
class Engine final : public ModuleHost {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Engine>> create(const detail::AppSpecErased& app,
                                                              const Session& session);
  ~Engine() override;

  /// Releases until the session's end, waits for what is in flight, stops the workers.
  [[nodiscard]] Result<RunReport> run();
  /// No further releases; what is in flight is finished.
  void request_stop() { stop_.store(true); }

  // ModuleHost, called by the modules on the workers' threads.
  void activate(int module) override;
  void done(int module, std::int64_t origin_ns, std::uint64_t sequence) override;
  void dropped(int module, std::uint64_t sequence, std::uint32_t reason) override;
  void skip(int module, std::uint64_t sequence) override;

 private:
  Engine(const detail::AppSpecErased& app, const Session& session, Graph graph);
  [[nodiscard]] Status place();
  [[nodiscard]] Status wire();
  [[nodiscard]] Status start_workers();
  [[nodiscard]] Status release_periodic();
  [[nodiscard]] Status release_recorded();
  void release(std::int64_t origin_ns, std::uint64_t sequence,
               const std::vector<std::pair<int, std::shared_ptr<const void>>>& messages);
  [[nodiscard]] Status open_recorder();
  void record(std::int64_t origin_ns,
              const std::vector<std::pair<int, std::shared_ptr<const void>>>& messages);
  bool wait_drained(std::int64_t timeout_ns);
  [[nodiscard]] RunReport report() const;
  [[nodiscard]] int xpu_of(const Graph::Node& node, std::uint32_t xnode) const;
  void account(std::uint64_t sequence, std::int64_t now, bool lost);

  const detail::AppSpecErased& app_;
  const Session& session_;
  const Graph graph_;
  std::unique_ptr<trace::Writer> trace_;
  std::vector<transport::Channel> channels_;  ///< [topic]
  std::vector<std::unique_ptr<ModuleRuntime>> modules_;
  std::vector<std::unique_ptr<Chain>> chains_;  ///< [module]
  std::vector<std::unique_ptr<Worker>> workers_;
  std::vector<std::uint32_t> xnode_of_;  ///< [graph node] -> index in app.json
  std::string note_;
  std::optional<record::Recorder> recorder_;  ///< of the releasing thread
  std::vector<std::size_t> recorded_topic_;   ///< [topic] -> the recorder's index
  std::atomic<bool> stop_{false};

  /// Counts of one module, written by whichever thread ends its activation (one at a time).
  struct ModuleCounts {
    std::atomic<std::uint64_t> activations{0}, failed{0}, dropped{0};
    PiMutex mutex;
    std::vector<std::int64_t> latencies_us;  ///< guarded by mutex; sinks only
  };
  std::vector<std::unique_ptr<ModuleCounts>> counts_;

  /// Releases in flight and past. Written under the mutex: once per release and sink, not per job.
  struct Open {
    std::int64_t origin_ns = 0, last_ns = 0;
    int sinks_left = 0;
    bool lost = false;
  };
  mutable PiMutex releases_mutex_;
  std::vector<Release> releases_;
  std::vector<Open> open_;  ///< by sequence
  int num_sinks_ = 0;
  std::atomic<std::uint32_t> in_flight_{
      0};  ///< single rate: releases not yet accounted for; a futex
  std::atomic<std::uint64_t> deadline_misses_{0};
};

}  // namespace xauto::runtime
