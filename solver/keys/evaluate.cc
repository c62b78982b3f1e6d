// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/evaluate.h"

#include <algorithm>

#include "solver/keys/chains.h"
#include "solver/keys/contention.h"

namespace xauto::solver::keys {
namespace {

// None of these is tuned: chosen, or as large as a comment says.

/// What drift takes makes windows deeper, and deeper windows lose more: seldom more than twice.
constexpr int kMostTries = 12;
/// ... so its pad is for windows that are deeper by this part of them.
constexpr Tick kPartOfDepth = 8;
/// Rounds in which those who meet somebody take longer, before everybody takes the longest. Seldom more than three.
constexpr int kMostCounts = 12;
/// Releases of ways that are followed before the time is looked at.
constexpr std::size_t kStepsAtOnce = 1 << 16;
/// Overload that is rounding.
constexpr double kRounding = 1e-9;

// The annealer's costs. Where the largest is minimised, the sum counts so much beside it.
constexpr double kSumBesideLargest = 0.02;
/// Where the sum is, what a largest above its limit costs at least, and what for each time the limit: else the
/// annealer would not find its way back. Chosen.
constexpr double kAboveLimit = 0.02, kAboveLimitTimes = 5;
/// In kInvalidCost, so that each kind of invalid costs more than the one before, whatever is added
/// for how invalid it is: a shared XPU does not serve its windows, no schedule that repeats was
/// found, an XPU is overloaded.
constexpr double kUnserved = 1, kEndless = 2, kOverloaded = 3;
/// At least so much is missing where a shared XPU does not serve, however little it is.
constexpr double kLeastMissing = 0.01;
/// Added for a backlog that grows, at most, as a part of kEndless.
constexpr double kGrowthShare = 0.25;

/// Releases that a way is followed from.
std::size_t steps_of(const Problem& p, const Path& path) {
  std::size_t steps = 1;
  for (const int s : path.samples) steps += at(p.jobs[at(p.samples[at(s)].second)]);
  return steps;
}

}  // namespace

bool Goal::better(const Figures& a, const Figures& b) const {
  if (a.valid != b.valid) return a.valid;
  if (!a.valid) return a.cost < b.cost;
  if (in_time && (a.largest <= 1) != (b.largest <= 1)) return a.largest <= 1;
  const bool within = a.largest <= most();
  if (sum && within != (b.largest <= most())) return within;
  if (sum && within && a.sum != b.sum) return a.sum < b.sum;
  if (a.largest != b.largest) return a.largest < b.largest;
  return a.sum < b.sum;
}

Evaluator::Evaluator(const Problem& problem, const std::vector<Tick>& reference)
    : counted_(problem.contended ? std::make_unique<Problem>(problem) : nullptr),
      p_(counted_ != nullptr ? *counted_ : problem),
      reference_(reference) {
  const auto scratch = std::make_shared<Exhibitor::Scratch>();
  for (std::size_t d = 0; d < p_.domains.size(); ++d) exhibitors_.emplace_back(p_, scratch);
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    const Chain& chain = p_.chains[c];
    const double part = static_cast<double>(reference_[c]) / static_cast<double>(chain.by);
    reference_sum_ += static_cast<double>(chain.weight) * part;
    if (is_counted(p_, chain)) reference_largest_ = std::max(reference_largest_, part);
  }
  // Of no chain, or of weights of 0.
  if (reference_sum_ <= 0) reference_sum_ = 1;
  // A part of a deadline is near 1 by itself.
  if (reference_largest_ <= 0 || p_.deadlines) reference_largest_ = 1;
  for (const Chain& chain : p_.chains) {
    std::vector<int>& on_it = chain_xnodes_.emplace_back();
    const auto add = [&](int to) {
      for (const int i : p_.components[at(p_.component_of[at(to)])].xnodes)
        if (i == to || p_.before(i, to)) on_it.push_back(i);
    };
    for (const Path& path : chain.paths)
      for (const int s : path.samples) add(p_.samples[at(s)].first);
    add(chain.to);
    std::sort(on_it.begin(), on_it.end());
    on_it.erase(std::unique(on_it.begin(), on_it.end()), on_it.end());
  }
  rigid_.assign(at(p_.num_xnodes), 0);
  for (int i = 0; i < p_.num_xnodes; ++i)
    rigid_[at(i)] = p_.urgent[at(i)] != 0 &&
                    (p_.root[at(i)] != 0 ||
                     std::any_of(p_.pred[at(i)].begin(), p_.pred[at(i)].end(),
                                 [&](const EdgeEnd& l) { return p_.urgent[at(l.xnode)] == 0; }));
  feeds_.resize(at(p_.num_xnodes));
  for (int v = 0; v < p_.num_xnodes; ++v) {
    if (p_.reads[at(v)] == 0) continue;
    const auto hears = [&](int i) { return i == v || p_.before(v, i); };
    bool ends = std::any_of(p_.chains.begin(), p_.chains.end(),
                            [&](const Chain& chain) { return hears(chain.to); });
    for (const auto& [u, r] : p_.samples) {
      if (!hears(u)) continue;
      ends = ends || p_.domain_of(r) != p_.domain_of(v);
      feeds_[at(v)].emplace_back(u, r);
    }
    if (ends) feeds_[at(v)].clear();
  }
  rule_.work.resize(at(p_.num_xnodes));
  rule_.delay.resize(at(p_.num_xnodes));
  rule_.cost.resize(at(p_.num_xpus));
  rule_.window.resize(at(p_.num_xnodes));
  rule_.key.resize(at(p_.num_slots));
  rule_.hold.resize(at(p_.num_slots));
}

