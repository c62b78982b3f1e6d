// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/load_bound.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <deque>
#include <queue>
#include <utility>

#include "solver/keys/meetings.h"

namespace xauto::solver::keys {
namespace {

using Int = __int128;

/// Weights, and the values of objectives, are whole, in units of 2^-20.
constexpr int kShift = Weights::kShift;
constexpr std::int64_t kOne = std::int64_t{1} << kShift;

// What is searched for in floating point, and counted in integers: a worse search bounds less,
// nothing wrong. Where nothing more is said, a value is not tuned: chosen.
constexpr int kPicks = 48;  ///< that prices answer to the mean of
/// Rounds of the ascent: of the first case, and of those that begin with the prices of another one.
/// The latter were 160, and 56, before: with fewer there is time for more cases.
constexpr int kAscent = 160, kAscentAgain = 20;
/// Steps of the ascent fall as 1 / (first + slower * round), in units of the largest value.
constexpr double kStepFirst = 2, kStepSlower = 0.25;
/// Rounds in which an XNode was not on its usual type, as a share of all: above it the case is
/// parted by its type. They count so many times for an XNode on a chain's way.
constexpr double kMuchSplit = 0.02, kOnWayCounts = 4;
constexpr int kMostTypes = 31;  ///< a bit each
/// Of one XPU, who is looked at in pairs, and in threes.
constexpr std::size_t kMostOnXpu = 64, kMostInThrees = 16;
/// A bound that is so near to the value of an assignment is not looked at any further.
constexpr double kNear = 1e-6;
/// Steps of one round of an ascent, some ms: larger objectives are left without a bound.
constexpr std::size_t kMostStepsOfRound = 2'000'000;
/// Prices and visits up to here times work of 2^47 fit 127 bits, with room for their sums.
constexpr double kMostPrice = 0x1p66;
constexpr std::int64_t kMostVisits = std::int64_t{1} << 58;
/// Weight of a deadline, at most, so that visits fit: a very short one counts less than it could.
constexpr std::int64_t kMostWeight = std::int64_t{1} << 44;

/// What is bounded: the sum of weight * term, or the largest of them.
struct Objective {
  const std::vector<Term>& terms;
  std::vector<std::int64_t> weight;  ///< [term] in units of 2^-20; 0: it does not count
  bool largest = false;
};

/// One case: types that are left to each XNode, a bit per type, and how much longer than its WCET
/// its windows are at least.
struct Case {
  Int bound = 0;
  std::vector<std::uint32_t> left;
  std::vector<Tick> longer;
  std::vector<double> price;  ///< [type] to begin the ascent with
  bool begun = false;         ///< by another one
  int split = -1;             ///< XNode to be fixed next
  Disjunction choice = {};    ///< or what is decided next
  [[nodiscard]] bool closed() const { return split < 0 && choice.count == 0; }
};

bool is_fixed(std::uint32_t left) {
  return std::has_single_bit(left);
}

/// Visits of one or more picks, and what they wait.
struct Visits {
  std::vector<std::int64_t> of;   ///< [xnode] times the weights
  std::vector<std::int64_t> met;  ///< [xnode] by how many picks, in a stretch that meets itself
  Int waits = 0;
  std::int64_t picks = 0;

