// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/joint_bound.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

namespace xauto::solver::keys {
namespace {

using Int = __int128;

/// Shares of weights are whole, in units of 2^-24.
constexpr int kShareShift = 24;
constexpr std::int64_t kShares = std::int64_t{1} << kShareShift;
/// What is summed stays below, with room: else nothing is said.
constexpr double kMostJointValue = 0x1p124;

// The ascent. A worse one bounds less, nothing wrong; none of these is tuned: chosen.
constexpr int kMostClimbs = 240, kPricesEvery = 8;
/// Shares are multiplied by exp of what they bring more, relative, times this, which falls as 1 / (1 + slower * round).
constexpr double kShareStep = 2, kShareStepSlower = 0.05;
/// What prices are tried to be multiplied by: at first, later, and above what.
constexpr double kPriceFactor = 4, kPriceFactorAgain = 1.2, kLeastPriceFactor = 1.04;
/// It ends where so many rounds brought less than this part.
constexpr int kClimbsAtOnce = 24;
constexpr double kLeastClimb = 1e-5;
/// Of the largest price, as a whole number.
constexpr double kPriceUnits = 4096;

/// One machine that serves, of what has come, always the first by `rank`. What is served of each is weighed by
/// when: the integral of 2 * time.
template <class Number>
class OneMachine {
 public:
  struct Job {
    Number release{}, work{};
  };
  std::vector<Job> jobs;
  std::vector<Number> moment;  ///< [job] of run()

  /// `by_release`, `by_rank`: all jobs, in these orders.
  void run(const std::vector<int>& by_release, const std::vector<int>& by_rank) {
    const std::size_t n = jobs.size();
    moment.assign(n, Number{0});
    left_.resize(n);
    rank_.resize(n);
    for (std::size_t k = 0; k < n; ++k) {
      rank_[at(by_rank[k])] = static_cast<int>(k);
      left_[k] = jobs[k].work;
    }
    ready_.clear();
    Number now{0};
    std::size_t next = 0;
    while (next < n || !ready_.empty()) {
      if (ready_.empty()) now = std::max(now, jobs[at(by_release[next])].release);
      for (; next < n && jobs[at(by_release[next])].release <= now; ++next) {
        if (left_[at(by_release[next])] <= 0) continue;
        ready_.push_back(rank_[at(by_release[next])]);
        std::push_heap(ready_.begin(), ready_.end(), std::greater<>());
      }
      if (ready_.empty()) continue;
      const std::size_t job = at(by_rank[at(ready_.front())]);
      Number until = now + left_[job];
      const bool ends = next == n || until <= jobs[at(by_release[next])].release;
      if (!ends) until = jobs[at(by_release[next])].release;
      moment[job] += (until - now) * (until + now);
      left_[job] -= until - now;
      now = until;
      if (!ends) continue;
      std::pop_heap(ready_.begin(), ready_.end(), std::greater<>());
      ready_.pop_back();
    }
  }

 private:
  std::vector<Number> left_;
  std::vector<int> rank_, ready_;
};

class JointAscent {
 public:
  JointAscent(const Problem& p, const std::vector<Term>& terms, const std::vector<Ending>& endings,
              bool sum)
      : p_(p),
        terms_(terms),
        sum_(sum),
        types_(at(p.num_types)),
        weights_(terms, sum),
        weight_(weights_.of),
        job_of_(at(p.num_xnodes), -1) {
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      first_.push_back(targets_.size());
      for (const Tail& tail : endings[k].tails) {
        int& job = job_of_[at(tail.xnode)];
        if (job < 0) {
          job = static_cast<int>(xnode_.size());
          xnode_.push_back(tail.xnode);
        }
        targets_.push_back({job, tail.tail - endings[k].offset});
      }
    }
    first_.push_back(targets_.size());
    describe_jobs();
  }

  [[nodiscard]] double bound(const Until& until) {
    if (xnode_.empty()) return 0;
    climb(until);
    return exact();
  }

 private:
  struct Target {
    int job;
    Tick after;  ///< from the job's end to the end of the chain, less the source's release
  };

