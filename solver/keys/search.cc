// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/search.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>

#include "solver/keys/sustain.h"

namespace xauto::solver::keys {
namespace {

// ---- constants of the search --------------------------------------------------------------------
// Where nothing more is said, a value is not tuned: it was chosen when the search, or the move, was
// written, and stayed. Measured is only the search as a whole, on the 55 cases of bench/keys
// ("tuned on", docs/results/keys.txt). No measurement of single values and their neighbours is
// kept. `bench_keys` shows what a change does.

/// Of `figures`, before there is a candidate: more than any costs.
constexpr double kNoCandidate = 1e18;

// Where XNodes go in a start, by what each adds. Loads are shares of an XPU's time.
/// Price of an XNode's own load, whatever the type, beside the type's price. A start is made with
/// each; where a hint says nothing, XNodes are placed with the first.
constexpr double kGreeds[] = {0.3, 1.0, 0.1, 3.0};
/// Added to each type's price: else load would cost nothing on a type that is never full.
constexpr std::int64_t kLeastPrice = kWeights / 64;
constexpr double kCrowding = 0.3;  ///< price of load beside load, so that XPUs of a type share it
/// What an XPU is loaded by above the first costs so much more.
constexpr double kFull = 0.95, kFullCosts = 10;
/// Keys by the period alone: later by this part of what lies before an XNode, for the ties.
constexpr Tick kPartOfHead = 64;

// Where a start overloads an XPU, its loads are annealed before anything is simulated.
constexpr double kBalancedFrom = 0.97;  ///< a larger load of some XPU is annealed
/// What the annealing pays: the square of each load, and so much for what is above this.
constexpr double kOverfull = 0.98, kOverfullCosts = 40;
constexpr int kBalanceStepsPerXNode = 200;
/// Its temperature falls evenly from the first to the last, both in such costs.
constexpr double kBalanceHot = 0.05, kBalanceCold = 1e-6;

// Windows of a start on XPUs that domains share.
/// Parts of the time that a module has; each is tried. One domain that nothing is urgent in takes
/// all of it.
constexpr double kWindowParts[] = {0.95, 0.5, 0.25};
/// Activations in flight that a window may be spread over at most.
constexpr std::int64_t kMostFlights = 64;

/// How often a better candidate is simulated again with its own keys, at most.
constexpr int kMostSettled = 3;

// Moves. Below each limit, of a number drawn from (0, 1], is this move; the rest are keys, and
// windows on shared XPUs.
constexpr double kMoveBelow = 0.30;      ///< to another XPU
constexpr double kExchangeBelow = 0.42;  ///< of XPUs between two XNodes
constexpr double kHoldBelow = 0.50;      ///< of an XNode that samples: later, or none
constexpr double kPoliteBelow = 0.56;    ///< whether it interrupts others in the plan
constexpr double kOnCritical = 0.6;      ///< of moves: an XNode of the chain that sets the cost
constexpr double kLate = 0.5;            ///< of moves of a hold: Decision::late, where that may be
constexpr double kUnhold = 0.5;          ///< of moves of a hold: none, where there is one
/// ... else, where there is one: somewhat sooner or later, by exp(-1) to exp(-1 - kMoveRange) of a period; of these,
/// all other holds by as much. Readers that follow one another have to move together: the first one alone costs what
/// the others read. Measured on the Driving Case at its rates: docs/results/driving-rates.txt.
constexpr double kMoveHold = 0.5, kMoveAll = 0.5, kMoveRange = 8;
constexpr double kMeeting = 0.2;   ///< where WCETs depend on who meets: moves that keep two apart
constexpr double kOneMove = 0.75;  ///< of candidates: one move, not two

// A key: just beside that of another one of its XPU, times a factor, or with its whole component.
constexpr double kBesideBelow = 0.6, kKeyFactorBelow = 0.9;
constexpr double kBefore = 0.6;    ///< of those beside another: before it, not behind
constexpr int kTriesToMeet = 12;   ///< of finding another one by chance
constexpr double kKeyRange = 1.2;  ///< factors are exp(+- half of this)

// A window: that of another one of its XPU, nearer to the WCET, times a factor close to 1, times
// any factor, or with its whole component.
constexpr double kAlikeBelow = 0.25, kTighterBelow = 0.5, kFineBelow = 0.7, kFactorBelow = 0.85;
constexpr double kFineRange = 0.3, kWindowRange = 1.5;
constexpr double kComponentRange = 0.8;  ///< of keys and of windows

// The annealer.
/// Where turns begin, as shares of the cost, one after the other: no one is best for all apps. One
/// that fell from turn to turn was before; by how much these are better is not kept.
constexpr double kHot[] = {0.05, 0.15, 0.03};
constexpr std::size_t kElsewhere = 1;  ///< of these, after the first round: begins elsewhere
constexpr double kCold = 0.01;         ///< where they end, as a share of where they began
/// Steps of a turn; twice as many after each round of `kHot`.
constexpr std::int64_t kFirstSteps = 1500;
/// Of what is not valid, the share of kInvalidCost that stands for the cost.
constexpr double kInvalidShare = 0.05;
constexpr std::int64_t kStepsPerChain = 16;  ///< accepted moves make the critical chain stale

/// Longest ways of least WCETs behind each XNode, itself excluded.
std::vector<Tick> tails(const Problem& p, const std::vector<Tick>& work) {
  std::vector<Tick> tail(at(p.num_xnodes), 0);
  for (const Domain& d : p.domains)
    for (auto i = d.xnodes.rbegin(); i != d.xnodes.rend(); ++i)
      for (const EdgeEnd& s : p.succ[at(*i)])
        tail[at(*i)] = std::max(tail[at(*i)], tail[at(s.xnode)] + work[at(s.xnode)]);
  return tail;
}

std::vector<Tick> heads(const Problem& p, const std::vector<Tick>& work) {
  std::vector<Tick> head(at(p.num_xnodes), 0);
  for (const Domain& d : p.domains)
    for (const int i : d.xnodes) {
      if (p.root[at(i)] != 0) head[at(i)] = p.root_ready[at(i)];
      for (const EdgeEnd& l : p.pred[at(i)])
        head[at(i)] = std::max(head[at(i)], head[at(l.xnode)] + work[at(l.xnode)]);
    }
  return head;
}

}  // namespace

Incumbents::Incumbents(const Problem& p, const std::vector<Tick>& reference, Aim aim)
    : deadlines_(p.deadlines), sums_(aim != Aim::kLargest), mixes_(aim == Aim::kMix) {
  for (std::size_t c = 0; c < p.chains.size(); ++c)
    if (!p.deadlines || p.chains[c].deadline != kNoTick)
      bound_ = std::max(bound_, static_cast<double>(p.up_to_us(reference[c])) /
                                    static_cast<double>(p.chains[c].by));
  in_time_ = deadlines_ && bound_ <= 1;
  for (Candidate* none : {&best_, &least_}) none->figures.cost = kNoCandidate;
}

Goal Incumbents::first_goal() const {
  return {in_time_, sums_ && !mixes_};
}

Goal Incumbents::goal() const {
  if (!mixes_ || !may_sum()) return first_goal();
  return {in_time_, true, kWithin * least_.figures.largest};
}

bool Incumbents::improved_by(const Figures& figures) const {
  return goal().better(figures, best_.figures) ||
         (mixes_ && first_goal().better(figures, least_.figures));
}

bool Incumbents::add(const Candidate& candidate) {
  if (!candidate.figures.valid) return false;
  if (mixes_ && first_goal().better(candidate.figures, least_.figures)) least_ = candidate;
  if (!goal().better(candidate.figures, best_.figures)) return false;
  best_ = candidate;
  return true;
}

void Incumbents::add_invalid(const Candidate& candidate) {
  if (any() || candidate.figures.cost >= best_.figures.cost) return;
  best_ = candidate;
  if (mixes_) least_ = candidate;
}

Search::Search(const Problem& problem, const std::vector<Tick>& reference, Aim aim,
               std::uint64_t seed)
    : p_(problem),
      reference_(reference),
      evaluator_(problem, reference),
      random_(seed),
      found_(problem, reference, aim),
      goal_(found_.first_goal()) {
  evaluator_.set_goal(goal_);
  for (int i = 0; i < p_.num_xnodes; ++i)
    if (p_.reads[at(i)] != 0) readers_.push_back(i);
}

/// As long as the least of the largest is looked for, what is no better there is not certified.
bool Search::improves(const Figures& figures) const {
  return figures.valid &&
         (goal_.sum ? found_.improved_by(figures) : goal_.better(figures, found_.least().figures));
}

bool Search::over() const {
  return proven_ || limits_.until.over() ||
         (limits_.max_evaluations > 0 && evaluator_.evaluations() >= limits_.max_evaluations);
}

bool Search::fits(const Policy& hint) const {
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const Placement& placed = hint.placements[at(i)];
    const std::size_t size = placed.key_us.size();
    const auto is_time = [&](std::int64_t us) { return us >= 0 && us <= kMostTicks / p_.scale; };
    if (!std::ranges::binary_search(p_.may_run[at(i)], placed.xpu) || size == 0 ||
        at(p_.jobs[at(i)]) % size != 0 ||
        (!placed.hold_us.empty() && placed.hold_us.size() != size) ||
        !std::ranges::all_of(placed.key_us, is_time) ||
        !std::ranges::all_of(placed.hold_us, is_time))
      return false;
  }
  return std::ranges::all_of(p_.groups, [&](const std::vector<int>& group) {
    return std::ranges::all_of(group, [&](int i) {
      return hint.placements[at(i)].xpu == hint.placements[at(group.front())].xpu;
    });
  });
}

