// SPDX-License-Identifier: Apache-2.0
#include "bench/synthetic/emulate.h"

#include <algorithm>
#include <limits>
#include <map>

#include "base/index.h"
#include "coord/arbiter.h"
#include "emu/machine.h"

namespace xauto::bench {
namespace {

using coord::Action;
using coord::Arbiter;
using emu::Nanos;

Discipline discipline_of(const Xpu& xpu) {
  if (!xpu.preemptive) return Discipline::kGate;
  return xpu.levels > 0 ? Discipline::kLevels : Discipline::kPreemptive;
}

class Emulation {
 public:
  Emulation(const AppSpec& app, const Platform& platform, const PriorityPlan& policy,
            emu::Machine machine)
      : app_(app), platform_(platform), policy_(policy), machine_(std::move(machine)) {
    for (const Xpu& xpu : platform.xpus) {
      coord::OrderPairs order;
      for (const auto& [u, v] : policy.order)
        if (platform.xpus[at(policy.placements[at(u)].xpu)].id == xpu.id)
          order.emplace_back(static_cast<std::uint32_t>(u), static_cast<std::uint32_t>(v));
      arbiters_.emplace_back(discipline_of(xpu), order, xpu.levels);
    }
    members_.resize(platform.xpus.size());
    result_.finish_us.assign(app.xnodes.size(), -1);
    waits_for_.assign(app.xnodes.size(), 0);
    for (const auto& [u, v] : app.edges) ++waits_for_[at(v)];
  }

  Result<Emulated> run() {
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i) {
      const std::size_t x = at(policy_.placements[i].xpu);
      XAUTO_ASSIGN(const emu::ContextId context, machine_.open(platform_.xpus[x].id, 0));
      context_.push_back(context);
      xnode_of_[context] = static_cast<int>(i);
      slot_.push_back(static_cast<int>(members_[x].size()));
      members_[x].push_back(static_cast<int>(i));
      if (members_[x].size() > coord::kMaxSlots)
        return fail(ErrorCode::kUnavailable, "has more XNodes than a coordinator has slots",
                    platform_.xpus[x].id);
    }
    hold();
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i)
      if (waits_for_[i] == 0) start(static_cast<int>(i), 0);
    XAUTO_TRY(release(0));
    std::vector<emu::Event> events;
    for (Nanos now = 0; (now = std::max(now, machine_.next_event())) != kNever;) {
      // What has happened at this instant is known before anybody decides; a decision may make
      // more happen at once.
      for (events.clear(), machine_.advance(now, events); !events.empty();
           events.clear(), machine_.advance(now, events)) {
        hold();
        for (const emu::Event& event : events) happened(event, now);
        XAUTO_TRY(release(now));
      }
    }
    result_.latency_us = *std::max_element(result_.finish_us.begin(), result_.finish_us.end());
    if (*std::min_element(result_.finish_us.begin(), result_.finish_us.end()) < 0)
      return fail(ErrorCode::kInternal, "an XNode has not run", app_.name);
    return result_;
  }

 private:
  static constexpr Nanos kNever = std::numeric_limits<Nanos>::max();

  void hold() {
    for (Arbiter& arbiter : arbiters_) arbiter.begin_batch();
  }

  Status release(Nanos now) {
    std::vector<Action> actions;
    for (std::size_t x = 0; x < arbiters_.size(); ++x) {
      actions.clear();
      arbiters_[x].end_batch(actions);
      for (const Action& action : actions) {
        const std::size_t i = at(members_[x][at(action.slot)]);
        if (action.kind == Action::Kind::kSuspend) {
          XAUTO_TRY(machine_.suspend(context_[i], 0, now));
        } else if (action.kind == Action::Kind::kResume) {
          XAUTO_TRY(machine_.resume(context_[i], 0, now));
        } else {
          if (platform_.xpus[x].levels > 0)
            XAUTO_TRY(machine_.level(context_[i], action.level, now));
          const auto wcet = app_.xnodes[i].wcet_on(platform_.xpus[x].type);
          XAUTO_TRY(machine_.submit(context_[i], i, *wcet * 1000, now));
        }
      }
    }
    return {};
  }

  void start(int i, Nanos now) {
    const PriorityPlacement& placed = policy_.placements[at(i)];
    arbiters_[at(placed.xpu)].start(slot_[at(i)],
                                    {.xnode = static_cast<std::uint32_t>(i),
                                     .key = coord::key_of_priority(placed.priority),
                                     .since_ns = static_cast<std::uint64_t>(now)},
                                    none_);
  }

  void happened(const emu::Event& event, Nanos now) {
    const int i = xnode_of_.at(event.context);
    Arbiter& arbiter = arbiters_[at(policy_.placements[at(i)].xpu)];
    if (event.kind == emu::Event::Kind::kSuspended) {
      arbiter.suspended(slot_[at(i)], true, none_);
    } else if (event.kind == emu::Event::Kind::kResumed) {
      arbiter.resumed(slot_[at(i)], none_);
    } else {
      result_.finish_us[at(i)] = (event.time + 999) / 1000;
      arbiter.finish(slot_[at(i)], none_);
      for (const auto& [u, v] : app_.edges)
        if (u == i && --waits_for_[at(v)] == 0) start(v, now);
    }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const PriorityPlan& policy_;
  emu::Machine machine_;
  std::vector<Arbiter> arbiters_;          ///< [xpu]
  std::vector<std::vector<int>> members_;  ///< [xpu][slot]
  std::vector<int> slot_;
  std::vector<emu::ContextId> context_;
  std::map<emu::ContextId, int> xnode_of_;
  std::vector<int> waits_for_;
  std::vector<Action> none_;  ///< nothing is decided within a batch
  Emulated result_;
};

}  // namespace

Result<Emulated> emulate(const AppSpec& app, const Platform& platform, const PriorityPlan& policy) {
  XAUTO_ASSIGN(emu::Machine machine, emu::Machine::create(platform));
  return Emulation(app, platform, policy, std::move(machine)).run();
}

}  // namespace xauto::bench
