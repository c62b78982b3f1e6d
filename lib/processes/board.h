// SPDX-License-Identifier: Apache-2.0
// What the processes of one app share besides topics: a doorbell each, and the counts of every
// module, XNode and chain, which so survive the process that wrote them. The memory is the
// supervisor's, if there is one: `xauto top` and the progress line read it while the run goes on.
//
// [S] written by the supervisor, [M] by the process that hosts the module (or by the hub in its place once it is dead),
// [H] by the hub.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <xauto/result.h>

#include "base/context_counts.h"
#include "base/counter.h"
#include "base/unique_fd.h"
#include "processes/jobs_above.h"
#include "transport/doorbell.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

inline constexpr std::uint32_t kMaxProcesses = 256;

inline constexpr std::size_t kBoardTextBytes = 2048;  ///< with the 0 at its end; longer is cut

/// Of a run with tables, what met a change of the scenario.
struct Spanned {
  std::uint32_t from = 0, to = 0;  ///< scenarios
  std::uint32_t flow = 0;          ///< of keys the chain whose result it is; 0: a whole release
  std::int64_t us = -1;            ///< how long it took
  /// Of it, by the change; 0: nothing is claimed. allowed_us as FlowLine's.
  std::int64_t worst_case_us = 0, allowed_us = 0;
  [[nodiscard]] bool exceeds() const { return worst_case_us > 0 && us > allowed_us; }
};

/// The one that was nearest to its worst case, or beyond it by most. Its words are of one release whoever
/// reads them.
class SpannedLine {
 public:
  /// One thread at a time.
  void take(const Spanned& one);
  /// None: there was none, or whoever wrote it died at that.
  [[nodiscard]] std::optional<Spanned> read() const;

 private:
  std::atomic<std::uint32_t> writes_{};  ///< odd: one is being written
  std::atomic<std::uint32_t> from_{}, to_{}, flow_{};
  std::atomic<std::int64_t> us_{-1}, worst_case_us_{}, allowed_us_{};
};

struct alignas(64) BoardHeader {
  std::uint32_t magic = 0, processes = 0, modules = 0, nodes = 0, flows = 0, parameters = 0,
                scenarios = 0, xpus = 0, crossings = 0;
  std::atomic<std::uint32_t> told{};      ///< [H] what is there "before the run" is there
  std::atomic<std::uint64_t> released{};  ///< [H] releases of the sensors
  std::atomic<std::uint64_t> late{};      ///< [H] ... that were not where app.json has them
  std::atomic<std::int64_t> latest_ns{};  ///< [H] the most that one of these was off
  std::atomic<std::uint64_t> early{};     ///< [H] ... that came too soon
  /// [H] of an app that releases one at a time: releases that came while an earlier one was still in flight.
  std::atomic<std::uint64_t> overlapping{};
  /// [H] with tables: how often jobs, or the machine's clocks, were those of no scenario.
  std::atomic<std::uint64_t> outside_jobs{}, outside_clocks{};
  /// [H] before the run: what is claimed (session/account.h, Claimed), and what that takes for granted and this run
  /// does not keep.
  std::atomic<std::uint32_t> claimed{};
  char unkept[kBoardTextBytes] = {};
  ContextCounts contexts{};                    ///< by the workers of all processes
  std::atomic<std::uint64_t> daemon_deaths{};  ///< [S] of the emulator and coordinators
  // Of one host's part of a run:
  std::atomic<std::uint32_t> part_ready{};    ///< [H] PartReady
  std::atomic<std::int64_t> part_start_ns{};  ///< [S] when its releases begin; 0: not known yet
  // Of a run with tables:
  std::atomic<std::uint32_t> asked{};            ///< [S], and any process: scenario + 1; 0: none
  std::atomic<std::uint32_t> scenario{}, why{};  ///< [H] in force, and runtime::Why
  std::atomic<std::uint64_t> switches{};         ///< [H] to another table
  SpannedLine spanned{};                         ///< [H] of all changes of the scenario
  /// [H] those of which nothing is claimed for some chain; releases that kept a table because
  /// the change before had not settled.
  std::atomic<std::uint64_t> unproven_switches{}, unsettled{};
  /// [H] the tables of releases: in_force() of the newest, of the one before, and older ones: what a
  /// stall holds up may be of one of those. In a run by keys what counts is the nominal release of the
  /// component, in microseconds.
  std::atomic<std::uint64_t> in_force{}, before{}, older[30]{};
};