/// First the hint as it is, if it is certified. Then what the rule makes of its keys, with its arrays and holds
/// and without.
void Search::begin_with(const Policy& hint,
                        const std::function<void(const Candidate&)>& on_better) {
  Candidate c;
  c.decision = from_hint(hint);
  if (fits(hint)) {
    Candidate whole = c;
    Windows& w = whole.figures.w;
    w = keys_and_holds(p_, hint);
    auto given = std::make_shared<Given>();
    given->hold = w.hold;
    given->sooner.resize(at(p_.num_slots));
    for (int i = 0; i < p_.num_xnodes; ++i)
      for (int n = 0; n < p_.jobs[at(i)]; ++n) {
        const std::size_t s = at(p_.slot[at(i)] + n);
        given->sooner[s] = whole.decision.key[at(i)] - w.d[s];
        if (w.hold[s] > 0) whole.decision.held[at(i)] = 1;
      }
    whole.decision.given = std::move(given);
    evaluator_.take(whole.decision, whole.figures, limits_.finish_until);
    if (whole.figures.valid) keep(whole, on_better);
    evaluate(whole);
    take(whole, on_better);
  }
  evaluate(c);
  take(c, on_better);
}

Decision Search::from_hint(const Policy& hint) {
  Decision d = constructed(balancing_weights(p_), kGreeds[0], 0, true);
  const std::vector<int> built = d.xpu;
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const Placement& placed = hint.placements[at(i)];
    const auto& may = p_.may_run[at(i)];
    if (std::binary_search(may.begin(), may.end(), placed.xpu)) d.xpu[at(i)] = placed.xpu;
    if (placed.key_us.empty()) continue;
    const std::int64_t key = *std::max_element(placed.key_us.begin(), placed.key_us.end());
    d.key[at(i)] = std::min(key, kMostTicks / p_.scale) * p_.scale;
  }
  for (const auto& group : p_.groups)
    if (std::any_of(group.begin(), group.end(),
                    [&](int i) { return d.xpu[at(i)] != d.xpu[at(group.front())]; }))
      for (const int i : group) d.xpu[at(i)] = built[at(i)];
  // d - a of its keys, which `a` follows from but for `in flight`.
  d.window.assign(at(p_.num_xnodes), 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    Tick ready = p_.root[at(i)] != 0 ? p_.root_ready[at(i)] : 0;
    for (const EdgeEnd& link : p_.pred[at(i)])
      ready = std::max(
          ready, d.key[at(link.xnode)] + p_.transfer(link, d.xpu[at(link.xnode)], d.xpu[at(i)]));
    d.window[at(i)] = std::max(p_.wcet(i, d.xpu[at(i)]), d.key[at(i)] - ready);
  }
  return d;
}

