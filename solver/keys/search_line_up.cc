// SPDX-License-Identifier: Apache-2.0
// The part of the search that moves whole components: who goes before whom when all release at once, and which readers
// wait for what they read. A plan takes a few ms where an evaluation takes tens, so it is asked first.
#include <algorithm>
#include <utility>

#include "solver/keys/search.h"

namespace xauto::solver::keys {
namespace {

// Chosen, not tuned.
/// Moves without a better line, for each component and sample, until it ends.
constexpr int kIdleMoves = 8;
/// Of moves: a reader waits, or no longer; the rest are of order.
constexpr double kWaitBelow = 0.2;
/// Of those of order, while the largest counts: whom it ends in, to before others; of the rest to a place near by.
constexpr double kLastBelow = 0.5;
constexpr double kNearBelow = 0.7;
constexpr int kNearPlaces = 6;
/// A line that is better by less than this part is certified only at the end.
constexpr double kWorthCertifying = 0.01;
/// How often readers are held anew, since what they read has moved.
constexpr int kMostHeld = 3;

}  // namespace

void Search::plan(Line& line) {
  line.planned = lines_->plan(line.order, line.hold, line.where);
}

/// As it was planned last.
void Search::decide(Line& line) const {
  Decision& d = line.candidate.decision;
  d.xpu = lines_->xpu();
  d.key = lines_->key();
  d.hold = line.hold;
  d.held.assign(at(p_.num_xnodes), 0);
  d.late.assign(at(p_.num_xnodes), 0);
  d.polite.assign(at(p_.num_xnodes), 0);
  for (int i = 0; i < p_.num_xnodes && !line.interrupts; ++i) {
    const std::size_t m = at(d.xpu[at(i)]);
    d.polite[at(i)] = p_.preempt[m] > 0 || p_.levels[m] != kAnyLevels ? 1 : 0;
  }
  spread_windows(d, 1);
}

void Search::evaluate(Line& line) {
  decide(line);
  evaluate(line.candidate);
  for (int k = 1; k < kMostHeld && line.candidate.figures.valid && !over(); ++k) {
    if (!hold_readers(line)) return;
    plan(line);
    decide(line);
    evaluate(line.candidate);
  }
}

/// Who waits begins when the activation that is released with it, or before, has ended. True: some hold has changed.
bool Search::hold_readers(Line& line) const {
  std::vector<Tick> hold(at(p_.num_xnodes), 0);
  for (std::size_t s = 0; s < p_.samples.size(); ++s) {
    if (line.waits[s] == 0) continue;
    const auto [u, v] = p_.samples[s];
    const Component &from = p_.components[at(p_.component_of[at(u)])],
                    &to = p_.components[at(p_.component_of[at(v)])];
    if (from.domain != to.domain) continue;
    for (std::int64_t n = 0; n < to.jobs; ++n) {
      const Tick release = to.phase + n * to.period;
      const std::int64_t m = floor_div(release - from.phase, from.period);
      const Tick end =
          from.phase + m * from.period + line.candidate.figures.w.d[p_.slot_of(u, m)] - release;
      if (end < to.period) hold[at(v)] = std::max(hold[at(v)], p_.up_to_us(std::max(Tick{0}, end)));
    }
  }
  if (hold == line.hold) return false;
  line.hold = std::move(hold);
  return true;
}

bool Search::plans_better(const LineUp::Value& a, const LineUp::Value& b) const {
  Figures one, other;
  one.valid = other.valid = true;
  one.largest = a.largest;
  one.sum = a.sum;
  other.largest = b.largest;
  other.sum = b.sum;
  return goal_.better(one, other);
}

/// Lines in which no XPU is shared are searched on.
void Search::line_up(const std::function<void(const Candidate&)>& on_better) {
  lines_ = std::make_unique<LineUp>(p_);
  std::vector<Decision> tried;
  const auto begin = [&](const std::vector<int>& order, const LineUp::Where& where,
                         bool interrupts) {
    if (over()) return;
    Line line;
    line.order = order;
    line.where = where;
    line.interrupts = interrupts;
    line.waits.assign(p_.samples.size(), 0);
    line.hold.assign(at(p_.num_xnodes), 0);
    plan(line);
    decide(line);
    const Decision& d = line.candidate.decision;
    if (std::any_of(tried.begin(), tried.end(), [&](const Decision& t) {
          return t.xpu == d.xpu && t.key == d.key && t.polite == d.polite;
        }))
      return;
    tried.push_back(d);
    const std::vector<char> shared = shared_xpus(p_, d.xpu);
    if (std::find(shared.begin(), shared.end(), 1) != shared.end()) {
      // Whoever shares an XPU takes its window.
      if (!interrupts) try_start(d, on_better);
      return;
    }
    evaluate(line);
    take(line.candidate, on_better);
    if (line.candidate.figures.valid &&
        (line_.order.empty() || goal_.better(line.candidate.figures, line_.candidate.figures)))
      line_ = std::move(line);
  };
  const bool costly =
      std::any_of(p_.preempt.begin(), p_.preempt.end(), [](Tick t) { return t > 0; }) ||
      std::any_of(p_.levels.begin(), p_.levels.end(), [](int l) { return l != kAnyLevels; });
  for (const bool apart : {true, false}) {
    if (apart && p_.domains.size() == 1) continue;
    for (const auto* order : {&lines_->by_weight(), &lines_->by_period()}) {
      begin(*order, {apart, false}, false);
      if (costly) begin(*order, {apart, false}, true);
      if (costly) begin(*order, {apart, true}, false);
    }
  }
}

bool Search::change_line(const Line& from, Line& next) {
  next.order = from.order;
  next.waits = from.waits;
  next.hold = from.hold;
  next.interrupts = from.interrupts;
  next.where = from.where;
  if (!p_.samples.empty() && random_.unit() < kWaitBelow) {
    const std::size_t s = random_.below(p_.samples.size());
    next.waits[s] = next.waits[s] == 0 ? 1 : 0;
    next.candidate.figures.w.d = from.candidate.figures.w.d;
    return hold_readers(next);
  }
  const std::size_t n = next.order.size();
  if (n < 2) return false;
  std::size_t a = random_.below(n), b = random_.below(n);
  if (from.planned.last >= 0 && (!goal_.sum || from.candidate.figures.largest > goal_.most()) &&
      random_.unit() < kLastBelow) {
    const auto last = std::find(next.order.begin(), next.order.end(), from.planned.last);
    a = static_cast<std::size_t>(last - next.order.begin());
    b = random_.below(a + 1);
  } else if (random_.unit() < kNearBelow) {
    const std::size_t by = 1 + random_.below(kNearPlaces);
    b = random_.unit() < 0.5 ? a - std::min(a, by) : std::min(n - 1, a + by);
  }
  if (a == b) return false;
  const int moved = next.order[a];
  next.order.erase(next.order.begin() + static_cast<std::ptrdiff_t>(a));
  next.order.insert(next.order.begin() + static_cast<std::ptrdiff_t>(b), moved);
  return true;
}

void Search::improve_line(const std::function<void(const Candidate&)>& on_better) {
  if (line_.order.empty()) return;
  plan(line_);
  line_.candidate.figures.cost = evaluator_.cost_of(line_.candidate.figures);
  double certified = line_.candidate.figures.cost;
  const std::int64_t most =
      kIdleMoves * static_cast<std::int64_t>(line_.order.size() + p_.samples.size());
  Line next;
  for (std::int64_t idle = 0; idle < most && !over() && (goal_.sum || !may_sum()); ++idle) {
    if (!change_line(line_, next)) continue;
    plan(next);
    if (next.waits == line_.waits && !plans_better(next.planned, line_.planned)) continue;
    evaluate(next);
    if (!goal_.better(next.candidate.figures, line_.candidate.figures)) continue;
    idle = 0;
    std::swap(line_, next);
    if (line_.candidate.figures.cost > (1 - kWorthCertifying) * certified) continue;
    certified = line_.candidate.figures.cost;
    Candidate copy = line_.candidate;
    take(copy, on_better);
  }
  Candidate copy = line_.candidate;
  take(copy, on_better);
}

}  // namespace xauto::solver::keys