  explicit Visits(std::size_t n) : of(n, 0), met(n, 0) {}
  struct Pick {
    std::vector<std::pair<int, std::int64_t>> visits;  ///< XNode and weight
    std::vector<int> met;
    Int waits = 0;
  };
  void add(const Pick& pick, std::int64_t sign) {
    for (const auto& [xnode, weight] : pick.visits) of[at(xnode)] += sign * weight;
    for (const int i : pick.met) met[at(i)] += sign;
    waits += sign * pick.waits;
    picks += sign;
  }
  [[nodiscard]] double mean(std::size_t i) const {
    return static_cast<double>(of[i]) / static_cast<double>(std::max<std::int64_t>(1, picks));
  }
};

class Bounder {
 public:
  Bounder(const Problem& p, Objective objective)
      : p_(p), objective_(std::move(objective)), best_(at(p.num_xnodes)) {
    types_ = at(p.num_types);
    work_.assign(at(p.num_xnodes) * types_, kNoTick);
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int m : p.may_run[at(i)])
        work_[at(i) * types_ + at(p.xpu_type[at(m)])] = p.wcet(i, m);
    on_way_.assign(at(p.num_xnodes), 0);
    for (const auto& xpus : p.type_xpus) count_.push_back(static_cast<double>(xpus.size()));
    for (const Term& term : objective_.terms)
      for (const LoadWay& way : term.ways)
        for (const Piece& piece : way.pieces) {
          std::vector<int> order;
          for (const int i : p.components[at(p.component_of[at(piece.to)])].xnodes)
            if (i == piece.to || p.before(i, piece.to)) {
              order.push_back(i);
              on_way_[at(i)] = 1;
            }
          order_.push_back(std::move(order));
        }
    until_.resize(at(p.num_xnodes));
    by_.resize(at(p.num_xnodes));
    type_.resize(at(p.num_xnodes));
  }

  [[nodiscard]] Case whole() const {
    Case c;
    c.price.assign(types_, 0);
    c.longer.assign(at(p_.num_xnodes), 0);
    for (int i = 0; i < p_.num_xnodes; ++i) {
      std::uint32_t left = 0;
      for (std::size_t t = 0; t < types_; ++t)
        if (work_[at(i) * types_ + t] != kNoTick) left |= 1U << t;
      c.left.push_back(left);
    }
    return c;
  }

  /// Its bound, the prices and what is to be decided next. Ended by `until` after some rounds it is
  /// weaker.
  void bound(Case& c, const Until& until) {
    const std::size_t n = at(p_.num_xnodes);
    case_ = &c;
    choices_ = open_choices(c, [&](std::size_t i, std::size_t t) { return c.left[i] == 1U << t; });
    std::vector<double> y = c.price, best_y = y, load(types_);
    Visits visits(n);
    std::deque<Visits::Pick> picks;
    std::vector<double> share(n * types_, 0);
    std::vector<int> reached_by;
    double scale = 0, best = 0, reached = -1;
    const int rounds = c.begun ? kAscentAgain : kAscent;
    // Picks answer to the mean of the prices so far, prices to the mean of the picks.
    for (int round = 0; round < rounds; ++round) {
      assign(c, visits, y, load);
      if (round >= rounds / 2)
        for (std::size_t i = 0; i < n; ++i) share[i * types_ + at(type_[i])] += 1;
      double value = 0;
      picks.push_back(pick(value));
      if (fits(load) && (reached < 0 || value < reached)) {
        reached = value;
        reached_by = type_;
      }
      scale = std::max(scale, value);
      visits.add(picks.back(), 1);
      if (picks.size() > kPicks) {  // the oldest know least
        visits.add(picks.front(), -1);
        picks.pop_front();
      }
      const double step = scale / (kStepFirst + kStepSlower * (round + kAscent - rounds));
      for (std::size_t t = 0; t < types_; ++t)
        y[t] = std::max(0.0, y[t] + step * (load[t] - count_[t]));
      const double found = estimate(c, visits, y);
      if (round == 0 || found > best) {
        best = found;
        best_y = y;
        best_ = visits;
      }
      if (until.over()) break;
    }
    c.bound = std::max(c.bound, exact(c, best_y));
    c.price = best_y;
    c.begun = true;
    c.split = -1;
    c.choice = {};
    // Nothing is left but what this assignment does not heed.
    const bool near = reached >= 0 && best >= reached * (1 - kNear);
    if (near) type_ = reached_by;
    decide(c, share, rounds, best, near);
  }