double Evaluator::overload(const Decision& decision) const {
  std::vector<double> load(at(p_.num_xpus), 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const int m = decision.xpu[at(i)];
    if (load[at(m)] == 0) load[at(m)] = p_.others_load[at(m)];
    load[at(m)] += p_.load_of(i, m, false);
  }
  double over = 0;
  for (const double l : load) over += std::max(0.0, l - 1.0);
  return over;
}

/// What a drifting clock takes of each XPU that one domain has. True if it is more than before.
bool Evaluator::deepen_pads(const Decision& decision, Figures& out) {
  if (std::all_of(p_.domains.begin(), p_.domains.end(), [](const Domain& d) { return d.ppm == 0; }))
    return false;
  std::vector<Tick> deepest(at(p_.num_xpus), 0);
  std::vector<std::int64_t> ppm(at(p_.num_xpus), 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const std::size_t m = at(decision.xpu[at(i)]);
    ppm[m] = std::max(ppm[m], p_.domains[at(p_.domain_of(i))].ppm);
    for (int n = 0; n < p_.jobs[at(i)]; ++n)
      deepest[m] = std::max(deepest[m], out.w.d[at(p_.slot[at(i)] + n)]);
  }
  bool grew = false;
  for (std::size_t m = 0; m < deepest.size(); ++m) {
    if (drift_pad(deepest[m], ppm[m]) <= out.pad[m]) continue;
    // What it adds makes windows deeper: a little more at once.
    out.pad[m] = drift_pad(deepest[m] + deepest[m] / kPartOfDepth, ppm[m]);
    grew = grew || shared_[m] == 0;
  }
  return grew;
}

/// Whether a shared XPU serves the same windows as in the base.
bool Evaluator::as_before(const Decision& decision, int m, const Figures& out) const {
  // Windows of urgent releases follow from those on other XPUs, too.
  if (base_ == nullptr || p_.any_urgent || was_shared_[at(m)] == 0 ||
      base_figures_->missing.empty())
    return false;
  const Windows &now = out.w, &before = base_figures_->w;
  for (int i = 0; i < p_.num_xnodes; ++i) {
    if ((decision.xpu[at(i)] == m) != (base_->xpu[at(i)] == m)) return false;
    if (decision.xpu[at(i)] != m || changed_[at(p_.domain_of(i))] == 0) continue;
    const auto first = p_.slot[at(i)], last = first + p_.jobs[at(i)];
    for (auto s = at(first); s < at(last); ++s)
      if (now.a[s] != before.a[s] || now.d[s] != before.d[s] || now.e[s] != before.e[s])
        return false;
  }
  return true;
}

/// The shared XPUs, by the demand bound.
bool Evaluator::serves(const Decision& decision, Figures& out, const Until& until) {
  // How much is missing leads the annealer to where nothing is.
  double missing = 0;
  out.missing.assign(at(p_.num_xpus), 0);
  if (p_.any_urgent) {
    derive_urgent(p_, decision.xpu, out.w, urgent_);
    int i = -1;
    if (const Tick lacks = urgent_shortfall(p_, decision.xpu, out.w, urgent_, i); lacks > 0)
      missing = 1 + static_cast<double>(lacks) / static_cast<double>(lacks + p_.period_of(i));
  }
  for (int m = 0; m < p_.num_xpus; ++m) {
    if (shared_[at(m)] == 0) continue;
    // A valid state is left for a valid one.
    if (missing > 0 && most_ < kInvalidCost) break;
    double& here = out.missing[at(m)];
    if (as_before(decision, m, out)) {
      here = base_figures_->missing[at(m)];
    } else {
      if (until.over()) {
        out.cost = kEndless * kInvalidCost;
        return false;
      }
      charge(p_, decision.xpu, out.w, urgent_, m, charges_);
      Tightest t;
      if (!shared_fits(p_, m, decision.xpu, out.w, urgent_, charges_, &t))
        here = kLeastMissing + (t.demand > t.length ? static_cast<double>(t.demand - t.length) /
                                                          static_cast<double>(t.demand)
                                                    : 1);
    }
    missing += here;
  }
  if (missing > 0) out.cost = kInvalidCost * (kUnserved + missing / (p_.num_xpus + 3));
  return missing == 0;
}

