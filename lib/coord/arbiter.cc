// SPDX-License-Identifier: Apache-2.0
#include "coord/arbiter.h"

#include <algorithm>

#include "base/check.h"

namespace xauto::coord {

Arbiter::Arbiter(Discipline discipline, const OrderPairs& order, int levels)
    : discipline_(discipline), levels_(levels), order_(order) {
  XAUTO_CHECK(discipline != Discipline::kLevels || levels >= 2);
  for (const std::uint32_t u : order_.predecessors())
    if (finished_.size() <= u) finished_.resize(std::size_t{u} + 1);
}

bool Arbiter::eligible(const Job& job) const {
  return order_.eligible(job.xnode, job.sequence, [&](std::uint32_t u) { return finished_[u]; });
}

int Arbiter::most_urgent() const {
  Next next;
  for (int i = 0; i < high(); ++i) {
    const Slot& s = slot(i);
    if (s.phase == Phase::kNone) continue;
    if (s.phase == Phase::kWaiting && !eligible(s.job)) continue;
    next.consider({s.job.key, s.job.since_ns, i});
  }
  return next.slot();
}

bool Arbiter::idle() const {
  return std::all_of(slots_.begin(), slots_.end(), [](const Slot& s) {
    return s.phase == Phase::kNone && s.queue == Queue::kEnabled;
  });
}

int Arbiter::admitted() const {
  for (int i = 0; i < high(); ++i)
    if (slot(i).phase == Phase::kAdmitted) return i;
  return -1;
}

bool Arbiter::settled() const {
  const int owner = admitted();
  for (int i = 0; i < high(); ++i) {
    const Slot& s = slot(i);
    if (s.phase == Phase::kAdmitted && i != owner && discipline_ != Discipline::kKernel)
      return false;
    if (s.queue != Queue::kEnabled && !(i == owner && s.queue == Queue::kResuming)) return false;
    // Whoever finishes hands over, to who waits for it as well; without an owner nobody would.
    if (s.phase == Phase::kWaiting && owner < 0 && eligible(s.job)) return false;
  }
  return true;
}

bool Arbiter::needs_acks() const {
  const int top = most_urgent();
  for (int i = 0; i < high(); ++i) {
    const Slot& s = slot(i);
    const bool admitted = s.phase == Phase::kAdmitted;
    if (s.queue == Queue::kSuspending && (!admitted || i == top)) return true;
    if (s.queue == Queue::kResuming && (admitted ? i != top : i == top)) return true;
  }
  return false;
}

void Arbiter::end_batch(std::vector<Action>& out) {
  in_batch_ = false;
  decide(out);
}

void Arbiter::restore(int slot, const Slot& state) {
  at(slot) = state;
}

void Arbiter::start(int slot, const Job& job, std::vector<Action>& out) {
  Slot& s = at(slot);
  XAUTO_CHECK(s.phase == Phase::kNone);
  s.phase = Phase::kWaiting;
  s.job = job;
  decide(out);
}

void Arbiter::adopt(int slot, const Job& job, std::vector<Action>& out, int level) {
  Slot& s = at(slot);
  XAUTO_CHECK(s.phase != Phase::kAdmitted);
  s.phase = Phase::kAdmitted;
  s.level = level;
  s.job = job;
  decide(out);
}

void Arbiter::finish(int slot, std::vector<Action>& out) {
  Slot& s = at(slot);
  XAUTO_CHECK(s.phase != Phase::kNone);
  s.phase = Phase::kNone;
  s.refuses = false;
  if (s.job.xnode < finished_.size())
    finished_[s.job.xnode] = std::max(finished_[s.job.xnode], s.job.sequence + 1);
  decide(out);
}

void Arbiter::lend(int slot, Key key, std::vector<Action>& out) {
  Slot& s = at(slot);
  XAUTO_CHECK(s.phase != Phase::kNone);
  s.job.key = std::min(s.job.key, key);
  decide(out);
}

void Arbiter::suspended(int slot, bool succeeded, std::vector<Action>& out) {
  Slot& s = at(slot);
  XAUTO_CHECK(s.queue == Queue::kSuspending);
  s.queue = succeeded ? Queue::kSuspended : Queue::kEnabled;
  s.refuses = !succeeded && s.phase != Phase::kNone;
  decide(out);
}

void Arbiter::resumed(int slot, std::vector<Action>& out) {
  Slot& s = at(slot);
  XAUTO_CHECK(s.queue == Queue::kResuming);
  s.queue = Queue::kEnabled;
  decide(out);
}

void Arbiter::gone(int slot, std::vector<Action>& out) {
  at(slot) = Slot{};
  decide(out);
}

void Arbiter::finished(std::uint32_t xnode, std::uint64_t count, std::vector<Action>& out) {
  if (xnode >= finished_.size() || finished_[xnode] >= count) return;
  finished_[xnode] = count;
  decide(out);
}

void Arbiter::decide(std::vector<Action>& out) {
  if (in_batch_) return;
  const auto grant = [&](int slot, int level = 0) {
    at(slot).phase = Phase::kAdmitted;
    at(slot).level = level;
    out.push_back({Action::Kind::kGrant, slot, level});
  };

  const int top = most_urgent();
  switch (discipline_) {
    case Discipline::kKernel:
      for (int i = 0; i < high(); ++i)
        if (slot(i).phase == Phase::kWaiting && eligible(slot(i).job)) grant(i);
      return;

    case Discipline::kGate: {
      const bool taken = admitted() >= 0;
      if (!taken && top >= 0) grant(top);
      return;
    }

    case Discipline::kLevels: {
      int highest = -1;
      for (const Slot& s : slots_)
        if (s.phase == Phase::kAdmitted) highest = std::max(highest, s.level);
      if (top >= 0 && slot(top).phase == Phase::kWaiting && highest + 1 < levels_)
        grant(top, highest + 1);
      return;
    }

    case Discipline::kPreemptive:
      // Victims first: their suspension is what the most urgent job waits for on the XPU.
      for (int i = 0; i < high(); ++i) {
        Slot& s = at(i);
        const bool runs = s.phase == Phase::kAdmitted && s.queue == Queue::kEnabled;
        if (runs && i != top && !s.refuses) {
          s.queue = Queue::kSuspending;
          out.push_back({Action::Kind::kSuspend, i});
        }
        // A queue without an admitted job has nothing to be suspended for.
        const bool stranded = s.phase != Phase::kAdmitted && s.queue == Queue::kSuspended;
        const bool next = i == top && s.phase == Phase::kAdmitted && s.queue == Queue::kSuspended;
        if (stranded || next) {
          s.queue = Queue::kResuming;
          out.push_back({Action::Kind::kResume, i});
        }
      }
      if (top >= 0 && slot(top).phase == Phase::kWaiting && slot(top).queue == Queue::kEnabled)
        grant(top);
      return;
  }
}

}  // namespace xauto::coord
