// SPDX-License-Identifier: Apache-2.0
// Before a job's first step: the sensors' releases, by their periods, as a driver pushes them, from a
// recording, or as programs outside feed them; and their recording.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "account/ledger.h"
#include "graph/inlet.h"
#include "grid/context.h"
#include "grid/phase.h"
#include "releases/clock_starts.h"
#include "releases/feeds.h"
#include "releases/run_recorder.h"
#include "releases/source_account.h"
#include "runtime/wiring.h"
#include "tables/table_switch.h"

#include "parts/crossings.h"

namespace xauto::runtime {

/// Threads: one at a time.
class Releaser {
 public:
  /// Opens the recorder, if a recording was asked for. `stop` ends the releases early.
  [[nodiscard]] static Result<std::unique_ptr<Releaser>> make(const Context& context,
                                                              Wiring& wiring, Ledger& ledger,
                                                              const std::atomic<bool>& stop);
  /// Calls the app's on_start, and releases until the session's end. On a thread of its own: the
  /// callbacks are a user's, and its priority is `fifo` (0: an ordinary thread).
  [[nodiscard]] Status run(int fifo);
  /// Its releases begin then, from some instant on, with all hosts'; see parts/crossings.h. Before `run`.
  void begin_with(const parts::PartStart& start) { part_ = start; }
  /// What is nominally released so long after the start, or later, is not released any more. After `run`.
  [[nodiscard]] std::int64_t end_ns() const { return end_ns_; }
  /// Until everything that was released is through; see Ledger::wait_drained.
  [[nodiscard]] bool wait_drained();
  /// Closes the recording, with an account of `releases` (of an app of one rate). Nothing is published
  /// any more, or it is not recorded. Returns why it is not whole; empty: it is, or there is none.
  [[nodiscard]] std::string close(const std::vector<ReleaseRecord>& releases) {
    return recorder_ ? recorder_->close(releases) : std::string();
  }
  /// What the sources did that was not as declared; for people, after `run`.
  [[nodiscard]] const std::vector<std::string>& notes() const { return notes_; }
  /// No job runs any more: the last look at what tables take for granted. Before `report`.
  void stop_watch() {
    if (tables_) tables_->stop_watch();
  }
  /// Scenarios and switches of a run with tables; sources whose functions took too long.
  void report(RunReport& into) const;

 private:
  /// What a source releases: its own number, which is everybody's in its component.
  struct Sample {
    int topic = -1;
    std::uint64_t sequence = 0;
    std::shared_ptr<const void> message;  ///< null: lost
    std::int64_t nominal_ns = 0;          ///< when it should be released; 0: when it is
    bool urgent = false;
    std::int64_t stamp_ns = 0;  ///< its origin, of what is fed without a grid; 0: the release
    bool elsewhere = false;     ///< nobody hears it on this host
  };
  struct Periodic;
  Releaser(const Context& context, Wiring& wiring, Ledger& ledger, const std::atomic<bool>& stop)
      : context_(context), wiring_(wiring), ledger_(ledger), stop_(stop), account_(context) {}
  [[nodiscard]] Status run_here(int fifo);
  [[nodiscard]] std::int64_t run_length_ns(std::int64_t slowest_period_ns) const;
  [[nodiscard]] int slowest_source() const;
  [[nodiscard]] Status release_periodic();
  [[nodiscard]] Periodic begin_periodic();
  [[nodiscard]] Status set_clocks_apart(const Periodic& run);
  void tell_first_releases(const Periodic& run);
  [[nodiscard]] bool find_next(Periodic& run) const;
  [[nodiscard]] Result<bool> take_turn(Periodic& run, std::int64_t& due_ns);
  [[nodiscard]] Status make_messages(Periodic& run, std::int64_t due_ns);
  [[nodiscard]] Result<bool> wait_until_due(std::int64_t due_ns);
  [[nodiscard]] Result<bool> release_pushed(std::int64_t until_ns, bool once = false);
  [[nodiscard]] bool lose_overdue(std::int64_t now_ns);
  [[nodiscard]] std::int64_t next_overdue_ns() const;
  void leave_out(int topic, std::uint64_t number, std::int64_t at_ns);
  [[nodiscard]] bool counted_all(int topic);
  [[nodiscard]] Result<bool> release_tracked(int topic, const detail::Inlet::Waiting& pushed);
  [[nodiscard]] bool tracks() const;
  [[nodiscard]] Status check_part() const;
  [[nodiscard]] bool tracked(std::size_t topic) const;
  [[nodiscard]] Status open_feeds(int fifo);
  [[nodiscard]] bool certifies_urgent(std::size_t source) const;
  void open_for_urgent();
  [[nodiscard]] Result<bool> marked(std::size_t source, const void* message, std::uint64_t number);
  void sleep(std::int64_t until_ns) const;
  [[nodiscard]] bool waits_for_the_last() const;
  [[nodiscard]] Status drain();
  [[nodiscard]] Result<std::shared_ptr<const void>> make_message(std::size_t source,
                                                                 std::size_t topic,
                                                                 std::uint64_t number,
                                                                 std::int64_t since_ns);
  [[nodiscard]] Result<bool> gather_pushed(std::vector<Sample>& samples, std::uint64_t number,
                                           std::int64_t end_ns);
  [[nodiscard]] Status release_one_at_a_time();
  [[nodiscard]] Status release_recorded();
  [[nodiscard]] std::int64_t distance_ns(std::int64_t from_ns, std::int64_t to_ns);
  std::int64_t take_fed(std::vector<Sample> fed, std::int64_t due_ns, std::vector<Sample>& samples);
  [[nodiscard]] std::int64_t component_release_ns(std::int64_t now_ns,
                                                  std::span<const Sample> samples) const;
  void release(std::int64_t now_ns, const std::vector<Sample>& samples);
  void tell_early_start(const Sample& sample);

  const Context& context_;
  Wiring& wiring_;
  Ledger& ledger_;
  const std::atomic<bool>& stop_;
  std::unique_ptr<TableSwitch> tables_;    ///< null: there is one policy
  std::unique_ptr<RunRecorder> recorder_;  ///< null: nothing is recorded
  std::optional<detail::Inlets> inlets_;   ///< while it releases
  FedGrid fed_grid_;
  std::unique_ptr<Feeds> feeds_;       ///< likewise; before its inlets; null: nobody feeds
  std::vector<std::uint64_t> pushed_;  ///< [topic] releases of pushed sources
  std::uint64_t pushes_left_ = 0;      ///< of the slowest source; 0: no end
  std::vector<std::string> notes_;
  std::optional<parts::PartStart> part_;
  std::int64_t end_ns_ = INT64_MAX;
  int gaps_ = 0;           ///< of the recording, longer than record::kGapNs
  SourceAccount account_;  ///< what is not as app.json states
  /// [clock] of what is pushed in a run by keys; null: everything of it is released by us.
  std::vector<std::unique_ptr<ClockPhase>> phases_;
  std::vector<ClockPhase::Stream> streams_;  ///< [source]
  std::vector<ClockStart> starts_;           ///< [clock] of what we release
};

}  // namespace xauto::runtime
