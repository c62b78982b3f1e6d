// SPDX-License-Identifier: Apache-2.0
// Every interleaving of a few workers and the arbiter: each worker brings its jobs in order;
// starting, finishing, acknowledging a command and (if asked) dying may happen in any order that
// the protocol allows. After each step the invariants of arbiter.h are checked, and where nothing
// can happen any more all jobs must be done. States that were met before are not entered again.
#pragma once

#include <deque>
#include <set>
#include <string>
#include <vector>

#include "coord/arbiter.h"

namespace xauto::coord::testing {

struct World {
  Discipline discipline = Discipline::kPreemptive;
  OrderPairs order;
  std::vector<std::vector<Job>> workers;  ///< [slot] its jobs, in order
  bool may_die = false;
  bool may_refuse = false;  ///< a suspension may fail
  int levels = 0;           ///< of kLevels
};

struct Explored {
  std::uint64_t states = 0, steps = 0;
  std::string violation;           ///< empty: none
  std::vector<std::string> trail;  ///< the steps that led to it
};

class Explorer {
 public:
  explicit Explorer(World world) : world_(std::move(world)) {}

  Explored run() {
    State initial{Arbiter(world_.discipline, world_.order, world_.levels), {}};
    initial.workers.resize(world_.workers.size());
    visit(initial);
    return std::move(result_);
  }

 private:
  struct Worker {
    std::size_t next = 0;  ///< job it is at
    bool started = false;  ///< START sent, FINISH not
    bool granted = false;
    bool dead = false;
    int command = 0;               ///< 0: none outstanding, 1: suspend, 2: resume
    bool queue_suspended = false;  ///< what the queue really is
  };
  struct State {
    Arbiter arbiter;
    std::vector<Worker> workers;
    std::uint64_t asked = 0;  ///< STARTs so far, which is their clock
  };

  void fail(const std::string& what) {
    if (!result_.violation.empty()) return;
    result_.violation = what;
    result_.trail = trail_;
  }

  /// What tells two states apart for the future: when who asked only by its order.
  std::string key(const State& s) const {
    std::string k;
    for (std::size_t i = 0; i < s.workers.size(); ++i) {
      const Worker& w = s.workers[i];
      const Arbiter::Slot& slot = s.arbiter.slot(static_cast<int>(i));
      int rank = 0;
      for (std::size_t j = 0; j < s.workers.size(); ++j) {
        const Arbiter::Slot& other = s.arbiter.slot(static_cast<int>(j));
        if (slot.phase != Phase::kNone && other.phase != Phase::kNone &&
            other.job.since_ns < slot.job.since_ns)
          ++rank;
      }
      for (const int part :
           {static_cast<int>(w.next), int{w.started}, int{w.granted}, int{w.dead}, w.command,
            int{w.queue_suspended}, static_cast<int>(slot.phase), static_cast<int>(slot.queue),
            int{slot.refuses}, rank, slot.phase == Phase::kAdmitted ? slot.level : 0})
        k += static_cast<char>('0' + part);
    }
    return k;
  }

  void carry_out(State& s, const std::vector<Action>& actions) {
    for (const Action& action : actions) {
      Worker& w = s.workers[static_cast<std::size_t>(action.slot)];
      if (w.dead) fail("action for a dead worker");
      switch (action.kind) {
        case Action::Kind::kGrant:
          if (!w.started || w.granted) fail("GRANT to a worker that did not ask");
          w.granted = true;
          break;
        case Action::Kind::kSuspend:
        case Action::Kind::kResume:
          if (w.command != 0) fail("a second command before the first one's ack");
          w.command = action.kind == Action::Kind::kSuspend ? 1 : 2;
          if (w.command == 1 && w.queue_suspended) fail("SUSPEND of what is suspended");
          if (w.command == 2 && !w.queue_suspended) fail("RESUME of what is not suspended");
          break;
      }
    }
  }

  void check(const State& s) {
    int admitted = 0;
    bool outstanding = false;
    for (std::size_t i = 0; i < s.workers.size(); ++i) {
      const Arbiter::Slot& slot = s.arbiter.slot(static_cast<int>(i));
      admitted += slot.phase == Phase::kAdmitted ? 1 : 0;
      outstanding |= s.workers[i].command != 0;
    }
    if (world_.discipline == Discipline::kGate && admitted > 1) fail("two owners of a gate");
    const int top = s.arbiter.most_urgent();
    if (world_.discipline == Discipline::kKernel) {
      for (std::size_t i = 0; i < s.workers.size(); ++i)
        if (s.arbiter.slot(static_cast<int>(i)).phase == Phase::kWaiting &&
            s.arbiter.eligible(s.arbiter.slot(static_cast<int>(i)).job))
          fail("an eligible job waits on a kernel-scheduled XPU");
      return;
    }
    if (world_.discipline == Discipline::kLevels) return check_levels(s, top);
    if (world_.discipline == Discipline::kGate) {
      if (top >= 0 && admitted == 0) fail("a gate stands idle");
      return;
    }
    if (outstanding) return;
    for (std::size_t i = 0; i < s.workers.size(); ++i) {
      const Arbiter::Slot& slot = s.arbiter.slot(static_cast<int>(i));
      const bool runs = s.workers[i].granted && !s.workers[i].queue_suspended;
      if (static_cast<int>(i) == top && !runs) fail("the most urgent job does not run");
      if (static_cast<int>(i) != top && runs && !slot.refuses) fail("a less urgent job runs");
      if (s.workers[i].queue_suspended && slot.phase != Phase::kAdmitted)
        fail("a queue is suspended for nobody");
    }
  }