  void describe_jobs() {
    std::vector<Tick> head(at(p_.num_xnodes), 0);
    const std::vector<Tick> least = least_wcets(p_);
    for (const Component& c : p_.components)
      for (const int i : c.xnodes) {
        head[at(i)] = c.phase + (p_.root[at(i)] != 0 ? arrival(c, p_.root_ready[at(i)]) : 0);
        for (const EdgeEnd& link : p_.pred[at(i)])
          if (p_.component_of[at(link.xnode)] == p_.component_of[at(i)])
            head[at(i)] = std::max(head[at(i)], head[at(link.xnode)] + least[at(link.xnode)]);
      }
    for (const int i : xnode_) {
      head_.push_back(head[at(i)]);
      least_.push_back(least[at(i)]);
      work_.insert(work_.end(), types_, kNoTick);
      for (const int m : p_.may_run[at(i)])
        work_[work_.size() - types_ + at(p_.xpu_type[at(m)])] = p_.wcet(i, m);
    }
    by_release_.resize(xnode_.size());
    std::iota(by_release_.begin(), by_release_.end(), 0);
    std::stable_sort(by_release_.begin(), by_release_.end(),
                     [&](int a, int b) { return head_[at(a)] < head_[at(b)]; });
  }

  /// Of a root, whose latest arrival is `ready` where its clock may be slow: at least so late where it is exact.
  [[nodiscard]] Tick arrival(const Component& c, Tick ready) const {
    const std::int64_t ppm = p_.domains[at(c.domain)].ppm;
    if (ppm == 0 || ready == 0) return ready;
    return static_cast<Tick>(Int{ready - 1} * kMillion / (kMillion + ppm));
  }

  /// All work, and heads, at these prices. In units of time times `speed`.
  template <class Number>
  void describe(OneMachine<Number>& machine, const std::vector<Number>& price, Number speed) const {
    machine.jobs.resize(xnode_.size());
    for (std::size_t j = 0; j < xnode_.size(); ++j) {
      Number least{-1};
      for (std::size_t t = 0; t < types_; ++t) {
        if (work_[j * types_ + t] == kNoTick) continue;
        const Number work = price[t] * static_cast<Number>(work_[j * types_ + t]);
        if (least < 0 || work < least) least = work;
      }
      machine.jobs[j] = {static_cast<Number>(head_[j]) * speed, least};
    }
  }

  template <class Number>
  [[nodiscard]] Number speed_of(const std::vector<Number>& price) const {
    Number speed{0};
    for (std::size_t t = 0; t < types_; ++t)
      speed += price[t] * static_cast<Number>(p_.type_xpus[t].size());
    return speed;
  }

  /// Who has the largest share for its work comes first. What is no work is not served.
  [[nodiscard]] static std::vector<int> ranked(const OneMachine<Int>& machine,
                                               const std::vector<Int>& share) {
    std::vector<int> order(machine.jobs.size());
    std::iota(order.begin(), order.end(), 0);
    const auto work = std::stable_partition(order.begin(), order.end(),
                                            [&](int j) { return machine.jobs[at(j)].work == 0; });
    std::stable_sort(work, order.end(), [&](int a, int b) {
      return share[at(a)] * machine.jobs[at(b)].work > share[at(b)] * machine.jobs[at(a)].work;
    });
    return order;
  }
  [[nodiscard]] static std::vector<int> ranked(const OneMachine<double>& machine,
                                               const std::vector<double>& share) {
    std::vector<int> order(machine.jobs.size());
    std::iota(order.begin(), order.end(), 0);
    std::vector<double> first(machine.jobs.size(), 0);
    for (std::size_t j = 0; j < first.size(); ++j)
      if (machine.jobs[j].work > 0) first[j] = share[j] / machine.jobs[j].work;
    std::stable_sort(order.begin(), order.end(),
                     [&](int a, int b) { return first[at(a)] > first[at(b)]; });
    return order;
  }