/// Which domains have to be simulated.
void Evaluator::find_changes(const Decision& decision, const Figures& out) {
  changed_.assign(p_.domains.size(), 1);
  if (base_ == nullptr) return;
  was_shared_ = shared_xpus(p_, base_->xpu);  // as_before reads it in any case
  if (base_figures_->w.d.empty() || !base_figures_->simulated || decision.given != base_->given)
    return;
  std::fill(changed_.begin(), changed_.end(), 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const std::size_t x = at(i), m = at(decision.xpu[x]);
    if (decision.xpu[x] != base_->xpu[x] || decision.hold[x] != base_->hold[x] ||
        decision.late[x] != base_->late[x] || decision.held[x] != base_->held[x] ||
        shared_[m] != was_shared_[m] ||
        (shared_[m] != 0
             ? decision.window[x] != base_->window[x]
             : decision.key[x] != base_->key[x] || decision.polite[x] != base_->polite[x] ||
                   out.pad[m] != base_figures_->pad[m]))
      changed_[at(p_.domain_of(i))] = 1;
  }
}

/// By how much all that comes of an activation may be later and is read by the same activations as now.
Tick Evaluator::slack_behind(const Schedule& schedule, int v, int n) const {
  const Component& c = p_.components[at(p_.component_of[at(v)])];
  Tick slack = kForever;
  for (const auto& [u, r] : feeds_[at(v)]) {
    const Component& of = p_.components[at(p_.component_of[at(r)])];
    const Tick end = c.phase + n * c.period + schedule.finish[p_.slot_of(u, n)];
    const auto starts = [&, reader = r](std::int64_t m) {
      return of.phase + m * of.period + schedule.start[p_.slot_of(reader, m)] / p_.scale * p_.scale;
    };
    std::int64_t m = floor_div(end - of.phase, of.period);
    while (starts(m - 1) >= end) --m;
    while (starts(m) < end) ++m;
    slack = std::min(slack, starts(m) - end);
  }
  return slack;
}

/// The schedule of one domain; then with those held that begin late.
bool Evaluator::exhibit(int domain, const Decision& decision, Figures& out, const Until& until) {
  Exhibitor& exhibitor = exhibitors_[at(domain)];
  if (!exhibitor.run(domain, rule_, out.schedule, until)) return false;
  std::vector<std::pair<std::size_t, Tick>> before;
  for (const int v : p_.domains[at(domain)].xnodes) {
    if (decision.late[at(v)] == 0) continue;
    for (int n = 0; n < p_.jobs[at(v)]; ++n) {
      const std::size_t s = at(p_.slot[at(v)] + n);
      const Tick slack = slack_behind(out.schedule, v, n) / p_.scale * p_.scale;
      if (slack <= 0) continue;
      before.emplace_back(s, rule_.hold[s]);
      rule_.hold[s] = out.schedule.start[s] / p_.scale * p_.scale + slack;
    }
  }
  const bool repeats = before.empty() || exhibitor.run(domain, rule_, out.schedule, until);
  for (const auto& [s, hold] : before) rule_.hold[s] = hold;
  return repeats;
}