  /// Whether those that are fixed overload a type: no policy is in this case.
  [[nodiscard]] bool overloaded(const Case& c) const {
    for (std::size_t t = 0; t < types_; ++t) {
      Int load = 0;
      for (std::size_t i = 0; i < c.left.size(); ++i)
        if (c.left[i] == 1U << t)
          load += Int{work_[i * types_ + t]} * kOne / p_.period_of(static_cast<int>(i));
      if (load > static_cast<Int>(p_.type_xpus[t].size()) * kOne) return true;
    }
    return false;
  }

 private:
  /// The cheapest type of each, and the load that follows.
  void assign(const Case& c, const Visits& visits, const std::vector<double>& y,
              std::vector<double>& load) {
    std::fill(load.begin(), load.end(), 0.0);
    for (std::size_t i = 0; i < type_.size(); ++i) {
      const auto period = static_cast<double>(p_.period_of(static_cast<int>(i)));
      const double mean = visits.mean(i);
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const double cost = (mean + y[t] / period) * static_cast<double>(work_[i * types_ + t]);
        if (least < 0 || cost < least) {
          least = cost;
          type_[i] = static_cast<int>(t);
        }
      }
      if (least < 0) continue;
      load[at(type_[i])] += static_cast<double>(work_[i * types_ + at(type_[i])]) / period;
    }
  }

  /// Longest paths by `type_`: of each term, or of the term that is largest.
  Visits::Pick pick(double& value) {
    Visits::Pick sum, largest, way, longest;
    std::size_t piece = 0;
    value = 0;
    for (std::size_t k = 0; k < objective_.terms.size(); ++k) {
      const Term& term = objective_.terms[k];
      double most = -1;
      for (const LoadWay& w : term.ways) {
        const double takes = follow(w, piece, objective_.weight[k], way);
        piece += w.pieces.size();
        if (takes > most) {
          most = takes;
          std::swap(longest, way);
        }
      }
      if (most < static_cast<double>(term.known)) {
        most = static_cast<double>(term.known);
        longest = {{}, {}, Int{term.known} * objective_.weight[k]};
      }
      const double weighted = most * static_cast<double>(objective_.weight[k]);
      if (objective_.largest) {
        if (weighted <= value) continue;
        value = weighted;
        std::swap(largest, longest);
      } else {
        value += weighted;
        sum.visits.insert(sum.visits.end(), longest.visits.begin(), longest.visits.end());
        sum.met.insert(sum.met.end(), longest.met.begin(), longest.met.end());
        sum.waits += longest.waits;
      }
    }
    return objective_.largest ? largest : sum;
  }

  /// Its longest path in each piece, whose orders begin at `piece`. Less than 0: there is none.
  double follow(const LoadWay& way, std::size_t piece, std::int64_t weight, Visits::Pick& pick) {
    pick.visits.clear();
    pick.met.clear();
    pick.waits = Int{way.ready + way.waits} * weight;
    auto sum = static_cast<double>(way.ready + way.waits);
    for (const Piece& q : way.pieces) {
      const std::vector<int>& order = order_[piece++];
      for (const int i : order) until_[at(i)] = -1;
      for (const int i : q.from) until_[at(i)] = 0, by_[at(i)] = -1;
      for (const int i : order) {
        for (const EdgeEnd& link : p_.pred[at(i)])
          if (p_.before(link.xnode, q.to) && until_[at(link.xnode)] > until_[at(i)]) {
            until_[at(i)] = until_[at(link.xnode)];
            by_[at(i)] = link.xnode;
          }
        if (until_[at(i)] >= 0)
          until_[at(i)] +=
              static_cast<double>(work_[at(i) * types_ + at(type_[at(i)])] + case_->longer[at(i)]);
      }
      if (until_[at(q.to)] < 0) return -1;
      sum += until_[at(q.to)];
      std::vector<int> path;
      for (int i = q.to; i >= 0; i = by_[at(i)]) {
        pick.visits.emplace_back(i, weight);
        path.push_back(i);
      }
      std::reverse(path.begin(), path.end());
      sum += static_cast<double>(meets(path, weight, pick));
    }
    return sum;
  }