void Search::evaluate(Candidate& candidate) {
  evaluator_.evaluate(candidate.decision, kInvalidCost, candidate.figures, limits_.finish_until);
}

void Search::put(Decision& d, int xnode, int xpu) const {
  const int group = p_.group_of[at(xnode)];
  if (group < 0) {
    d.xpu[at(xnode)] = xpu;
    return;
  }
  for (const int i : p_.groups[at(group)]) {
    const auto& may = p_.may_run[at(i)];
    if (!std::binary_search(may.begin(), may.end(), xpu)) return;
  }
  for (const int i : p_.groups[at(group)]) d.xpu[at(i)] = xpu;
}

/// Anneals the largest load alone, which takes no simulation: until no XPU is overloaded.
void Search::balance(std::vector<int>& xpu, int steps) {
  Decision d;
  d.xpu = xpu;
  std::vector<double> load = p_.others_load;
  const auto rate = [&](int i, int m) { return p_.load_of(i, m, true); };
  for (int i = 0; i < p_.num_xnodes; ++i) load[at(xpu[at(i)])] += rate(i, xpu[at(i)]);
  const auto excess = [&](double l) {
    return l > kOverfull ? kOverfullCosts * (l - kOverfull) + l * l : l * l;
  };
  for (int s = 0; s < steps; ++s) {
    const int i = static_cast<int>(random_.below(at(p_.num_xnodes)));
    const auto& may = p_.may_run[at(i)];
    if (p_.group_of[at(i)] >= 0 || may.size() < 2) continue;
    const int from = xpu[at(i)], to = may[random_.below(may.size())];
    if (to == from) continue;
    const double before = excess(load[at(from)]) + excess(load[at(to)]);
    const double after =
        excess(load[at(from)] - rate(i, from)) + excess(load[at(to)] + rate(i, to));
    const double heat = kBalanceHot * (1.0 - static_cast<double>(s) / steps) + kBalanceCold;
    if (after <= before || random_.unit() < std::exp((before - after) / heat)) {
      load[at(from)] -= rate(i, from);
      load[at(to)] += rate(i, to);
      xpu[at(i)] = to;
    }
  }
}