/// The schedules, and the windows that follow.
bool Evaluator::plan(const Decision& decision, Figures& out, const Until& until) {
  for (int attempt = 0; attempt < kMostTries; ++attempt) {
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const std::size_t m = at(decision.xpu[at(i)]);
      rule_.delay[at(i)] = shared_[m] != 0 ? 0 : out.pad[m];
    }
    if (attempt == 0)
      find_changes(decision, out);
    else
      changed_.assign(p_.domains.size(), 1);
    for (std::size_t d = 0; d < p_.domains.size(); ++d) {
      if (changed_[d] == 0) {
        for (const int i : p_.domains[d].xnodes) {
          const auto first = p_.slot[at(i)], last = first + p_.jobs[at(i)];
          const auto& from = base_figures_->schedule;
          std::copy(from.start.begin() + first, from.start.begin() + last,
                    out.schedule.start.begin() + first);
          std::copy(from.finish.begin() + first, from.finish.begin() + last,
                    out.schedule.finish.begin() + first);
        }
      } else if (!exhibit(static_cast<int>(d), decision, out, until)) {
        const double growth = exhibitors_[d].growth();
        out.cost = kEndless * kInvalidCost * (1 + kGrowthShare * growth / (growth + p_.num_slots));
        return false;
      }
    }
    std::copy(out.schedule.finish.begin(), out.schedule.finish.end(), out.w.d.begin());
    if (deepen_pads(decision, out)) continue;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const std::size_t m = at(decision.xpu[at(i)]);
      const bool holds = p_.reads[at(i)] != 0 || decision.hold[at(i)] > 0 ||
                         decision.held[at(i)] != 0 || p_.levels[m] != kAnyLevels ||
                         p_.preempt[m] > 0 || p_.contended;
      for (int n = 0; n < p_.jobs[at(i)]; ++n) {
        const std::size_t s = at(p_.slot[at(i)] + n);
        out.w.hold[s] = holds ? out.schedule.start[s] / p_.scale * p_.scale : 0;
      }
    }
    for (std::size_t d = 0; d < p_.domains.size(); ++d)
      derive_ready(p_, static_cast<int>(d), decision.xpu, out.w);
    out.simulated = true;
    return true;
  }
  out.cost = kEndless * kInvalidCost;
  return false;
}

/// What jobs meet depends on their windows, and these on what they take. It begins with what they take alone: who meets
/// somebody takes longer from then on, whether he still does or not.
bool Evaluator::simulate(const Decision& decision, const Figures* keys, Figures& out,
                         const Until& until) {
  if (counted_ == nullptr) return simulate_counted(decision, keys, out, until);
  std::vector<Tick> counted = least_counted(p_, decision.xpu);
  for (int k = 0;; ++k) {
    if (k == kMostCounts) counted = most_counted(p_, decision.xpu);
    count_wcets(*counted_, decision.xpu, counted);
    if (!simulate_counted(decision, keys, out, until)) return false;
    const std::vector<Tick> next = counted_wcets(p_, decision.xpu, out.w);
    bool more = false;
    for (std::size_t i = 0; i < next.size(); ++i) {
      more = more || next[i] > counted[i];
      counted[i] = std::max(counted[i], next[i]);
    }
    if (!more) return true;
    if (until.over()) {
      out.cost = kEndless * kInvalidCost;
      return false;
    }
  }
}

bool Evaluator::simulate_counted(const Decision& decision, const Figures* keys, Figures& out,
                                 const Until& until) {
  out.simulated = false;
  out.w.a.resize(at(p_.num_slots));
  out.w.d.resize(at(p_.num_slots));
  out.w.hold.resize(at(p_.num_slots));
  out.schedule.start.resize(at(p_.num_slots));
  out.schedule.finish.resize(at(p_.num_slots));
  const double over = overload(decision);
  if (over > kRounding) {
    out.cost = kInvalidCost * (kOverloaded + over);
    return false;
  }
  shared_ = shared_xpus(p_, decision.xpu);
  if (base_figures_ != nullptr && base_figures_->simulated)
    out.pad = base_figures_->pad;
  else
    out.pad.assign(at(p_.num_xpus), 0);
  rule_.xpu = decision.xpu;
  rule_.polite = decision.polite;
  for (int i = 0; i < p_.num_xnodes; ++i)
    for (int n = 0; n < p_.jobs[at(i)]; ++n) {
      const std::size_t s = at(p_.slot[at(i)] + n);
      rule_.key[s] = decision.key[at(i)];
      rule_.hold[s] = decision.hold[at(i)];
      if (decision.given == nullptr) continue;
      rule_.key[s] -= decision.given->sooner[s];
      if (decision.held[at(i)] != 0)
        rule_.hold[s] = std::max(rule_.hold[s], decision.given->hold[s]);
    }
  if (keys != nullptr) rule_.key = keys->w.d;
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const int m = decision.xpu[at(i)];
    const std::int64_t ppm = p_.domains[at(p_.domain_of(i))].ppm;
    // With a reserve each pays, in its work.
    rule_.work[at(i)] = in_fast_time(p_.tested_work(i, m, false), ppm);
    if (shared_[at(m)] == 0) {
      rule_.cost[at(m)] = p_.reserve_pct > 0 ? 0 : in_fast_time(p_.preempt[at(m)], ppm);
      rule_.window[at(i)] = kNoTick;
    } else {
      // A window that cannot begin earlier has to end later by what urgency takes of it.
      rule_.window[at(i)] =
          std::max(decision.window[at(i)], p_.up_to_us(p_.tested_work(i, m, false)) +
                                               (rigid_[at(i)] != 0 ? p_.urgent_by(i) : 0));
    }
  }
  if (!plan(decision, out, until)) return false;
  if (!set_costs(out, until)) return false;
  // What is refused anyway need not be served.
  if (out.cost > most_) return false;
  return serves(decision, out, until);
}

