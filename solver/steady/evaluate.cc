// SPDX-License-Identifier: Apache-2.0
#include "solver/steady/evaluate.h"

#include <algorithm>

#include "solver/steady/chains.h"

namespace xauto::solver::steady {
namespace {

/// Charges change windows, and windows charges; both only grow, and seldom more than twice.
constexpr int kMostTries = 12;

}  // namespace

bool Figures::better_than(const Figures& other) const {
  if (valid != other.valid) return valid;
  if (!valid) return cost < other.cost;
  if (late != other.late) return late < other.late;
  return sum < other.sum;
}

Evaluator::Evaluator(const Problem& problem, const std::vector<Tick>& reference)
    : p_(problem), reference_(reference) {
  for (std::size_t d = 0; d < p_.domains.size(); ++d) exhibitors_.emplace_back(p_);
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    deadlines_ = deadlines_ || p_.chains[c].deadline != kNoTick;
    reference_sum_ += static_cast<double>(p_.chains[c].weight) * static_cast<double>(reference_[c]);
  }
  reference_sum_ = std::max(reference_sum_, 1.0);
  for (const Chain& chain : p_.chains) {
    std::vector<char> in(at(p_.num_xnodes), 0);
    const auto add = [&](int to) {
      for (const int i : p_.components[at(p_.component_of[at(to)])].xnodes)
        if (i == to || p_.before(i, to)) in[at(i)] = 1;
    };
    for (const Path& path : chain.paths)
      for (const int s : path.samples) add(p_.samples[at(s)].first);
    add(chain.to);
    chain_xnodes_.emplace_back();
    for (int i = 0; i < p_.num_xnodes; ++i)
      if (in[at(i)] != 0) chain_xnodes_.back().push_back(i);
  }
  rule_.work.resize(at(p_.num_xnodes));
  rule_.delay.resize(at(p_.num_xnodes));
  now_.preempts.resize(at(p_.num_xnodes));
  now_.blocked_by.resize(at(p_.num_xnodes));
  pad_.resize(at(p_.num_xpus));
}

double Evaluator::overload(const Decision& decision) const {
  std::vector<double> load(at(p_.num_xpus), 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const int m = decision.xpu[at(i)];
    load[at(m)] += static_cast<double>(charged(p_, decision.xpu, used_, i)) /
                   static_cast<double>(p_.period_of(i));
  }
  double over = 0;
  for (const double l : load) over += std::max(0.0, l - 1.0);
  return over;
}

bool Evaluator::simulate(const Decision& decision, const Figures* keys, Charges& charges,
                         Figures& out, const Until& until) {
  out.w.a.resize(at(p_.num_slots));
  out.w.d.resize(at(p_.num_slots));
  out.w.hold.resize(at(p_.num_slots));
  out.schedule.start.resize(at(p_.num_slots));
  out.schedule.finish.resize(at(p_.num_slots));
  shared_ = shared_xpus(p_, decision.xpu);
  std::fill(pad_.begin(), pad_.end(), 0);
  rule_.xpu = decision.xpu;
  rule_.hold = decision.hold;
  rule_.key_by_slot = keys != nullptr;
  rule_.key = keys != nullptr ? keys->w.d : decision.key;
  for (int attempt = 0; attempt < kMostTries; ++attempt) {
    const double over = overload(decision);
    if (over > 1e-9) {
      out.cost = kInvalidCost * (3 + over);
      return false;
    }
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const int m = decision.xpu[at(i)], d = p_.domain_of(i);
      const std::int64_t ppm = p_.domains[at(d)].ppm;
      Tick work = in_fast_time(charged(p_, decision.xpu, charges, i), ppm);
      if (shared_[at(m)] != 0) {
        const int share = decision.share[at(m) * p_.domains.size() + at(d)];
        work = (work * kWhole + share - 1) / share;
      }
      rule_.work[at(i)] = work;
      rule_.delay[at(i)] = in_fast_time(charges.blocked_by[at(i)], ppm) + pad_[at(m)] +
                           (shared_[at(m)] != 0 ? decision.delay[at(i)] : 0);
    }
    for (std::size_t d = 0; d < p_.domains.size(); ++d)
      if (!exhibitors_[d].run(static_cast<int>(d), rule_, out.schedule, until)) {
        out.cost = 2 * kInvalidCost;
        return false;
      }
    std::copy(out.schedule.finish.begin(), out.schedule.finish.end(), out.w.d.begin());
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const bool holds = p_.reads[at(i)] != 0 || decision.hold[at(i)] > 0;
      for (int n = 0; n < p_.jobs[at(i)]; ++n) {
        const std::size_t s = at(p_.slot[at(i)] + n);
        out.w.hold[s] = holds ? out.schedule.start[s] / p_.scale * p_.scale : 0;
      }
    }
    for (std::size_t d = 0; d < p_.domains.size(); ++d)
      derive_ready(p_, static_cast<int>(d), decision.xpu, out.w);
    charge(p_, decision.xpu, out.w, -1, now_);
    out.needed = now_;
    bool grew = charges.include(now_);
    for (int m = 0; m < p_.num_xpus; ++m) {
      std::int64_t ppm = 0;
      Tick deepest = 0;
      for (const Domain& d : p_.domains) ppm = std::max(ppm, d.ppm);
      if (ppm == 0) continue;
      ppm = 0;
      for (int i = 0; i < p_.num_xnodes; ++i)
        if (decision.xpu[at(i)] == m) {
          ppm = std::max(ppm, p_.domains[at(p_.domain_of(i))].ppm);
          for (int n = 0; n < p_.jobs[at(i)]; ++n)
            deepest = std::max(deepest, out.w.d[at(p_.slot[at(i)] + n)]);
        }
      // What it adds makes windows deeper: a little more at once.
      if (drift_pad(deepest, ppm) > pad_[at(m)]) {
        pad_[at(m)] = drift_pad(deepest + deepest / 8, ppm);
        grew = true;
      }
    }
    if (grew) continue;
    // How much is missing leads the annealer to where nothing is.
    double missing = 0;
    for (int m = 0; m < p_.num_xpus; ++m) {
      if (shared_[at(m)] == 0) continue;
      Tightest t;
      if (shared_fits(p_, m, decision.xpu, out.w, out.needed, &t)) continue;
      missing += 0.01;
      if (t.demand > t.length)
        missing += static_cast<double>(t.demand - t.length) / static_cast<double>(t.demand);
      else
        missing += 1;
    }
    if (missing > 0) {
      out.cost = kInvalidCost * (1 + missing / (p_.num_xpus + 1));
      return false;
    }
    return true;
  }
  out.cost = 2 * kInvalidCost;
  return false;
}