/// Each XNode where it adds least: price of the type, load of the XPU so far, WCET against its
/// best. Keys: the latest finishing that keeps a deadline of `rule` periods.
Decision Search::constructed(const std::vector<std::int64_t>& weights, double greed, int rule,
                             bool charge) {
  Decision d;
  d.xpu.assign(at(p_.num_xnodes), -1);
  d.hold.assign(at(p_.num_xnodes), 0);
  d.held.assign(at(p_.num_xnodes), 0);
  d.late.assign(at(p_.num_xnodes), 0);
  d.polite.assign(at(p_.num_xnodes), charge ? 0 : 1);
  const std::vector<Tick> least = least_wcets(p_);
  std::vector<int> order(at(p_.num_xnodes));
  std::iota(order.begin(), order.end(), 0);
  const auto weight_of = [&](int i) {
    return static_cast<double>(least[at(i)]) / static_cast<double>(p_.period_of(i));
  };
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return weight_of(a) > weight_of(b); });
  // With `charge` as if each paid for a preemption, as most do in the end on a busy XPU.
  const auto rate_on = [&](int i, int m) { return p_.load_of(i, m, charge); };
  std::vector<double> load = p_.others_load;
  std::vector<int> first_domain(at(p_.num_xpus), -1);
  for (const int i : order) {
    if (d.xpu[at(i)] >= 0) continue;  // its group has been placed
    double best = 0;
    int where = -1;
    const int group = p_.group_of[at(i)];
    for (const int m : p_.may_run[at(i)]) {
      if (group >= 0 && std::any_of(p_.groups[at(group)].begin(), p_.groups[at(group)].end(),
                                    [&](int j) { return p_.wcet(j, m) == kNoTick; }))
        continue;
      const double price =
          static_cast<double>(weights[at(p_.xpu_place[at(m)])] + kLeastPrice) / kWeights;
      const double rate = rate_on(i, m);
      const double after = load[at(m)] + rate;
      double cost = rate * price +
                    greed * static_cast<double>(p_.wcet(i, m)) / static_cast<double>(least[at(i)]) *
                        weight_of(i) +
                    kCrowding * rate * after + (after > kFull ? kFullCosts * (after - kFull) : 0);
      // A domain beside another has to wait for all phases.
      if (first_domain[at(m)] >= 0 ? first_domain[at(m)] != p_.domain_of(i)
                                   : !p_.others[at(m)].empty())
        cost += rate;
      if (where < 0 || cost < best) {
        best = cost;
        where = m;
      }
    }
    if (where < 0) where = p_.may_run[at(i)].front();
    d.xpu[at(i)] = where;
    if (group >= 0)
      for (const int j : p_.groups[at(group)]) d.xpu[at(j)] = where;
    load[at(where)] += rate_on(i, where);
    if (first_domain[at(where)] < 0) first_domain[at(where)] = p_.domain_of(i);
  }
  if (std::any_of(load.begin(), load.end(), [](double l) { return l > kBalancedFrom; }))
    balance(d.xpu, kBalanceStepsPerXNode * p_.num_xnodes);
  std::vector<Tick> work(at(p_.num_xnodes));
  for (int i = 0; i < p_.num_xnodes; ++i) work[at(i)] = std::max(Tick{1}, p_.wcet(i, d.xpu[at(i)]));
  const std::vector<Tick> head = heads(p_, work), tail = tails(p_, work);
  std::vector<Tick> span(p_.components.size(), 0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    Tick& whole = span[at(p_.component_of[at(i)])];
    whole = std::max(whole, head[at(i)] + work[at(i)] + tail[at(i)]);
  }
  d.key.resize(at(p_.num_xnodes));
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const Tick whole = span[at(p_.component_of[at(i)])];
    const Tick due = rule == 0 ? std::max(p_.period_of(i), whole) : whole;
    d.key[at(i)] = rule == 2 ? p_.period_of(i) + head[at(i)] / kPartOfHead : due - tail[at(i)];
  }
  return d;
}