  double estimate(const Case& c, const Visits& visits, const std::vector<double>& y) const {
    double sum = static_cast<double>(visits.waits) / static_cast<double>(visits.picks);
    for (std::size_t i = 0; i < type_.size(); ++i) {
      const auto period = static_cast<double>(p_.period_of(static_cast<int>(i)));
      const double mean = visits.mean(i);
      double least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const double cost = (mean + y[t] / period) * static_cast<double>(work_[i * types_ + t]);
        if (least < 0 || cost < least) least = cost;
      }
      sum += std::max(0.0, least) + mean * static_cast<double>(c.longer[i]);
    }
    for (std::size_t t = 0; t < types_; ++t) sum -= y[t] * count_[t];
    return sum + static_cast<double>(of_choices(c, visits)) / static_cast<double>(visits.picks);
  }

  /// In integers, rounded down.
  [[nodiscard]] Int exact(const Case& c, const std::vector<double>& y) const {
    std::vector<Int> price;
    // A negative mean is rounded down, too.
    Int sum = best_.waits / best_.picks - (best_.waits < 0 ? 1 : 0);
    for (std::size_t t = 0; t < types_; ++t) {
      if (y[t] > kMostPrice) return 0;
      price.push_back(static_cast<Int>(y[t]));
      sum -= price[t] * static_cast<Int>(p_.type_xpus[t].size());
    }
    for (std::size_t i = 0; i < best_.of.size(); ++i) {
      Int least = -1;
      for (std::size_t t = 0; t < types_; ++t) {
        if (((c.left[i] >> t) & 1U) == 0) continue;
        const Int work = work_[i * types_ + t];
        const Int cost =
            work * best_.of[i] / best_.picks + work * price[t] / p_.period_of(static_cast<int>(i));
        if (least < 0 || cost < least) least = cost;
      }
      if (least > 0) sum += least;
      sum += Int{c.longer[i]} * best_.of[i] / best_.picks;
    }
    sum += of_choices(c, best_) / best_.picks;
    return std::max<Int>(0, sum);
  }

  [[nodiscard]] bool fits(const std::vector<double>& load) const {
    for (std::size_t t = 0; t < types_; ++t)
      if (load[t] > count_[t]) return false;
    return true;
  }

  /// The choices of XPUs that are the one of their type, among those of which `is_on` says that they
  /// are there, and on some way; of many the heaviest.
  template <class IsOn>
  [[nodiscard]] std::vector<Disjunction> open_choices(const Case& c, IsOn is_on) const {
    std::vector<Disjunction> open;
    for (std::size_t t = 0; t < types_; ++t) {
      if (p_.type_xpus[t].size() != 1) continue;
      std::vector<int> on;
      bool meet = false;
      for (std::size_t i = 0; i < c.left.size(); ++i) {
        if (on_way_[i] == 0 || !is_on(i, t)) continue;
        on.push_back(static_cast<int>(i));
        meet = meet || p_.domain_of(on.front()) != p_.domain_of(on.back());
      }
      if (!meet) continue;
      std::stable_sort(on.begin(), on.end(), [&](int a, int b) {
        return work_[at(a) * types_ + t] > work_[at(b) * types_ + t];
      });
      on.resize(std::min(on.size(), kMostOnXpu));
      for (const Disjunction& choice : choices_on(p_, p_.type_xpus[t].front(), on, kMostInThrees))
        if (!holds(choice, c)) open.push_back(choice);
    }
    return open;
  }

  [[nodiscard]] static bool holds(const Disjunction& choice, const Case& c) {
    return std::any_of(choice.options.begin(), choice.options.begin() + choice.count,
                       [&](const auto& option) {
                         return std::all_of(option.begin(), option.end(), [&](const Longer& l) {
                           return l.xnode < 0 || c.longer[at(l.xnode)] >= l.by;
                         });
                       });
  }

  /// What a choice adds to the sum of the picks, whoever it is.
  [[nodiscard]] static Int gain(const Disjunction& choice, const Case& c, const Visits& visits) {
    Int least = -1;
    for (std::size_t k = 0; k < choice.count; ++k) {
      Int sum = 0;
      for (const Longer& l : choice.options[k])
        if (l.xnode >= 0)
          sum += Int{std::max(Tick{0}, l.by - c.longer[at(l.xnode)])} * visits.of[at(l.xnode)];
      if (least < 0 || sum < least) least = sum;
    }
    return least;
  }

  template <class Visit>
  static void for_each_of(const Disjunction& choice, const Visit& visit) {
    for (std::size_t k = 0; k < choice.count; ++k)
      for (const Longer& l : choice.options[k])
        if (l.xnode >= 0) visit(l.xnode);
  }

  /// The sum of choices without a common XNode, the largest first. What is in a stretch that meets
  /// itself counts there.
  [[nodiscard]] Int of_choices(const Case& c, const Visits& visits) const {
    if (choices_.empty()) return 0;
    std::vector<std::pair<Int, const Disjunction*>> gains;
    for (const Disjunction& choice : choices_)
      if (const Int g = gain(choice, c, visits); g > 0) gains.emplace_back(g, &choice);
    std::stable_sort(gains.begin(), gains.end(),
                     [](const auto& a, const auto& b) { return a.first > b.first; });
    std::vector<char> used(c.left.size(), 0);
    Int sum = 0;
    for (const auto& [g, choice] : gains) {
      bool free = true;
      for_each_of(*choice,
                  [&](int i) { free = free && used[at(i)] == 0 && visits.met[at(i)] == 0; });
      if (!free) continue;
      for_each_of(*choice, [&](int i) { used[at(i)] = 1; });
      sum += g;
    }
    return sum;
  }

  /// Options that cost nobody who is picked may make others the longest: if so, one of these choices.
  const Disjunction* not_free(const Case& c, const std::vector<Disjunction>& open, double value) {
    if (open.empty()) return nullptr;
    Case trial = c;
    std::vector<const Disjunction*> by(c.left.size(), nullptr);
    for (const Disjunction& choice : open) {
      if (holds(choice, trial)) continue;
      std::size_t cheapest = 0;
      Tick least = kNoTick;
      for (std::size_t k = 0; k < choice.count; ++k) {
        Tick more = 0;
        bool free = true;
        for (const Longer& l : choice.options[k])
          if (l.xnode >= 0 && l.by > trial.longer[at(l.xnode)]) {
            more += l.by - trial.longer[at(l.xnode)];
            free = free && best_.of[at(l.xnode)] == 0;
          }
        if (free && (least == kNoTick || more < least)) {
          least = more;
          cheapest = k;
        }
      }
      for (const Longer& l : choice.options[cheapest])
        if (l.xnode >= 0 && l.by > trial.longer[at(l.xnode)]) {
          trial.longer[at(l.xnode)] = l.by;
          by[at(l.xnode)] = &choice;
        }
    }
    case_ = &trial;
    double longest = 0;
    const Visits::Pick picked = pick(longest);
    case_ = &c;
    if (longest <= value * (1 + kNear)) return nullptr;
    const Disjunction* most = nullptr;
    Tick longer = 0;
    for (const auto& [i, weight] : picked.visits)
      if (by[at(i)] != nullptr && trial.longer[at(i)] - c.longer[at(i)] > longer) {
        longer = trial.longer[at(i)] - c.longer[at(i)];
        most = by[at(i)];
      }
    return most;
  }

  /// What is to be decided next: the type of an XNode that is much split, or of one that adds
  /// something if it is where the ascent has it, a choice, or the type of anybody.
  void decide(Case& c, const std::vector<double>& share, int rounds, double value, bool reached) {
    const auto minor = [&](std::size_t i) {
      double largest = 0, sum = 0;
      for (std::size_t t = 0; t < types_; ++t) {
        largest = std::max(largest, share[i * types_ + t]);
        sum += share[i * types_ + t];
      }
      return (sum - largest) * (best_.of[i] > 0 ? kOnWayCounts : 1);
    };
    double most = kMuchSplit * rounds;
    if (!reached)
      for (std::size_t i = 0; i < c.left.size(); ++i)
        if (const double weight = minor(i); !is_fixed(c.left[i]) && weight > most) {
          most = weight;
          c.split = static_cast<int>(i);
        }
    if (c.split >= 0) return;
    // What the ascent has somewhere where it meets others.
    const std::vector<Disjunction> open =
        open_choices(c, [&](std::size_t i, std::size_t t) { return at(type_[i]) == t; });
    const Disjunction* next = nullptr;
    Int best = 0;
    for (const Disjunction& choice : open)
      if (const Int g = gain(choice, c, best_); g > best) {
        best = g;
        next = &choice;
      }
    if (next == nullptr) next = not_free(c, open, value);
    if (next != nullptr) {
      for_each_of(*next, [&](int i) {
        if (!is_fixed(c.left[at(i)])) c.split = i;
      });
      if (c.split < 0) c.choice = *next;
      return;
    }
    unfixed_.clear();
    all_fixed_ = true;
    double all = 0;
    pick(all);
    all_fixed_ = false;
    if (!unfixed_.empty()) {
      c.split = unfixed_.front();
      return;
    }
    if (reached) return;
    most = -1;
    for (std::size_t i = 0; i < c.left.size(); ++i)
      if (const double weight = minor(i); !is_fixed(c.left[i]) && weight > most) {
        most = weight;
        c.split = static_cast<int>(i);
      }
  }

  /// What a path, by `type_`, is longer by since its activations meet, in stretches that have no XNode
  /// in common. Of types that are fixed, or, `all_fixed_`, as if all were.
  Tick meets(const std::vector<int>& path, std::int64_t weight, Visits::Pick& pick) {
    const std::size_t n = path.size();
    const Tick period = p_.period_of(path.front());
    if (n < 2 || !repeats_at_once(p_, path.front())) return 0;
    std::vector<Tick> ends(n + 1, 0);
    std::vector<std::size_t> unfixed(n + 1, 0);
    const auto work = [&](std::size_t k) {
      return work_[at(path[k]) * types_ + at(type_[at(path[k])])];
    };
    for (std::size_t k = 0; k < n; ++k) {
      ends[k + 1] = ends[k] + work(k) + case_->longer[at(path[k])];
      unfixed[k + 1] = unfixed[k] + (is_fixed(case_->left[at(path[k])]) ? 0 : 1);
    }
    if (ends[n] < period) return 0;
    struct Best {
      Tick sum = 0;
      std::size_t begin = 0, end = 0;  ///< of its last stretch
    };
    std::vector<Best> best(n + 1);
    for (std::size_t b = 1; b < n; ++b) {
      best[b + 1] = best[b];
      const std::size_t t = at(type_[at(path[b])]);
      if (p_.type_xpus[t].size() != 1) continue;
      for (std::size_t a = 0; a < b; ++a) {
        if (at(type_[at(path[a])]) != t || (!all_fixed_ && unfixed[a] != unfixed[b + 1])) continue;
        const Tick more = meets_itself(period, work(a), work(b), ends[b + 1] - ends[a],
                                       case_->longer[at(path[a])] + case_->longer[at(path[b])]);
        if (more > 0 && best[a].sum + more > best[b + 1].sum)
          best[b + 1] = {best[a].sum + more, a, b + 1};
      }
    }
    pick.waits += Int{best[n].sum} * weight;
    for (std::size_t end = n; best[end].sum > 0; end = best[end].begin)
      for (std::size_t k = best[end].begin; k < best[end].end; ++k) {
        pick.met.push_back(path[k]);
        if (!is_fixed(case_->left[at(path[k])])) unfixed_.push_back(path[k]);
      }
    return best[n].sum;
  }

  const Problem& p_;
  Objective objective_;
  std::size_t types_ = 0;
  std::vector<Tick> work_;  ///< [xnode * types + type]
  std::vector<double> count_;
  std::vector<std::vector<int>> order_;  ///< [piece] its XNodes, in topological order
  std::vector<double> until_;
  std::vector<int> by_, type_;
  std::vector<char> on_way_;  ///< [xnode] whether some way may visit it
  Visits best_;
  const Case* case_ = nullptr;
  std::vector<Disjunction> choices_;  ///< of the case, that nothing has decided
  bool all_fixed_ = false;
  std::vector<int> unfixed_;  ///< in stretches that would meet themselves
};