void Evaluator::set_costs(Figures& out) const {
  out.chain.resize(p_.chains.size());
  out.late = out.sum = 0;
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    const Chain& chain = p_.chains[c];
    out.chain[c] = worst_case(p_, chain, out.w);
    const auto worst = static_cast<double>(out.chain[c]);
    out.sum += static_cast<double>(chain.weight) * worst;
    if (chain.deadline != kNoTick)
      out.late = std::max(out.late, worst / static_cast<double>(std::max(chain.deadline, Tick{1})));
  }
  out.cost = deadlines_ ? out.late + 0.02 * out.sum / reference_sum_ : out.sum / reference_sum_;
}

/// A chain takes at least as long as the jobs of its ways, from their release. By how much a
/// release may be before the chain's beginning is bounded by a period and the offsets; what is cut
/// off wrongly is an answer less, no wrong one.
void Evaluator::set_limits(double most) {
  if (most >= kInvalidCost) {
    rule_.limit.clear();
    return;
  }
  rule_.limit.assign(at(p_.num_xnodes), kMostTicks * 64);
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    const Chain& chain = p_.chains[c];
    const auto own = static_cast<double>(chain.weight) * static_cast<double>(reference_[c]);
    double longest = 0;
    if (chain.deadline != kNoTick)
      longest = most * static_cast<double>(chain.deadline);
    else if (!deadlines_ && chain.weight > 0)
      longest =
          (most * reference_sum_ - (reference_sum_ - own)) / static_cast<double>(chain.weight);
    else
      continue;
    if (longest >= static_cast<double>(kMostTicks)) continue;
    for (const int i : chain_xnodes_[c]) {
      Tick& limit = rule_.limit[at(i)];
      limit = std::min(limit, static_cast<Tick>(longest) + chain.offset + p_.period_of(i));
    }
  }
}

void Evaluator::evaluate(const Decision& decision, const Charges& charges, double most,
                         Figures& out, const Until& until) {
  ++evaluations_;
  set_limits(most);
  if (charges.preempts.empty()) {
    used_.preempts.assign(at(p_.num_xnodes), 0);
    used_.blocked_by.assign(at(p_.num_xnodes), 0);
  } else {
    used_ = charges;
  }
  out.valid = simulate(decision, nullptr, used_, out, until);
  if (out.valid) set_costs(out);
}

bool Evaluator::settle(const Decision& decision, Figures& out, bool worse_too, const Until& until) {
  ++evaluations_;
  rule_.limit.clear();
  Figures next;
  used_ = out.needed;
  next.valid = simulate(decision, &out, used_, next, until);
  if (!next.valid) return false;
  set_costs(next);
  if (!worse_too && !next.better_than(out)) return false;
  out = std::move(next);
  return true;
}

}  // namespace xauto::solver::steady
