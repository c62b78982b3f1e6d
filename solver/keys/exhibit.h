// SPDX-License-Identifier: Apache-2.0
// Exhibit: the schedule that keys give to one domain, simulated until a hyperperiod repeats the one
// before. Its finishes are keys (docs/keys.md, theorem); certificate.h proves them again.
//
// The rule: an XPU runs the ready job of the smallest key. As long as fewer jobs have started and not
// ended than it has levels (one, where it does not preempt), a job that is not `polite` interrupts one of
// a larger key. A job that starts while another one is interrupted takes `cost` more. Every XNode takes its `work`; roots are ready at their latest arrival. A job is
// seen to be done at a whole microsecond after its nominal release, since keys are whole.
// On an XPU that several domains share, a job takes its `window`, whoever else is there: the demand
// bound decides whether the XPU can serve all of them.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "solver/keys/problem.h"
#include "solver/until.h"

namespace xauto::solver::keys {

/// What a schedule follows; all arrays are of the whole problem.
struct Rule {
  std::vector<int> xpu;      ///< [xnode]
  std::vector<Tick> work;    ///< [xnode] on its XPU, at least 1
  std::vector<Tick> window;  ///< [xnode] on a shared XPU; kNoTick: simulated
  std::vector<Tick> delay;   ///< [xnode] from its end on its XPU until it is called done
  std::vector<Tick> cost;    ///< [xpu] of a start while another one is interrupted
  std::vector<char> polite;  ///< [xnode] it interrupts nobody
  std::vector<Tick> hold;    ///< [slot] earliest start after the nominal release; 0: none
  std::vector<Tick> key;     ///< [slot] after the nominal release
  /// [xnode] an end later than this is of no use: it ends the simulation. Empty: none.
  std::vector<Tick> limit;
};

/// By slot, after the nominal release. Only the slots of the domain are written.
struct Schedule {
  std::vector<Tick> start, finish;  ///< finish: with delay, rounded up to a microsecond
};

/// Simulates again and again without allocating.
class Exhibitor {
 public:
  /// What a run needs only while it lasts, as large as the largest domain needs it: for several
  /// exhibitors that take turns.
  struct Scratch {
    std::vector<std::int16_t> waits;        ///< [place] things that it waits for
    std::vector<Tick> left, start, finish;  ///< [place] of a job
    std::vector<std::int64_t> in_module;    ///< [module offset + activation] XNodes not yet done
  };
  Exhibitor(const Problem& problem, std::shared_ptr<Scratch> scratch)
      : p_(problem),
        scratch_(std::move(scratch)),
        waits_(scratch_->waits),
        left_(scratch_->left),
        start_(scratch_->start),
        finish_(scratch_->finish),
        in_module_(scratch_->in_module) {}

  /// False: it did not repeat within the limits, or `until` was over. `schedule` is large enough.
  [[nodiscard]] bool run(int domain, const Rule& rule, Schedule& schedule, const Until& until = {});
  /// After a run that failed: by how many hyperperiods the last of them ended later than the one
  /// before, all XNodes together; 0 where it has not come so far.
  [[nodiscard]] double growth() const { return growth_ > 0 ? growth_ : 0; }

 private:
  struct Event {
    Tick time;
    /// 4 job: one thing less to wait for; 4 job + 1: it is done; 4 job + 2: its timer.
    std::int64_t code;
    bool operator>(const Event& o) const { return time != o.time ? time > o.time : code > o.code; }
  };
  struct Ready {
    Tick key;
    std::int64_t job;
    bool operator>(const Ready& o) const { return key != o.key ? key > o.key : job > o.job; }
  };
  struct Known {
    Tick nominal;  ///< release within a hyperperiod
    int xnode;
    int number;  ///< of the activation there
  };
  struct Xpu {
    std::vector<Ready> ready;  ///< a heap, smallest key on top
    Ready running = {0, -1};
    Tick end = 0;         ///< of the running job, undisturbed
    int interrupted = 0;  ///< started, and among the ready
  };

  void prepare(int domain, const Rule& rule);
  void prepare_rounds(const Rule& rule, std::int64_t up_to);
  bool release(const Rule& rule, int xnode);
  void one_less(const Rule& rule, std::int64_t job, Tick now);
  [[nodiscard]] Tick seen(std::int64_t job, Tick end) const;
  void done(const Rule& rule, std::int64_t job, Tick now);
  void dispatch(const Rule& rule, int xpu, Tick now);
  [[nodiscard]] bool repeats(std::int64_t round);
  [[nodiscard]] bool piles_up(std::int64_t round);
  void push(Tick time, std::int64_t code);
  /// A job is its round, and its place in that: no division takes it apart.
  [[nodiscard]] static std::int64_t job_of(std::int64_t round, std::int64_t in_round) {
    return (round << 32) + in_round;
  }
  [[nodiscard]] static std::int64_t round_of(std::int64_t job) { return job >> 32; }
  [[nodiscard]] static std::int64_t in_round(std::int64_t job) { return job & 0xffffffff; }
  [[nodiscard]] std::size_t place(std::int64_t job) const {
    return static_cast<std::size_t>(round_of(job) * jobs_ + in_round(job));
  }
  [[nodiscard]] const Known& known(std::int64_t job) const {
    return known_[static_cast<std::size_t>(in_round(job))];
  }
  [[nodiscard]] Tick nominal(std::int64_t job) const {
    return round_of(job) * hyper_ + known(job).nominal;
  }

  const Problem& p_;
  int domain_ = -1;
  Tick hyper_ = 0;
  int base_ = 0;           ///< first slot of the domain: its slots are contiguous
  std::int64_t jobs_ = 0;  ///< per hyperperiod
  std::int64_t rounds_ = 0, prepared_ = 0, equal_ = 0;
  bool useless_ = false;
  std::vector<Known> known_;               ///< [slot - base]
  std::vector<Event> events_;              ///< a heap, earliest on top
  std::vector<std::int64_t> next_;         ///< [xnode] the next activation that its timer releases
  std::vector<std::int16_t> first_waits_;  ///< [slot - base]
  std::shared_ptr<Scratch> scratch_;
  std::vector<std::int16_t>& waits_;
  std::vector<Tick>&left_, &start_, &finish_;
  std::vector<std::int64_t>& in_module_;
  std::vector<std::int64_t> module_base_;
  std::vector<std::int64_t> done_;  ///< [round]
  std::vector<Xpu> xpus_;
  std::vector<int> used_, dirty_;
  double growth_ = 0;
  int grew_ = 0;  ///< rounds in a row
};

}  // namespace xauto::solver::keys