/// False: it is over before all ways are known.
bool Evaluator::set_costs(Figures& out, const Until& until) const {
  out.chain.assign(p_.chains.size(), 0);
  out.largest = out.sum = 0;
  std::size_t steps = 0;
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    const Chain& chain = p_.chains[c];
    for (const Path& path : chain.paths) {
      out.chain[c] = std::max(out.chain[c], worst_case(p_, chain, path, out.w));
      steps += steps_of(p_, path);
      if (steps < kStepsAtOnce) continue;
      steps = 0;
      if (!until.over()) continue;
      out.cost = kEndless * kInvalidCost;
      return false;
    }
    const double part = static_cast<double>(out.chain[c]) / static_cast<double>(chain.by);
    out.sum += static_cast<double>(chain.weight) * part;
    if (is_counted(p_, chain)) out.largest = std::max(out.largest, part);
  }
  out.cost = cost_of(out);
  return true;
}

double Evaluator::cost_of(const Figures& figures) const {
  const double sum = figures.sum / reference_sum_;
  if (!goal_.sum) return figures.largest / reference_largest_ + kSumBesideLargest * sum;
  if (figures.largest <= goal_.most()) return sum;
  return sum + kAboveLimit + kAboveLimitTimes * (figures.largest / goal_.most() - 1);
}

/// A chain takes at least as long as the jobs of its ways, from their release. By how much a
/// release may be before the chain's beginning is bounded by a period and the offsets; what is cut
/// off wrongly is an answer less, no wrong one.
void Evaluator::set_limits(double most) {
  if (most >= kInvalidCost) {
    rule_.limit.clear();
    return;
  }
  rule_.limit.assign(at(p_.num_xnodes), kMostKey);
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    const Chain& chain = p_.chains[c];
    const auto by = static_cast<double>(chain.by), weight = static_cast<double>(chain.weight);
    const double own = weight * static_cast<double>(reference_[c]) / by;
    double longest = static_cast<double>(kMostTicks);
    if (!goal_.sum && is_counted(p_, chain)) longest = most * reference_largest_ * by;
    if (goal_.sum && chain.weight > 0)
      longest = (most * reference_sum_ - (reference_sum_ - own)) / weight * by;
    if (longest >= static_cast<double>(kMostTicks)) continue;
    for (const int i : chain_xnodes_[c]) {
      Tick& limit = rule_.limit[at(i)];
      limit = std::min(limit, static_cast<Tick>(longest) + chain.offset + p_.period_of(i));
    }
  }
}

void Evaluator::evaluate(const Decision& decision, double most, Figures& out, const Until& until,
                         const Decision* base, const Figures* base_figures) {
  ++evaluations_;
  set_limits(most);
  most_ = most;
  // What a base has may be of other WCETs.
  base_ = counted_ == nullptr ? base : nullptr;
  base_figures_ = counted_ == nullptr ? base_figures : nullptr;
  out.valid = simulate(decision, nullptr, out, until);
}

void Evaluator::take(const Decision& decision, Figures& out, const Until& until) {
  ++evaluations_;
  out.simulated = false;
  out.valid = certify(p_, decision.xpu, out.w, nullptr, until) && set_costs(out, until);
  if (!out.valid) out.cost = kInvalidCost;
  out.schedule.start = out.w.e;
  out.schedule.finish = out.w.d;
  out.pad.assign(at(p_.num_xpus), 0);
  out.missing.clear();
}

bool Evaluator::settle(const Decision& decision, Figures& out, const Until& until) {
  ++evaluations_;
  rule_.limit.clear();
  most_ = kInvalidCost;
  base_ = nullptr;
  base_figures_ = nullptr;
  Figures next;
  next.valid = simulate(decision, &out, next, until);
  if (!next.valid || !goal_.better(next, out)) return false;
  out = std::move(next);
  return true;
}

}  // namespace xauto::solver::keys