/// BoardHeader::part_ready.
enum class PartReady : std::uint32_t {
  kNotYet,
  kBuilt,  ///< it waits for the other hosts over DDS
  kMet,    ///< ... which are all there
};

/// A table, and the first release that has it. Up to 2^48 releases: 281 years at 30 kHz; as
/// microseconds of CLOCK_MONOTONIC 8 years.
constexpr std::uint64_t in_force(std::uint64_t release, std::uint32_t table) {
  return release << 16 | table;
}
constexpr std::uint64_t first_release(std::uint64_t word) {
  return word >> 16;
}
constexpr std::uint32_t table_in(std::uint64_t word) {
  return static_cast<std::uint32_t>(word & 0xffff);
}

/// What is counted, and checked when memory of another process is mapped.
struct BoardShape {
  std::uint32_t processes = 1, modules = 0, nodes = 0, flows = 1, parameters = 0, scenarios = 0,
                xpus = 0, crossings = 0;
};

inline constexpr std::size_t kBoardNameBytes = 104;  ///< with the 0 at its end; longer ones are cut

/// A release is settled once: done, failed, dropped, off or skipped. In an app of one rate they are settled
/// in order, so the sum of the five is the number of the next one.
struct alignas(64) ModuleLine {
  std::atomic<std::uint64_t> activations{}, failed{}, dropped{};  ///< [M] one writer at a time
  std::atomic<std::uint64_t> off{};  ///< [M] releases in whose table it is off
  std::atomic<std::uint64_t>
      skipped{};  ///< [M] releases that it, or one before it, skipped as it was told
  /// [M] activations that the program marked urgent: sooner after one than app.json states; where nothing certifies any.
  std::atomic<std::uint64_t> urgent_too_soon{}, urgent_unheard{};
  std::atomic<std::uint32_t> in_flight{};  ///< [M] activations that are
  std::atomic<std::uint32_t> deaths{};     ///< [H] of its process
  char name[kBoardNameBytes] = {};         ///< [H] before the run
  char host[kBoardNameBytes] = {};         ///< ... which other host has it; empty: it is here
  /// [H] 1 before the run, [S] grows when parameters change; see parameters.h.
  std::atomic<std::uint64_t> parameters{};
  [[nodiscard]] std::uint64_t settled() const {
    return activations.load() + failed.load() + dropped.load() + off.load() + skipped.load();
  }
};