  void check_levels(const State& s, int top) {
    int highest = -1;
    for (std::size_t i = 0; i < s.workers.size(); ++i) {
      const Arbiter::Slot& a = s.arbiter.slot(static_cast<int>(i));
      if (a.phase != Phase::kAdmitted) continue;
      highest = std::max(highest, a.level);
      for (std::size_t j = 0; j < s.workers.size(); ++j) {
        const Arbiter::Slot& b = s.arbiter.slot(static_cast<int>(j));
        if (j == i || b.phase != Phase::kAdmitted) continue;
        const bool before = more_urgent({a.job.key, a.job.since_ns, static_cast<int>(i)},
                                        {b.job.key, b.job.since_ns, static_cast<int>(j)});
        if (before ? a.level <= b.level : a.level >= b.level)
          fail("the hardware prefers the less urgent job");
      }
    }
    if (highest >= world_.levels) fail("a level that the hardware lacks");
    if (top >= 0 && s.arbiter.slot(top).phase == Phase::kWaiting && highest + 1 < world_.levels)
      fail("the most urgent job waits although there is a level for it");
  }

  template <class Apply>
  void step(const State& from, const std::string& name, Apply apply) {
    State to = from;
    std::vector<Action> actions;
    ++result_.steps;
    trail_.push_back(name);
    apply(to, actions);
    carry_out(to, actions);
    check(to);
    visit(to);
    trail_.pop_back();
  }

  void visit(const State& s) {
    if (!result_.violation.empty() || !seen_.insert(key(s)).second) return;
    ++result_.states;
    bool moved = false;
    for (std::size_t i = 0; i < s.workers.size(); ++i) {
      const Worker& w = s.workers[i];
      const int slot = static_cast<int>(i);
      const std::string who = "worker " + std::to_string(i);
      if (w.dead) continue;
      if (!w.started && w.next < world_.workers[i].size()) {
        moved = true;
        step(s, who + " starts", [&](State& to, std::vector<Action>& out) {
          to.workers[i].started = true;
          Job job = world_.workers[i][w.next];
          job.since_ns = ++to.asked;
          to.arbiter.start(slot, job, out);
        });
      }
      // A job whose queue is suspended makes no progress; one being suspended may still come to its
      // end.
      if (w.granted && !w.queue_suspended) {
        moved = true;
        step(s, who + " finishes", [&](State& to, std::vector<Action>& out) {
          to.workers[i].started = to.workers[i].granted = false;
          ++to.workers[i].next;
          to.arbiter.finish(slot, out);
        });
      }
      if (w.command != 0) {
        moved = true;
        step(s, who + " acknowledges", [&](State& to, std::vector<Action>& out) {
          to.workers[i].command = 0;
          to.workers[i].queue_suspended = w.command == 1;
          if (w.command == 1)
            to.arbiter.suspended(slot, true, out);
          else
            to.arbiter.resumed(slot, out);
        });
        if (w.command == 1 && world_.may_refuse)
          step(s, who + " refuses", [&](State& to, std::vector<Action>& out) {
            to.workers[i].command = 0;
            to.arbiter.suspended(slot, false, out);
          });
      }
      if (world_.may_die && (w.started || w.command != 0))
        step(s, who + " dies", [&](State& to, std::vector<Action>& out) {
          to.workers[i] = {};
          to.workers[i].dead = true;
          to.arbiter.gone(slot, out);
          // As the server does: nobody waits for a dead worker's XNodes.
          for (const Job& job : world_.workers[i]) to.arbiter.finished(job.xnode, UINT64_MAX, out);
        });
    }
    if (moved) return;
    for (std::size_t i = 0; i < s.workers.size(); ++i) {
      if (s.workers[i].dead) continue;
      if (s.workers[i].next < world_.workers[i].size())
        fail("a job is never run: nothing can happen any more");
      if (s.workers[i].queue_suspended) fail("a queue stays suspended");
    }
    if (!s.arbiter.idle()) fail("the arbiter is not idle at the end");
  }

  World world_;
  Explored result_;
  std::set<std::string> seen_;
  std::vector<std::string> trail_;
};

}  // namespace xauto::coord::testing