void Search::spread_windows(Decision& d, double part) const {
  d.window.assign(at(p_.num_xnodes), 0);
  std::vector<Tick> weight(at(p_.num_xnodes)), head(at(p_.num_xnodes)), tail(at(p_.num_xnodes));
  for (int i = 0; i < p_.num_xnodes; ++i)
    weight[at(i)] = p_.wcet(i, d.xpu[at(i)]) + p_.preempt[at(d.xpu[at(i)])];
  const auto inside = [&](int a, int b) { return p_.module_of[at(a)] == p_.module_of[at(b)]; };
  for (const Component& c : p_.components) {
    for (const int i : c.xnodes)
      for (const EdgeEnd& l : p_.pred[at(i)])
        if (inside(i, l.xnode))
          head[at(i)] = std::max(head[at(i)], head[at(l.xnode)] + weight[at(l.xnode)]);
    for (auto i = c.xnodes.rbegin(); i != c.xnodes.rend(); ++i)
      for (const EdgeEnd& l : p_.succ[at(*i)])
        if (inside(*i, l.xnode))
          tail[at(*i)] = std::max(tail[at(*i)], tail[at(l.xnode)] + weight[at(l.xnode)]);
  }
  for (int i = 0; i < p_.num_xnodes; ++i) {
    const int module = p_.module_of[at(i)];
    const auto flights =
        module < 0 ? 1.0
                   : static_cast<double>(std::min(p_.modules[at(module)].in_flight, kMostFlights));
    const double all = flights * static_cast<double>(p_.period_of(i)) * part;
    const auto way = static_cast<double>(head[at(i)] + weight[at(i)] + tail[at(i)]);
    const auto window = static_cast<Tick>(all * static_cast<double>(weight[at(i)]) / way);
    d.window[at(i)] = std::max(p_.up_to_us(p_.wcet(i, d.xpu[at(i)])), window / p_.scale * p_.scale);
  }
}

bool Search::may_sum() const {
  return found_.mixes() && found_.may_sum() &&
         (found_.least_is_known() || limits_.least_until.over() ||
          (limits_.max_evaluations > 0 &&
           static_cast<double>(evaluator_.evaluations()) >=
               kForLeast * static_cast<double>(limits_.max_evaluations)));
}

/// The limit falls with the least that was found.
void Search::set_goal() {
  if (goal_.sum && found_.mixes()) goal_ = found_.goal();
  evaluator_.set_goal(goal_);
}

/// Certified.
void Search::keep(const Candidate& candidate,
                  const std::function<void(const Candidate&)>& on_better) {
  found_.add(candidate);
  set_goal();
  on_better(candidate);
  proven_ = true;
  for (std::size_t c = 0; c < p_.chains.size(); ++c)
    proven_ = proven_ && candidate.figures.chain[c] <= p_.up_to_us(reference_[c]);
}

/// Keeps it if it is the best so far, and, if it is valid, certified: the simulation is believed by
/// nobody. Makes it invalid otherwise.
void Search::take(Candidate& candidate, const std::function<void(const Candidate&)>& on_better) {
  if (improves(candidate.figures)) {
    for (int k = 0; k < kMostSettled; ++k)
      if (!evaluator_.settle(candidate.decision, candidate.figures, limits_.finish_until)) break;
    if (certify(p_, candidate.decision.xpu, candidate.figures.w, nullptr, limits_.finish_until)) {
      keep(candidate, on_better);
      return;
    }
    candidate.figures.valid = false;
    candidate.figures.cost = kInvalidCost;
  }
  if (!candidate.figures.valid) found_.add_invalid(candidate);
}

void Search::try_start(Decision decision, const std::function<void(const Candidate&)>& on_better) {
  const bool many = p_.domains.size() > 1 || p_.any_urgent || p_.reserve_pct > 0 ||
                    std::any_of(p_.others.begin(), p_.others.end(),
                                [](const auto& others) { return !others.empty(); });
  Candidate c;
  c.decision = std::move(decision);
  for (const double part : kWindowParts) {
    if (part != kWindowParts[0] && over()) return;
    spread_windows(c.decision, many ? part : 1);
    evaluate(c);
    take(c, on_better);
    if (!many) return;
  }
}