/// What comes out: flow 0 is the whole app of one rate, release by release; the others are the
/// chains (routes.h).
struct alignas(64) FlowLine {
  static constexpr std::uint32_t kBuckets = 2048;  ///< Distribution's: up to days
  char name[kBoardNameBytes] = {};                 ///< [H] before the run
  std::uint32_t module = 0;                        ///< [H] where a chain ends
  /// [H] before the run: what the policy claims, and what is beyond that; 0: nothing. A bound from
  /// below has a policy of keys only. With tables the largest of all; each release has its own.
  std::int64_t worst_case_us = 0, lower_bound_us = 0, allowed_us = 0;
  std::int64_t urgent_worst_case_us = 0, urgent_allowed_us = 0;  ///< likewise, of urgent releases
  /// [H] before the run: what app.json and the deployment state; 0: nothing.
  std::int64_t period_us = 0, deadline_us = 0, age_limit_us = 0;
  // All [H].
  std::atomic<std::uint64_t> results{}, late{}, old{};
  /// Results that took longer than is claimed of them; and the worst of these, and what was claimed of it.
  std::atomic<std::uint64_t> over{};
  std::atomic<std::int64_t> over_us{}, over_claimed_us{};
  std::atomic<std::int64_t> sum_us{};   ///< of all latencies
  std::atomic<std::int64_t> last_ns{};  ///< when the last result came; 0: there was none
  std::atomic<std::int64_t>
      in_time_ns{};                   ///< ... that kept limit_us(); before there is one: the first
  std::atomic<std::uint64_t> lost{};  ///< of flow 0; a chain loses what its module loses
  std::atomic<std::int64_t> last_origin_ns{}, max_age_us{};
  std::atomic<std::int64_t> last_us{-1}, longest_us{-1};  ///< -1: there was none
  std::atomic<std::int64_t> longest_urgent_us{-1};        ///< of urgent releases
  /// By tables: 1: the newest table does not have the chain; and since when it was not, or is again.
  std::atomic<std::uint32_t> gone{};
  std::atomic<std::int64_t> gone_or_back_ns{};
  std::atomic<std::uint32_t> latency_us[kBuckets] = {};
  /// What a result may take: the deadline, and without one what the policy claims; 0: anything.
  [[nodiscard]] std::int64_t limit_us() const { return deadline_us > 0 ? deadline_us : allowed_us; }
  void add(std::int64_t us, std::int64_t now_ns);  ///< one thread at a time
  void add_urgent(std::int64_t us);                ///< beside `add`
};

inline constexpr std::size_t kParameterWords = 32;  ///< a number, or a length and a text

/// A parameter of a module. Those of one module are side by side, as it declares them.
struct alignas(64) ParameterLine {
  char name[kBoardNameBytes] = {};     ///< [H] before the run, as all up to `value`
  std::uint32_t module = 0, type = 0;  ///< ParameterType
  std::uint64_t least = 0, most = 0;   ///< bits_of(), of numbers
  std::uint64_t initial[kParameterWords] = {};
  std::atomic<std::uint64_t> value[2][kParameterWords] = {};  ///< [H] before the run, then [S]
  std::atomic<std::uint64_t> changes{};                       ///< [S]
};

/// By what the jobs of an XNode are ordered.
enum class Ordered : std::uint32_t {
  kNobody,    ///< nobody keeps one: the run is not scheduled, or its core is not
  kPriority,  ///< the larger goes first
  kKey,       ///< by when after its release it is done
  kRank,      ///< a SCHED_FIFO priority on a real core, one of those of the policy
};