  /// The value at these shares and prices; `gain_`: what each target brings.
  double value(const std::vector<double>& price) {
    const double speed = speed_of(price);
    if (speed <= 0) return 0;
    describe(machine_, price, speed);
    share_.assign(xnode_.size(), 0);
    for (std::size_t k = 0; k < terms_.size(); ++k)
      for (std::size_t g = first_[k]; g < first_[k + 1]; ++g)
        share_[at(targets_[g].job)] += part_[g] * static_cast<double>(weight_[k]);
    machine_.run(by_release_, ranked(machine_, share_));
    double sum = 0;
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      const auto weight = static_cast<double>(weight_[k]);
      for (std::size_t g = first_[k]; g < first_[k + 1]; ++g) {
        const std::size_t j = at(targets_[g].job);
        const auto& job = machine_.jobs[j];
        const double mean = job.work > 0 ? machine_.moment[j] / (2 * job.work) : job.release;
        gain_[g] = weight * (mean / speed + static_cast<double>(least_[j]) / 2 +
                             static_cast<double>(targets_[g].after));
        sum += part_[g] * gain_[g];
      }
      sum += kept_[k] * weight * static_cast<double>(terms_[k].known);
    }
    return sum;
  }

  /// Of a chain as much for each piece of work: then none of its XNodes is more urgent than another.
  void begin() {
    describe(machine_, price_, speed_of(price_));
    const double of_each = sum_ ? 1.0 : 1.0 / static_cast<double>(terms_.size());
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      double all = 0;
      for (std::size_t g = first_[k]; g < first_[k + 1]; ++g)
        all += machine_.jobs[at(targets_[g].job)].work;
      for (std::size_t g = first_[k]; g < first_[k + 1]; ++g)
        part_[g] =
            of_each * kFirstOnXNodes * machine_.jobs[at(targets_[g].job)].work / std::max(all, 1.0);
      kept_[k] = of_each * (all > 0 ? 1 - kFirstOnXNodes : 1);
    }
  }

  /// Of a sum each chain's shares are one; of the largest all together.
  void move_shares(double step) {
    for (std::size_t from = 0; from < terms_.size();) {
      const std::size_t to = sum_ ? from + 1 : terms_.size();
      double most = 0, all = 0;
      for (std::size_t g = first_[from]; g < first_[to]; ++g) most = std::max(most, gain_[g]);
      for (std::size_t k = from; k < to; ++k) most = std::max(most, known(k));
      if (most > 0) {
        for (std::size_t g = first_[from]; g < first_[to]; ++g)
          all += part_[g] *= std::exp(step * (gain_[g] / most - 1));
        for (std::size_t k = from; k < to; ++k)
          all += kept_[k] *= std::exp(step * (known(k) / most - 1));
        for (std::size_t g = first_[from]; g < first_[to]; ++g) part_[g] /= all;
        for (std::size_t k = from; k < to; ++k) kept_[k] /= all;
      }
      from = to;
    }
  }

  [[nodiscard]] double known(std::size_t k) const {
    return static_cast<double>(weight_[k]) * static_cast<double>(terms_[k].known);
  }

  /// Each price by itself, as long as that brings something, in smaller and smaller steps.
  void climb_prices(double factor, const Until& until) {
    double now = value(price_);
    while (factor > kLeastPriceFactor) {
      bool better = false;
      for (std::size_t t = 0; t < types_; ++t)
        for (const double by : {factor, 1 / factor}) {
          if (price_[t] <= 0 || until.over()) break;
          std::vector<double> other = price_;
          other[t] *= by;
          const double then = value(other);
          if (then <= now) continue;
          now = then;
          price_ = std::move(other);
          better = true;
          break;
        }
      if (!better) factor = std::sqrt(factor);
    }
  }

  void climb(const Until& until) {
    price_.assign(types_, 0);
    for (std::size_t j = 0; j < xnode_.size(); ++j)
      for (std::size_t t = 0; t < types_; ++t)
        if (work_[j * types_ + t] != kNoTick) price_[t] = 1;
    part_.assign(targets_.size(), 0);
    gain_.assign(targets_.size(), 0);
    kept_.assign(terms_.size(), 0);
    begin();
    climb_prices(kPriceFactor, until);
    begin();
    double best = 0, before = 0;
    std::vector<double> best_part = part_, best_kept = kept_, best_price = price_;
    for (int round = 0; round < kMostClimbs && !until.over(); ++round) {
      if (round % kPricesEvery == 0)
        climb_prices(round == 0 ? kPriceFactor : kPriceFactorAgain, until);
      const double now = value(price_);
      if (now > best) {
        best = now;
        best_part = part_;
        best_kept = kept_;
        best_price = price_;
      }
      if (round % kClimbsAtOnce == kClimbsAtOnce - 1) {
        if (best < before * (1 + kLeastClimb)) break;
        before = best;
      }
      move_shares(kShareStep / (1 + kShareStepSlower * round));
    }
    part_ = best_part;
    kept_ = best_kept;
    price_ = best_price;
  }

  /// The same in integers, of shares and prices that are whole. What rounding leaves of the shares stays on bounds.
  [[nodiscard]] double exact() const {
    const double dearest = *std::max_element(price_.begin(), price_.end());
    std::vector<Int> price;
    for (const double y : price_) price.push_back(std::llround(y / dearest * kPriceUnits));
    const Int speed = speed_of(price);
    OneMachine<Int> machine;
    describe(machine, price, speed);
    std::vector<Int> share(xnode_.size(), 0);
    Int sum = 0;
    double size = 0;  // of what is summed
    std::int64_t left = kShares;
    Int best_known = 0;
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      if (sum_) left = kShares;
      const Int known = Int{weight_[k]} * terms_[k].known;
      best_known = std::max(best_known, known);
      for (std::size_t g = first_[k]; g < first_[k + 1]; ++g) {
        const auto part = std::min(left, static_cast<std::int64_t>(part_[g] * kShares));
        left -= part;
        share[at(targets_[g].job)] += Int{part} * weight_[k];
        sum += Int{part} * weight_[k] * targets_[g].after * speed;
        size += static_cast<double>(part) * static_cast<double>(weight_[k]) *
                std::abs(static_cast<double>(targets_[g].after)) * static_cast<double>(speed);
      }
      const std::int64_t kept =
          sum_ ? left : std::min(left, static_cast<std::int64_t>(kept_[k] * kShares));
      left -= kept;
      sum += Int{kept} * known * speed;
      size += static_cast<double>(kept) * static_cast<double>(known) * static_cast<double>(speed);
    }
    if (!sum_) sum += Int{left} * best_known * speed;
    // The machine's times, and products of them, of shares with work and with means.
    double end = 0, most_share = 0;
    for (std::size_t j = 0; j < xnode_.size(); ++j) {
      end = std::max(end, static_cast<double>(machine.jobs[j].release));
      most_share = std::max(most_share, static_cast<double>(share[j]));
    }
    for (const auto& job : machine.jobs) end += static_cast<double>(job.work);
    const double all = static_cast<double>(xnode_.size());
    if (end * end > kMostJointValue || most_share * end * all + size > kMostJointValue) return 0;
    machine.run(by_release_, ranked(machine, share));
    for (std::size_t j = 0; j < xnode_.size(); ++j) {
      const auto& job = machine.jobs[j];
      const Int mean = job.work > 0 ? machine.moment[j] / (2 * job.work) : job.release;
      sum += share[j] * (mean + Int{least_[j]} * speed / 2);
    }
    return weights_.value(std::max<Int>(0, sum / speed >> kShareShift));
  }

  /// Of a chain's weight, at first.
  static constexpr double kFirstOnXNodes = 0.95;

  const Problem& p_;
  const std::vector<Term>& terms_;
  bool sum_;
  std::size_t types_;
  Weights weights_;
  const std::vector<std::int64_t>& weight_;  ///< [term]
  std::vector<int> job_of_, xnode_;          ///< [xnode], [job]
  std::vector<Target> targets_;
  std::vector<std::size_t> first_;    ///< [term] of its targets
  std::vector<Tick> head_, least_;    ///< [job]
  std::vector<Tick> work_;            ///< [job * types + type]
  std::vector<int> by_release_;       ///< jobs
  std::vector<double> part_, gain_;   ///< [target]
  std::vector<double> kept_, price_;  ///< [term], [type]
  std::vector<double> share_;         ///< [job]
  OneMachine<double> machine_;
};

}  // namespace

double joint_bound(const Problem& p, const std::vector<Term>& terms,
                   const std::vector<Ending>& endings, bool sum, const Until& until) {
  return JointAscent(p, terms, endings, sum).bound(until);
}

}  // namespace xauto::solver::keys