/// In units of 2^-20.
Int bound_of_cases(const Problem& p, const Objective& objective, int most_cases,
                   const Until& until) {
  if (p.num_types > kMostTypes) return 0;
  Int visits = 0;
  std::size_t steps = at(p.num_xnodes) * at(p.num_types);
  for (std::size_t k = 0; k < objective.terms.size(); ++k)
    for (const LoadWay& way : objective.terms[k].ways)
      for (const Piece& piece : way.pieces) {
        visits += Int{objective.weight[k]} * kPicks;
        steps += p.components[at(p.component_of[at(piece.to)])].xnodes.size();
      }
  if (visits > kMostVisits || steps > kMostStepsOfRound) return 0;
  Bounder bounder(p, objective);
  const auto later = [](const Case& a, const Case& b) { return a.bound > b.bound; };
  std::priority_queue<Case, std::vector<Case>, decltype(later)> open(later);
  Case first = bounder.whole();
  bounder.bound(first, until);
  open.push(std::move(first));
  for (int cases = 0; cases < most_cases && !until.over() && !open.top().closed(); ++cases) {
    const Case c = open.top();
    const auto look_at = [&](Case next) {
      if (bounder.overloaded(next)) return;
      bounder.bound(next, until);
      open.push(std::move(next));
    };
    open.pop();
    if (c.split >= 0) {
      for (int t = 0; t < p.num_types; ++t) {
        if (((c.left[at(c.split)] >> t) & 1U) == 0) continue;
        Case next = c;
        next.left[at(c.split)] = 1U << t;
        look_at(std::move(next));
      }
    } else {
      for (std::size_t k = 0; k < c.choice.count; ++k) {
        Case next = c;
        for (const Longer& l : c.choice.options[k])
          if (l.xnode >= 0) next.longer[at(l.xnode)] = std::max(next.longer[at(l.xnode)], l.by);
        look_at(std::move(next));
      }
    }
    if (open.empty()) return c.bound;  // no policy is in any case
  }
  return open.top().bound;
}