/// Jobs of one XNode that has limits (session/limits.h), and how urgent they are (prio.h).
struct alignas(64) XNodeLine {
  char name[kBoardNameBytes] = {}, module[kBoardNameBytes] = {};  ///< [H] before the run
  /// [H] before the run: its WCET is that beside fewer loaded XPUs than app.json states one for (Placement::wcet_us).
  bool kept_apart = false;
  // [M]; overruns: of the budget
  std::atomic<std::uint64_t> jobs{}, overruns{}, hangs{};
  std::atomic<std::int64_t> longest_ns{};  ///< [M]
  /// [M] jobs longer than Limits::wcet_ns, and the most that one was. With tables [H], of those that no
  /// scenario in force covered.
  std::atomic<std::uint64_t> over_wcet{};
  std::atomic<std::int64_t> over_ns{};
  /// [M] jobs longer than that so far, which have not ended: at the last look of their process's watchdog.
  /// For how long the longest has run, and its Limits::wcet_ns. Without tables.
  std::atomic<std::uint32_t> unended{};
  std::atomic<std::int64_t> unended_ns{}, unended_wcet_ns{};
  /// [M] calls of the backend that should suspend its work, or resume it, and failed; and on which XPU the last
  /// one did, by the platform's order.
  std::atomic<std::uint64_t> failed_suspends{}, failed_resumes{};
  std::atomic<std::uint32_t> failed_on{};
  /// With tables: the longest job since the hub last looked, and by which of them it ran, as one word.
  /// [M] raises it, [H] takes it. 0: there was none.
  std::atomic<std::uint64_t> seen_job{};
  std::atomic<std::uint32_t> hung_table{};  ///< [M] of the last job that hung
  /// [M] on a real CPU the longest time in which a job's thread could have run, and the kernel ran neither it
  /// nor another XNode there; and how often its thread was seen with other CPUs or another scheduling policy
  /// than the run gave it.
  std::atomic<std::int64_t> waited_ns{};
  std::atomic<std::uint32_t> moved{};
  /// The latter in words; empty: it was not.
  [[nodiscard]] std::string words_of_moved() const;
  /// [M] before the run: Ordered; the policy's priority or first key in us, and how many keys it has.
  std::atomic<std::uint32_t> ordered{}, keys{};
  std::atomic<std::int64_t> planned{};
  /// [S], and any process: likewise, as people ask; and how often they did.
  static constexpr std::int64_t kAsPlanned = INT64_MIN;
  std::atomic<std::int64_t> asked{kAsPlanned};
  std::atomic<std::uint32_t> asked_times{};
  /// In words; empty: nobody did.
  [[nodiscard]] std::string words_of_asked() const;
  /// With tables: jobs past Limits::wcet_ns since the hub last looked, and as seen_job the longest.
  std::atomic<std::uint64_t> past_jobs{}, past_job{};
  static constexpr int kTableBits = 8;
  static constexpr std::uint64_t word(std::int64_t ns, std::uint32_t table) {
    return static_cast<std::uint64_t>(ns) << kTableBits | table;
  }
  static constexpr std::size_t table_of(std::uint64_t word) {
    return static_cast<std::size_t>(word & ((1U << kTableBits) - 1));
  }
  static constexpr std::int64_t ns_of(std::uint64_t word) {
    return static_cast<std::int64_t>(word >> kTableBits);
  }
  void saw(std::int64_t ns, std::uint32_t table) { keep_largest(seen_job, word(ns, table)); }
  void past(std::int64_t ns, std::uint32_t table) {
    keep_largest(past_job, word(ns, table));
    past_jobs.fetch_add(1);
  }
  /// One of `unended` is over, as a job that is counted: nobody sees it missing in between.
  void ended() {
    if (unended.fetch_sub(1) == 1) unended_ns.store(0);
  }
  void over(std::uint64_t more, std::int64_t by_ns) {
    over_wcet.fetch_add(more, std::memory_order_relaxed);
    keep_largest(over_ns, by_ns);
  }
};

/// A scenario of a run with tables.
struct alignas(64) ScenarioLine {
  char name[kBoardNameBytes] = {}, table[kBoardNameBytes] = {};  ///< [H] before the run
  std::atomic<std::uint64_t> releases{};                         ///< [H]
};

/// An XPU of the platform, by the jobs that ran there.
struct alignas(64) XpuLine {
  char name[kBoardNameBytes] = {};  ///< [H] before the run; empty: another host has it
  // [M], by the workers of all processes:
  std::atomic<std::uint64_t> suspensions{};  ///< of queues, by the backend
  /// Of the backend's calls that suspended and resumed one.
  std::atomic<std::int64_t> longest_suspend_ns{}, longest_resume_ns{};
  /// [H] before the run: what the platform says that both cost. -1: nobody asks, since it is emulated,
  /// or a core, whose threads are not suspended by calls that a policy counts with.
  std::int64_t preempt_us = -1;
  /// How they took longer than that; empty: they did not.
  [[nodiscard]] std::string slow_suspensions() const;
  JobsAbove above;  ///< where it preempts by levels
  /// For how long jobs that ended had it, less what they were suspended for, or below others. On a real CPU, which the
  /// kernel takes away unseen, the CPU time of the threads that run jobs, told when they sleep.
  std::atomic<std::int64_t> busy_ns{};
  /// On a real core: jobs that kept to their WCETs, and would not have with what others than this run's jobs took of
  /// the core meanwhile; the most that these took of one; and who was seen there.
  std::atomic<std::uint64_t> crowded{};
  std::atomic<std::int64_t> crowded_ns{};
  /// Where other runs are `admitted` it counts only once a stranger has been seen: what others had is not
  /// known to the microsecond.
  std::atomic<std::uint64_t> suspected{};
  std::atomic<std::int64_t> suspected_ns{};
  void crowd(std::int64_t others_ns, bool admitted) {
    (admitted ? suspected : crowded).fetch_add(1, std::memory_order_relaxed);
    keep_largest(admitted ? suspected_ns : crowded_ns, others_ns);
  }
  /// [H] of another run that has it, too. As `crowd_by` written once, and then told.
  char shared_with[kBoardNameBytes] = {}, crowd_by[kBoardNameBytes] = {};
  std::atomic<std::uint32_t> shared{}, crowd_told{};
  void tell_shared(const std::string& with);
  void tell_crowd(const std::string& by);
  /// In words; empty: nobody else had it.
  [[nodiscard]] std::string words_of_sharing() const;
  [[nodiscard]] std::string words_of_crowd() const;
};