void Search::construct(const std::function<void(const Candidate&)>& on_better) {
  const std::vector<std::int64_t> weights = balancing_weights(p_);
  std::vector<std::int64_t> flat(weights.size(),
                                 kWeights / static_cast<std::int64_t>(weights.size()));
  const std::int64_t before = found_.any() ? -1 : evaluator_.evaluations();
  line_up(on_better);
  for (const double greed : kGreeds)
    for (const int rule : {0, 1, 2})
      for (const auto* prices : {&std::as_const(weights), &std::as_const(flat)})
        for (const bool charge : {true, false}) {
          if (over() && evaluator_.evaluations() > before) return;
          try_start(constructed(*prices, greed, rule, charge), on_better);
        }
}

void Search::set_critical(const Candidate& of) {
  critical_.clear();
  if (!of.figures.valid || p_.chains.empty()) return;
  if (goal_.sum && of.figures.largest <= goal_.most()) {
    critical_ = evaluator_.chain_xnodes()[random_.below(p_.chains.size())];
    return;
  }
  std::size_t worst = 0;
  double most = -1;
  for (std::size_t c = 0; c < p_.chains.size(); ++c) {
    const double figure =
        p_.deadlines && p_.chains[c].deadline == kNoTick
            ? 0
            : static_cast<double>(of.figures.chain[c]) / static_cast<double>(p_.chains[c].by);
    if (figure > most) {
      most = figure;
      worst = c;
    }
  }
  critical_ = evaluator_.chain_xnodes()[worst];
}

int Search::pick(const Candidate&) {
  if (!critical_.empty() && random_.unit() < kOnCritical)
    return critical_[random_.below(critical_.size())];
  return static_cast<int>(random_.below(at(p_.num_xnodes)));
}

bool Search::change_window(const Candidate& from, Decision& next, int i) {
  const int m = next.xpu[at(i)];
  Tick& window = next.window[at(i)];
  const Tick before = window, least = p_.up_to_us(p_.wcet(i, m));
  const double how = random_.unit();
  const auto scaled = [&](Tick w, double by) {
    const double ticks = std::min(static_cast<double>(w) * by, static_cast<double>(kMostTicks));
    return std::max(p_.up_to_us(p_.wcet(i, m)), static_cast<Tick>(ticks) / p_.scale * p_.scale);
  };
  if (how < kAlikeBelow) {
    // As long as that of another one of its XPU: neither can interrupt the other.
    const int j = static_cast<int>(random_.below(at(p_.num_xnodes)));
    if (j == i || next.xpu[at(j)] != m) return false;
    window = std::max(least, next.window[at(j)]);
  } else if (how < kTighterBelow && from.figures.valid) {
    window = least + scaled(window - least, random_.unit());
  } else if (how < kFactorBelow) {
    window = scaled(
        window, std::exp((random_.unit() - 0.5) * (how < kFineBelow ? kFineRange : kWindowRange)));
  } else {
    const double by = std::exp((random_.unit() - 0.5) * kComponentRange);
    for (const int j : p_.components[at(p_.component_of[at(i)])].xnodes)
      next.window[at(j)] = scaled(next.window[at(j)], by);
    return true;
  }
  return window != before;
}

/// A reader that is held begins somewhat sooner or later, alone or with all others that are.
void Search::shift_holds(Decision& next, int v) {
  const double part = std::exp(-1 - kMoveRange * random_.unit());
  Tick by = static_cast<Tick>(static_cast<double>(p_.period_of(v)) * part) / p_.scale * p_.scale;
  by = std::max(p_.scale, by) * (random_.unit() < 0.5 ? 1 : -1);
  const bool all = random_.unit() < kMoveAll;
  for (const int r : readers_)
    if (Tick& hold = next.hold[at(r)]; r == v || (all && hold > 0))
      hold = std::clamp<Tick>(hold + by, 0, kMostTicks / p_.scale * p_.scale);
}

/// One that samples begins later, so as to read something newer: or no longer.
bool Search::change_reader(const Candidate& from, Decision& next) {
  const int v = readers_[random_.below(readers_.size())];
  if (evaluator_.may_be_late(v) && random_.unit() < kLate) {
    next.late[at(v)] = next.late[at(v)] == 0 ? 1 : 0;
    return true;
  }
  Tick& hold = next.hold[at(v)];
  if (hold > 0 && random_.unit() < kUnhold) {
    hold = 0;
    return true;
  }
  if (hold > 0 && random_.unit() < kMoveHold) {
    shift_holds(next, v);
    return true;
  }
  const Tick before = hold;
  if (!from.figures.valid) return false;
  const Tick start = from.figures.schedule.start[at(p_.slot[at(v)])];
  hold = start +
         static_cast<Tick>(random_.unit() * random_.unit() * static_cast<double>(p_.period_of(v)));
  hold = hold / p_.scale * p_.scale;
  return hold != before;
}

