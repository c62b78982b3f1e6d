// SPDX-License-Identifier: Apache-2.0
// The run itself: builds workers and modules from a graph and a session, releases the sensors,
// accounts for every release, and tells what happened.
#pragma once

#include <atomic>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "record/recording.h"
#include "runtime/app_spec.h"
#include "runtime/board.h"
#include "runtime/ghost.h"
#include "runtime/graph.h"
#include "runtime/interop.h"
#include "runtime/isolation.h"
#include "runtime/priorities.h"
#include "runtime/routes.h"
#include "runtime/session.h"
#include "runtime/watch.h"
#include "runtime/worker.h"
#include "runtime/xmodule.h"
#include "trace/trace.h"
#include "transport/receiver.h"

namespace xauto::runtime {

/// Threads: one, apart from `request_stop`, which is async-signal-safe.
class Engine final : public ModuleHost, private HubHost {
 public:
  [[nodiscard]] static Result<std::unique_ptr<Engine>> create(const detail::AppSpecErased& app,
                                                              const Session& session);
  ~Engine() override;

  /// Releases until the session's end, waits for what is in flight, stops the workers. In a member
  /// (isolation.h): until the hub says so; its report is part of the hub's.
  [[nodiscard]] Result<RunReport> run();
  [[nodiscard]] bool member() const { return member_ != nullptr; }
  /// After `run`: an exec has not returned and never may. Its thread uses this engine, so it must
  /// not be destroyed: end the process without it.
  [[nodiscard]] bool stuck() const { return stuck_; }
  /// No further releases; what is in flight is finished.
  void request_stop() { stop_.store(true); }

  // ModuleHost, called by the modules on the workers' threads.
  void activate(int module) override;
  void done(int module, std::int64_t origin_ns, std::uint64_t sequence) override;
  void dropped(int module, std::uint64_t sequence, std::uint32_t reason) override;
  void skip(int module, std::uint64_t sequence) override;

 private:
  Engine(const detail::AppSpecErased& app, const Session& session, Graph graph);
  // HubHost, called on the hub's thread.
  void event(const Packet& packet) override;
  void left(int process) override;
  void joins(int process) override;

  [[nodiscard]] bool hosted(std::size_t module) const {
    return plan_.process_of[module] == session_.process;
  }
  [[nodiscard]] transport::Link& link(std::size_t topic) const;
  [[nodiscard]] std::uint64_t trace_capacity() const;
  [[nodiscard]] Status open_topics();
  [[nodiscard]] Status open_inputs();
  [[nodiscard]] Result<RunReport> run_member();
  void gather(const std::vector<std::string>& reports, RunReport& report) const;
  struct Placing;
  [[nodiscard]] Status place();
  [[nodiscard]] FifoPlan choose_priorities();
  void compare_with_certificate();
  [[nodiscard]] std::vector<std::pair<std::uint32_t, std::uint32_t>> order_in_force();
  [[nodiscard]] Status place_module(std::size_t m, const Placing& placing);
  [[nodiscard]] Result<WorkerOptions> worker_options(std::size_t module, int xpu,
                                                     const Placing& placing) const;
  [[nodiscard]] Status wire();
  [[nodiscard]] Status start_workers();
  [[nodiscard]] std::int64_t run_length_ns(std::int64_t slowest_period_ns) const;
  [[nodiscard]] int slowest_source() const;
  [[nodiscard]] Status release_periodic();
  [[nodiscard]] Status release_recorded();
  /// What a source releases: its own number, which in an app of one rate is everybody's.
  struct Sample {
    int topic = -1;
    std::uint64_t sequence = 0;
    std::shared_ptr<const void> message;  ///< null: lost
  };
  void take_fed(std::vector<Sample> fed, std::int64_t period_ns, std::vector<Sample>& samples);
  void release(std::int64_t origin_ns, const std::vector<Sample>& samples);
  [[nodiscard]] Status open_recorder();
  void record(std::int64_t origin_ns, const std::vector<Sample>& samples);
  [[nodiscard]] Result<RunReport> run_whole();
  void start_watchdog();
  void hung(const Worker& worker, const Worker::Hung& job);
  void watch_members(std::int64_t now);
  void stop_workers();
  [[nodiscard]] bool settled() const;
  bool wait_drained();
  void tell_notes(RunReport& result);
  [[nodiscard]] RunReport report();
  [[nodiscard]] int xpu_of(const Graph::Node& node, std::uint32_t xnode) const;
  void trace_inputs(int module, ModuleRuntime& runtime);
  void through(int module, std::uint64_t sequence, std::int64_t origin_ns,
               const detail::Origins* origins, std::int64_t now, bool lost);
  void missed(int module, std::uint64_t sequence, std::int64_t latency_us);
  void account(int module, std::uint64_t sequence, std::int64_t now, bool lost);