/// What this host's part reads of an XNode of another host (parts/crossing_reader.h).
struct alignas(64) CrossingLine {
  char xnode[kBoardNameBytes] = {};  ///< [H] before the run, as all up to `messages`
  char from[kBoardNameBytes] = {}, to[kBoardNameBytes] = {};  ///< hosts
  std::int64_t x_us = 0;
  std::atomic<std::uint64_t> messages{};   ///< [H] that were here by their X
  std::atomic<std::uint64_t> lost{};       ///< [H] that were not
  std::atomic<std::uint64_t> late{};       ///< [H] of these: they came later
  std::atomic<std::int64_t> longest_ns{};  ///< [H] of those in time, from the sender's key
  std::atomic<std::int64_t> latest_ns{};   ///< [H] by how much one was too late
  /// In words; empty: none was lost.
  [[nodiscard]] std::string words_of_lost() const;
};

struct alignas(64) ProcessLine {
  transport::Doorbell doorbell;
  std::atomic<std::uint32_t> stand_in{};  ///< [H] whose doorbell is rung instead: its own index, or
                                          ///< 0 while it is dead
  std::atomic<std::int64_t> watched_ns{};  ///< [M] when its watchdog last looked; 0: not yet
};

/// Into a line's name.
void name_line(char (&field)[kBoardNameBytes], const std::string& name);
/// Out of it, whatever its writer left there; UTF-8.
[[nodiscard]] std::string line_name(const char (&field)[kBoardNameBytes]);