/// One is held until another one on another XPU, of its clock, has ended: or no longer.
bool Search::change_meeting(const Candidate& from, Decision& next) {
  const int i = static_cast<int>(random_.below(at(p_.num_xnodes)));
  const int j = static_cast<int>(random_.below(at(p_.num_xnodes)));
  Tick& hold = next.hold[at(j)];
  if (hold > 0 && random_.unit() < kUnhold) {
    hold = 0;
    return true;
  }
  if (!from.figures.simulated || next.xpu[at(i)] == next.xpu[at(j)] ||
      p_.domain_of(i) != p_.domain_of(j) || p_.before(j, i))
    return false;
  const Component &first = p_.components[at(p_.component_of[at(i)])],
                  &then = p_.components[at(p_.component_of[at(j)])];
  const auto n = static_cast<std::int64_t>(random_.below(at(p_.jobs[at(i)])));
  const std::size_t s = p_.slot_of(i, n);
  const Tick release = first.phase + n * first.period;
  const std::int64_t m =
      floor_div(release + from.figures.schedule.start[s] - then.phase, then.period);
  const Tick until = release + from.figures.schedule.finish[s] - then.phase - m * then.period;
  const Tick before = hold;
  hold =
      std::clamp<Tick>(p_.up_to_us(std::max(until, Tick{0})), 0, kMostTicks / p_.scale * p_.scale);
  return hold != before;
}

bool Search::mutate(const Candidate& from, Decision& next) {
  if (p_.contended && random_.unit() < kMeeting) return change_meeting(from, next);
  const double what = random_.unit();
  const int i = pick(from);
  const auto& may = p_.may_run[at(i)];
  if (what < kMoveBelow && keep_ == Keep::kNothing) {
    if (may.size() < 2 || i == stays_) return false;
    const int m = may[random_.below(may.size())];
    if (!std::binary_search(may.begin(), may.end(), m)) return false;
    if (m == next.xpu[at(i)]) return false;
    put(next, i, m);
    return next.xpu[at(i)] == m;
  }
  if (what < kExchangeBelow && keep_ == Keep::kNothing) {
    const int j = static_cast<int>(random_.below(at(p_.num_xnodes)));
    const int mi = next.xpu[at(i)], mj = next.xpu[at(j)];
    if (mi == mj || i == stays_ || j == stays_) return false;
    const auto& other = p_.may_run[at(j)];
    if (!std::binary_search(may.begin(), may.end(), mj) ||
        !std::binary_search(other.begin(), other.end(), mi) || p_.group_of[at(i)] >= 0 ||
        p_.group_of[at(j)] >= 0)
      return false;
    std::swap(next.xpu[at(i)], next.xpu[at(j)]);
    return true;
  }
  if (what < kHoldBelow && next.held[at(i)] != 0) {
    next.held[at(i)] = 0;
    return true;
  }
  if (what < kHoldBelow && !readers_.empty()) return change_reader(from, next);
  if (what < kPoliteBelow) {
    const int m = next.xpu[at(i)];
    if (p_.preemptive[at(m)] == 0 || (p_.preempt[at(m)] == 0 && p_.levels[at(m)] == kAnyLevels))
      return false;
    next.polite[at(i)] = next.polite[at(i)] == 0 ? 1 : 0;
    return true;
  }
  if (shared_[at(next.xpu[at(i)])] != 0) return change_window(from, next, i);
  Tick& key = next.key[at(i)];
  const Tick before = key;
  const double how = random_.unit();
  if (how < kBesideBelow) {
    // Just before or behind another one of its XPU.
    int j = -1;
    for (int tries = 0; tries < kTriesToMeet && j < 0; ++tries) {
      const int other = static_cast<int>(random_.below(at(p_.num_xnodes)));
      if (other != i && next.xpu[at(other)] == next.xpu[at(i)]) j = other;
    }
    if (j < 0) return false;
    key = next.key[at(j)] + (random_.unit() < kBefore ? -1 : 1);
  } else if (how < kKeyFactorBelow) {
    key =
        static_cast<Tick>(static_cast<double>(key) * std::exp((random_.unit() - 0.5) * kKeyRange));
  } else {
    // All of its component, against the others.
    const double factor = std::exp((random_.unit() - 0.5) * kComponentRange);
    for (const int j : p_.components[at(p_.component_of[at(i)])].xnodes)
      next.key[at(j)] = std::clamp<Tick>(
          static_cast<Tick>(static_cast<double>(next.key[at(j)]) * factor), 1, kMostTicks);
    return true;
  }
  key = std::clamp<Tick>(key, 1, kMostTicks);
  return key != before;
}

