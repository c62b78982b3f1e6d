// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/uncertified.h"

#include <algorithm>
#include <atomic>
#include <limits>
#include <tuple>

#include "model/contention.h"
#include "solver/keys/sustain.h"

namespace xauto::solver::keys {
namespace {

// Parts of the time, and of the budget, for one search. Chosen.
constexpr double kForProbe = 0.3, kForLast = 0.3, kForUsual = 0.6;
/// Where a percentage is too much and none is known that is not, so many percent of it are tried. Chosen.
constexpr std::int64_t kFirstPart = 75;
constexpr std::int64_t kPartOfBudget = 8;
constexpr double kLeastS = 0.02;  ///< for one search
/// A play is about so many jobs, within these limits of seconds.
constexpr double kPlayedJobs = 100'000;
constexpr std::int64_t kMostSeconds = 100;

double seconds_until(TimePoint deadline) {
  return std::chrono::duration<double>(deadline - std::chrono::steady_clock::now()).count();
}

std::int64_t shorter(std::int64_t us, std::int64_t percent) {
  return std::max<std::int64_t>(1, (us * percent + 99) / 100);
}

/// Units by falling load, each to the XPU that is least loaded with it; an activation's keys are a period after the
/// longest ways of what comes before.
Policy constructed(const Problem& p) {
  Policy policy;
  policy.placements.resize(at(p.num_xnodes));
  const auto rate = [&](const std::vector<int>& unit, int m) {
    double sum = 0;
    for (const int i : unit) {
      // Also where it takes longer than its period, which Problem::may_run leaves out.
      if (p.wcet(i, m) == kNoTick) return std::numeric_limits<double>::infinity();
      sum += static_cast<double>(p.wcet(i, m)) / static_cast<double>(p.period_of(i));
    }
    return sum;
  };
  std::vector<std::pair<double, std::vector<int>>> by_load;
  for (const std::vector<int>& unit : units(p)) {
    double least = std::numeric_limits<double>::infinity();
    for (int m = 0; m < p.num_xpus; ++m) least = std::min(least, rate(unit, m));
    by_load.emplace_back(least, unit);
  }
  std::ranges::stable_sort(by_load, [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<double> load(at(p.num_xpus), 0);
  for (const auto& [least, unit] : by_load) {
    int best = 0;
    for (int m = 1; m < p.num_xpus; ++m)
      if (load[at(m)] + rate(unit, m) < load[at(best)] + rate(unit, best)) best = m;
    load[at(best)] += rate(unit, best);
    for (const int i : unit) policy.placements[at(i)].xpu = best;
  }
  std::vector<Tick> key(at(p.num_xnodes), 0);
  for (const Component& c : p.components)
    for (const int i : c.xnodes) {
      const int m = policy.placements[at(i)].xpu;
      if (p.root[at(i)] != 0) key[at(i)] = c.period + p.root_ready[at(i)];
      for (const EdgeEnd& link : p.pred[at(i)])
        key[at(i)] =
            std::max(key[at(i)], key[at(link.xnode)] +
                                     p.transfer(link, policy.placements[at(link.xnode)].xpu, m));
      key[at(i)] += p.wcet(i, m);
      policy.placements[at(i)].key_us = {p.up_to_us(key[at(i)]) / p.scale};
    }
  return policy;
}

/// What is least first. Where something has a deadline, no more than that it is met counts of the largest.
struct Lateness {
  bool backlog = false;
  double largest = 0, sum = 0;
  bool operator<(const Lateness& o) const {
    return std::tie(backlog, largest, sum) < std::tie(o.backlog, o.largest, o.sum);
  }
};

Lateness lateness(const AppSpec& app, const PlayReport& played, std::int64_t seconds) {
  std::vector<std::int64_t> longest_us;
  for (const PlayedChain& chain : played.chains)
    longest_us.push_back(chain.releases > 0 ? static_cast<std::int64_t>(chain.longest_us)
                                            : seconds * kMillion);
  const Totals totals = totals_of(app, longest_us);
  return {played.backlog, app.has_deadlines() ? std::max(1.0, totals.largest) : 0, totals.sum};
}

class LeastLate {
 public:
  LeastLate(const AppSpec& app, const Platform& platform, const Options& options)
      : app_(app), platform_(platform), options_(options), usual_(at_usual_times(app)) {
    deadline_ = std::chrono::steady_clock::now() +
                std::chrono::duration_cast<TimePoint::duration>(std::chrono::duration<double>(
                    std::clamp(options.time_limit_s, 0.0, kNoLimitS)));
  }

  Result<Uncertified> find() {
    XAUTO_ASSIGN(const Problem p, Problem::create(usual_, platform_, options_.wishes));
    double jobs_a_second = 0;
    for (int i = 0; i < p.num_xnodes; ++i)
      jobs_a_second +=
          static_cast<double>(p.scale * kMillion) / static_cast<double>(p.period_of(i));
    found_.seconds = std::clamp(static_cast<std::int64_t>(kPlayedJobs / jobs_a_second),
                                std::int64_t{1}, kMostSeconds);
    add(search(usual_, kForProbe, Enough::kInTime));
    find_percents();
    add(search(usual_, kForUsual, Enough::kTheEnd));
    // The newest was searched for longest, or is for the longest jobs.
    std::ranges::reverse(candidates_);
    candidates_.push_back(constructed(p));
    for (const Policy& candidate : candidates_)
      if (found_.policy.placements.empty() || !over()) offer(candidate);
    found_.policy.app = app_.name;
    found_.policy.app_hash = app_.hash();
    found_.policy.platform = platform_.name;
    found_.policy.method = "auto";
    XAUTO_ASSIGN(const Problem at_wcets, Problem::create(app_, platform_, options_.wishes));
    found_.load.resize(platform_.xpus.size());
    for (int i = 0; i < p.num_xnodes; ++i) {
      const int m = found_.policy.placements[at(i)].xpu;
      const auto part = [&](const Problem& of) {
        return static_cast<double>(of.wcet(i, m)) / static_cast<double>(of.period_of(i));
      };
      found_.load[at(m)].at_wcets += part(at_wcets);
      found_.load[at(m)].usual += part(p);
    }
    return std::move(found_);
  }

 private:
  [[nodiscard]] bool over() const {
    return seconds_until(deadline_) <= 0 || (options_.stop != nullptr && options_.stop->load());
  }

  enum class Enough { kTheEnd, kFirst, kInTime };

  std::optional<Certifies> search(const AppSpec& app, double part, Enough enough) {
    if (over()) return std::nullopt;
    Options asked = options_;
    asked.on_progress = nullptr;
    asked.time_limit_s = std::max(kLeastS, seconds_until(deadline_));
    if (options_.max_evaluations > 0)
      asked.max_evaluations = std::max<std::int64_t>(1, options_.max_evaluations / kPartOfBudget);
    else
      asked.time_limit_s = std::max(kLeastS, part * asked.time_limit_s);
    std::optional<Certifies> answer;
    if (enough != Enough::kTheEnd) {
      if (auto one = certifies(app, platform_, asked, enough == Enough::kInTime))
        answer = std::move(*one);
    } else if (auto best = solve(app, platform_, asked)) {
      answer =
          Certifies{best->outcome, misses_a_deadline(best->policy, app), std::move(best->policy)};
    }
    return answer;
  }

  void add(const std::optional<Certifies>& answer) {
    if (answer && answer->outcome == Outcome::kPolicy) candidates_.push_back(answer->policy);
  }

  /// With all WCETs at the largest percentage that is certified; then at that with which no deadline is missed.
  void find_percents() {
    std::int64_t high = 101;
    const auto proven = [&](std::int64_t percent) {
      const auto p = Problem::create(at_percent(app_, percent), platform_, options_.wishes);
      return p && prove_overload(*p).has_value();
    };
    for (std::int64_t fits = 0; high - fits > 1 && !over();) {
      const std::int64_t middle = (fits + high) / 2;
      (proven(middle) ? high : fits) = middle;
    }
    if (high <= 100) found_.overloaded_pct = high;
    found_.certified_pct = largest(high, false);
    if (!found_.certified_pct) return;
    const auto last = search(at_percent(app_, *found_.certified_pct), kForLast, Enough::kTheEnd);
    add(last);
    if (last && last->outcome == Outcome::kPolicy && !last->late)
      found_.in_time_pct = found_.certified_pct;
    else
      found_.in_time_pct = largest(*found_.certified_pct, true);
  }

  /// Below a percentage that is too much, by halves, from where a first policy is likely: it ends a search.
  std::optional<std::int64_t> largest(std::int64_t high, bool in_time) {
    std::int64_t low = 0;
    std::optional<Certifies> best;
    while (high - low > 1 && !over()) {
      const std::int64_t percent =
          low > 0 ? (low + high) / 2 : std::max<std::int64_t>(1, high * kFirstPart / 100);
      auto answer =
          search(at_percent(app_, percent), kForProbe, in_time ? Enough::kInTime : Enough::kFirst);
      if (answer && answer->outcome == Outcome::kUnsustainable) found_.overloaded_pct = percent;
      const bool enough =
          answer && answer->outcome == Outcome::kPolicy && !(in_time && answer->late);
      (enough ? low : high) = percent;
      if (enough) best = std::move(answer);
    }
    add(best);
    return low > 0 ? std::optional(low) : std::nullopt;
  }

  /// Plays it, and takes it if it is less late than the best so far.
  void offer(Policy policy) {
    policy.certified = false;
    policy.app = usual_.name;
    policy.app_hash = usual_.hash();
    policy.chains.clear();
    bool bare = policy.order.empty();
    for (Placement& placed : policy.placements) {
      placed.start_us.clear();
      placed.finish_us.clear();
      placed.wcet_us.reset();
      bare = bare && placed.hold_us.empty();
    }
    judge(policy);
    if (bare) return;
    policy.order.clear();
    for (Placement& placed : policy.placements) placed.hold_us.clear();
    judge(policy);
  }

  void judge(const Policy& policy) {
    PlayOptions asked;
    asked.seconds = found_.seconds;
    asked.jitter = asked.phases = asked.urgent = true;
    asked.seed = options_.seed;
    auto played = play(usual_, platform_, policy, asked);
    if (!played) {
      if (found_.policy.placements.empty()) found_.policy = policy;
      return;
    }
    const Lateness late = lateness(app_, *played, found_.seconds);
    if (found_.played && !(late < late_)) return;
    late_ = late;
    found_.policy = policy;
    found_.played = std::move(*played);
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Options& options_;
  const AppSpec usual_;
  TimePoint deadline_;
  std::vector<Policy> candidates_;
  Uncertified found_;
  Lateness late_;
};

}  // namespace

AppSpec at_usual_times(AppSpec app) {
  app = at_longest(std::move(app));
  for (XNodeSpec& xnode : app.xnodes) {
    for (auto& [type, wcet] : xnode.wcet_us) {
      const auto typical = xnode.typical_us.find(type);
      wcet = typical == xnode.typical_us.end() ? shorter(wcet, kUsualPct) : typical->second;
    }
    xnode.typical_us.clear();
  }
  return app;
}

AppSpec at_percent(AppSpec app, std::int64_t percent) {
  app = at_longest(std::move(app));
  for (XNodeSpec& xnode : app.xnodes) {
    for (auto& [type, wcet] : xnode.wcet_us) wcet = shorter(wcet, percent);
    xnode.typical_us.clear();  // they may be longer
  }
  return app;
}

Result<Certifies> certifies(const AppSpec& app, const Platform& platform, const Options& options,
                            bool in_time) {
  Options asked = options;
  std::atomic<bool> enough{options.stop != nullptr && options.stop->load()};
  asked.stop = &enough;
  asked.on_progress = [&](const Progress& progress) {
    if (!in_time || progress.late <= 1 || (options.stop != nullptr && options.stop->load()))
      enough = true;
  };
  XAUTO_ASSIGN(Answer answer, solve(app, platform, asked));
  return Certifies{answer.outcome, misses_a_deadline(answer.policy, app), std::move(answer.policy)};
}

Result<Uncertified> least_late(const AppSpec& app, const Platform& platform,
                               const Options& options) {
  return LeastLate(app, platform, options).find();
}

}  // namespace xauto::solver::keys