class Board {
 public:
  /// In this process only.
  [[nodiscard]] static std::shared_ptr<Board> local(const BoardShape& shape);
  /// In the empty memfd `fd`; in a new one that is left there if there is none.
  [[nodiscard]] static Result<std::shared_ptr<Board>> create(const BoardShape& shape, UniqueFd& fd);
  [[nodiscard]] static Result<std::shared_ptr<Board>> map(int fd, const BoardShape& shape);
  /// To look at only, of an app that may do with its memory what it likes. kUnavailable: the app
  /// has not got as far as open_to_observers().
  [[nodiscard]] static Result<std::shared_ptr<const Board>> observe(int fd);
  /// The same by whoever may write [S]. `fd` is open for writing.
  [[nodiscard]] static Result<std::shared_ptr<Board>> steer(int fd);
  ~Board();
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  ModuleLine& module(int index) { return modules_[index]; }
  [[nodiscard]] const ModuleLine& module(int index) const { return modules_[index]; }
  FlowLine& flow(std::size_t index) { return flows_[index]; }
  [[nodiscard]] const FlowLine& flow(std::size_t index) const { return flows_[index]; }
  [[nodiscard]] const BoardShape& shape() const { return shape_; }
  [[nodiscard]] std::uint64_t released() const { return header_->released.load(); }
  void count_release() { header_->released.fetch_add(1, std::memory_order_relaxed); }
  /// By one thread, which releases.
  void count_late(std::int64_t ns, bool early = false);
  [[nodiscard]] std::uint64_t late() const { return header_->late.load(); }
  [[nodiscard]] std::int64_t latest_ns() const { return header_->latest_ns.load(); }
  void tell_unkept(const std::string& text);
  [[nodiscard]] std::string unkept() const;
  /// [H] All that is there "before the run" has been written: whoever observes may look.
  void open_to_observers() { header_->told.store(1, std::memory_order_release); }
  [[nodiscard]] ContextCounts& contexts() { return header_->contexts; }
  [[nodiscard]] const ContextCounts& contexts() const { return header_->contexts; }
  XNodeLine& xnode(std::size_t node) { return xnodes_[node]; }
  [[nodiscard]] const XNodeLine& xnode(std::size_t node) const { return xnodes_[node]; }
  ParameterLine& parameter(std::size_t index) { return parameters_[index]; }
  [[nodiscard]] const ParameterLine& parameter(std::size_t index) const {
    return parameters_[index];
  }
  ScenarioLine& scenario(std::size_t index) { return scenarios_[index]; }
  [[nodiscard]] const ScenarioLine& scenario(std::size_t index) const { return scenarios_[index]; }
  XpuLine& xpu(std::size_t index) { return xpus_[index]; }
  [[nodiscard]] const XpuLine& xpu(std::size_t index) const { return xpus_[index]; }
  CrossingLine& crossing(std::size_t index) { return crossings_[index]; }
  [[nodiscard]] const CrossingLine& crossing(std::size_t index) const { return crossings_[index]; }
  [[nodiscard]] BoardHeader& header() { return *header_; }
  [[nodiscard]] const BoardHeader& header() const { return *header_; }
  /// Which one a release has; known from before it is published on.
  [[nodiscard]] std::uint32_t table_of(std::uint64_t release) const {
    std::uint64_t word = header_->in_force.load();
    if (release < first_release(word)) word = header_->before.load();
    // Whoever puts a new one moves these on from the last one on, so none is missed.
    for (std::size_t k = 0; release < first_release(word) && k < std::size(header_->older); ++k)
      word = header_->older[k].load();
    return table_in(word);
  }
  /// [H] From `release` on that table.
  void put_table(std::uint64_t release, std::uint32_t table) {
    for (std::size_t k = std::size(header_->older) - 1; k > 0; --k)
      header_->older[k].store(header_->older[k - 1].load());
    header_->older[0].store(header_->before.load());
    header_->before.store(header_->in_force.load());
    header_->in_force.store(in_force(release, table));
  }
  ProcessLine& process(int index) { return processes_[index]; }
  [[nodiscard]] int processes() const { return static_cast<int>(shape_.processes); }
  [[nodiscard]] std::uint64_t settled() const;
  /// Some module has an activation in flight.
  [[nodiscard]] bool busy() const;
  /// Rings whoever reads the queues of `process` now.
  void ring(int process) {
    const std::uint32_t at = processes_[process].stand_in.load(std::memory_order_acquire);
    processes_[at < shape_.processes ? at : 0].doorbell.ring();
  }

 private:
  Board(void* memory, std::size_t bytes, bool mapped, const BoardShape& shape);
  [[nodiscard]] static Result<std::shared_ptr<Board>> look(int fd, int protection);
  void* memory_;
  std::size_t bytes_;
  bool mapped_;
  BoardShape shape_;  ///< as checked: the header may change under us
  BoardHeader* header_;
  ProcessLine* processes_;
  ModuleLine* modules_;
  XNodeLine* xnodes_;
  FlowLine* flows_;
  ParameterLine* parameters_;
  ScenarioLine* scenarios_;
  XpuLine* xpus_;
  CrossingLine* crossings_;
};

/// Rings the readers of one topic.
class BoardRinger final : public transport::Ringer {
 public:
  BoardRinger(std::shared_ptr<Board> board, std::vector<int> readers)
      : board_(std::move(board)), readers_(std::move(readers)) {}
  void ring(std::uint32_t subscriber) override { board_->ring(readers_[subscriber]); }

 private:
  std::shared_ptr<Board> board_;
  std::vector<int> readers_;
};

}  // namespace xauto::runtime