/// One XNode, heavy ones sooner, goes to another type, where there is one. In this turn it stays there: what is best
/// with it may be far from what is best without.
void Search::detour(Decision& d) {
  if (keep_ != Keep::kNothing) return;
  const auto away = [&](int i, int m) {
    return p_.xpu_place[at(m)] != p_.xpu_place[at(d.xpu[at(i)])];
  };
  std::vector<double> load(at(p_.num_xnodes), 0);
  for (int i = 0; i < p_.num_xnodes; ++i)
    if (p_.group_of[at(i)] < 0 &&
        std::ranges::any_of(p_.may_run[at(i)], [&](int m) { return away(i, m); }))
      load[at(i)] = p_.load_of(i, d.xpu[at(i)], false);
  double drawn = random_.unit() * std::accumulate(load.begin(), load.end(), 0.0);
  for (int i = 0; i < p_.num_xnodes; ++i) {
    if (load[at(i)] == 0) continue;
    stays_ = i;
    if ((drawn -= load[at(i)]) <= 0) break;
  }
  if (stays_ < 0) return;
  std::vector<int> where = p_.may_run[at(stays_)];
  std::erase_if(where, [&](int m) { return !away(stays_, m); });
  d.xpu[at(stays_)] = where[random_.below(where.size())];
}

void Search::anneal(std::int64_t steps, double hot, bool elsewhere,
                    const std::function<void(const Candidate&)>& on_better) {
  Candidate current = front(), next;
  stays_ = -1;
  if (elsewhere) detour(current.decision);
  if (stays_ >= 0) evaluate(current);
  // It may be of another goal.
  if (current.figures.valid) current.figures.cost = evaluator_.cost_of(current.figures);
  set_critical(current);
  shared_ = shared_xpus(p_, current.decision.xpu);
  for (std::int64_t s = 0; s < steps && !over() && (goal_.sum || !may_sum()); ++s) {
    const double heat = hot * std::pow(kCold, static_cast<double>(s) / static_cast<double>(steps));
    next.decision = current.decision;
    bool changed = false;
    const int moves = random_.unit() < kOneMove ? 1 : 2;
    for (int m = 0; m < moves; ++m) changed = mutate(current, next.decision) || changed;
    if (!changed) continue;
    // Drawn before, so that most candidates need not be simulated to the end.
    const double scale =
        current.figures.valid ? current.figures.cost : kInvalidShare * kInvalidCost;
    const double allowed = current.figures.cost - heat * scale * std::log(random_.unit());
    evaluator_.evaluate(next.decision, allowed, next.figures, limits_.until, &current.decision,
                        &current.figures);
    if (next.figures.cost > allowed) continue;
    if (improves(next.figures)) {
      take(next, on_better);
      if (!next.figures.valid) continue;
      next.figures.cost = evaluator_.cost_of(next.figures);
    } else if (!found_.any()) {
      take(next, on_better);
    }
    std::swap(current, next);
    shared_ = shared_xpus(p_, current.decision.xpu);
    if (s % kStepsPerChain == 0) set_critical(current);
  }
}

void Search::run(const SearchLimits& limits, const Policy* hint, Keep keep,
                 const std::function<void(const Candidate&)>& on_better) {
  limits_ = limits;
  keep_ = hint == nullptr ? Keep::kNothing : keep;
  if (hint != nullptr) begin_with(*hint, on_better);
  if (keep_ == Keep::kNothing) construct(on_better);
  improve_line(on_better);
  std::int64_t steps = kFirstSteps;
  for (std::size_t cycle = 0; !over(); ++cycle) {
    if (!goal_.sum && may_sum()) {
      goal_.sum = true;
      set_goal();
      steps = kFirstSteps;
      cycle = 0;
      improve_line(on_better);
    }
    const std::int64_t before = evaluator_.evaluations();
    const std::size_t turn = cycle % std::size(kHot);
    const bool last = turn + 1 == std::size(kHot);
    const bool elsewhere = turn == kElsewhere && cycle > turn && found_.may_sum();
    if (limits_.exchange && last) {
      limits_.exchange(found_);
      set_goal();
    }
    anneal(steps, kHot[turn], elsewhere, on_better);
    if (evaluator_.evaluations() == before && (goal_.sum || !may_sum()))
      return;  // nothing can be changed
    if (last) steps *= 2;
  }
}

}  // namespace xauto::solver::keys