double down(double value) {
  return value <= 0 ? 0 : std::nextafter(value, 0.0);
}

double divided_bound(const Problem& p, const std::vector<Term>& terms, bool sum, int most_cases,
                     const Until& until) {
  const Weights weights(terms, sum);
  return weights.value(bound_of_cases(p, {terms, weights.of, !sum}, most_cases, until));
}

}  // namespace

Weights::Weights(const std::vector<Term>& terms, bool sum) {
  for (const Term& term : terms) longest = std::max(longest, term.by);
  for (const Term& term : terms)
    of.push_back(static_cast<std::int64_t>(
        std::min<Int>((Int{sum ? term.weight : 1} * longest << kShift) / term.by, kMostWeight)));
}

double Weights::value(Int units) const {
  return down(down(static_cast<double>(units) / static_cast<double>(kOne)) /
              static_cast<double>(longest));
}

Tick load_bound(const Problem& p, const std::vector<LoadWay>& ways, int most_cases,
                const Until& until) {
  const std::vector<Term> one = {{ways}};
  return static_cast<Tick>(std::min<Int>(
      bound_of_cases(p, {one, {kOne}, true}, most_cases, until) >> kShift, kMostTicks));
}

double sum_bound(const Problem& p, const std::vector<Term>& terms, int most_cases,
                 const Until& until) {
  return divided_bound(p, terms, true, most_cases, until);
}

double largest_bound(const Problem& p, const std::vector<Term>& terms, int most_cases,
                     const Until& until) {
  return divided_bound(p, terms, false, most_cases, until);
}

}  // namespace xauto::solver::keys