  const detail::AppSpecErased& app_;
  const Session& session_;
  const Graph graph_;
  Plan plan_;
  std::shared_ptr<Board> board_;
  std::vector<std::unique_ptr<BoardRinger>> ringers_;
  std::vector<std::shared_ptr<transport::Publisher>> publishers_;  ///< [topic]; null: inside only
  std::unique_ptr<transport::Receiver> receiver_;                  ///< none with one process
  std::unique_ptr<Interop> interop_;                               ///< none: nobody outside
  std::unique_ptr<trace::Writer> trace_;
  std::vector<transport::Channel> channels_;  ///< [topic]
  std::vector<std::unique_ptr<ModuleRuntime>> modules_;
  std::vector<std::unique_ptr<Chain>> chains_;  ///< [module]
  std::unique_ptr<xpu::CpuThreads> threads_;    ///< outlives the workers
  std::vector<std::unique_ptr<Worker>> workers_;
  FifoPlan fifo_;  ///< what this process may
  std::string note_;
  std::vector<std::string> unkept_;           ///< see RunReport
  std::optional<record::Recorder> recorder_;  ///< of the releasing thread
  std::string recording_error_;               ///< of the releasing thread, then of `run`'s
  std::vector<std::size_t> recorded_topic_;   ///< [topic] -> the recorder's index
  std::atomic<bool> stop_{false};
  bool stuck_ = false;
  std::vector<Limits> limits_;  ///< [graph node]
  PiMutex hung_mutex_;
  std::string hung_note_;                   ///< guarded by hung_mutex_
  std::map<int, std::int64_t> silence_ns_;  ///< hub: by process, after which it is killed
  std::unique_ptr<Watchdog> watchdog_;

  /// Latencies of the sinks; the counts are on the board.
  struct Latencies {
    PiMutex mutex;
    Distribution us;  ///< guarded by mutex
  };
  std::vector<std::unique_ptr<Latencies>> latencies_;  ///< [module]

  /// Releases in flight and past. Written under the mutex: once per release and sink, not per job.
  struct Open {
    std::int64_t origin_ns = 0, last_ns = 0;
    int sinks_left = 0;
    bool lost = false;
  };
  mutable PiMutex releases_mutex_;
  std::deque<Release> releases_;  ///< the last kKeptReleases
  std::uint64_t num_releases_ = 0, lost_releases_ = 0, overlapping_releases_ = 0;
  Distribution release_latencies_us_;
  std::deque<Open> open_;                 ///< from open_base_ on; those before are accounted for
  std::uint64_t open_base_ = 0;           ///< a sequence
  std::uint64_t num_released_ = 0;        ///< single rate; of the releasing thread, then of `run`'s
  std::vector<std::uint64_t> sink_next_;  ///< [module] single rate: the next release to account for
  int num_sinks_ = 0;
  std::atomic<std::uint32_t> in_flight_{
      0};  ///< single rate: releases not yet accounted for; a futex
  std::atomic<std::uint64_t> deadline_misses_{0};
  std::optional<Routes> routes_;
  std::map<int, std::unique_ptr<Ghost>> ghosts_;  ///< by process; of the hub's thread
  // Last, so that their threads end before what they use.
  std::unique_ptr<Member> member_;
  std::unique_ptr<Hub> hub_;
};

}  // namespace xauto::runtime
