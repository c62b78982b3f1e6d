// SPDX-License-Identifier: Apache-2.0
#include "bench/tables/changes.h"

#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "solver/random.h"

namespace xauto::bench {
namespace {

using Us = std::int64_t;

/// What a release needs to be played; indices are of XNodes and of the platform's XPUs.
struct World {
  std::vector<std::vector<int>> before;                 ///< edges
  std::vector<std::vector<std::vector<Us>>> wcet;       ///< [scenario][xnode][xpu]; -1: cannot
  std::vector<std::vector<std::vector<int>>> queue_of;  ///< [table][xpu] its XNodes, in order
  std::vector<std::vector<std::int64_t>> priority;      ///< [table][xnode]
  std::vector<std::size_t> module_of;                   ///< [xnode]
  std::size_t modules = 0;
  std::vector<char> preempts;  ///< [xpu]
};

/// The order in which a table runs the XNodes of an XPU: its priorities agree with its pairs.
std::vector<std::vector<int>> queues(const Table& table, std::size_t xpus) {
  std::vector<std::vector<int>> all(xpus);
  for (std::size_t i = 0; i < table.xpu.size(); ++i)
    all[static_cast<std::size_t>(table.xpu[i])].push_back(static_cast<int>(i));
  for (auto& queue : all)
    std::sort(queue.begin(), queue.end(), [&](int a, int b) {
      return table.priority[static_cast<std::size_t>(a)] >
             table.priority[static_cast<std::size_t>(b)];
    });
  return all;
}

World world_of(const AppSpec& app, const Platform& platform, const Tables& tables) {
  World w;
  w.before.resize(app.xnodes.size());
  for (const auto& [u, v] : app.edges) w.before[static_cast<std::size_t>(v)].push_back(u);
  for (const Scenario& scenario : tables.scenarios) {
    const AppSpec scaled = app_under(app, scenario);
    w.wcet.emplace_back();
    for (const XNodeSpec& x : scaled.xnodes) {
      w.wcet.back().emplace_back();
      for (const Xpu& xpu : platform.xpus)
        w.wcet.back().back().push_back(x.wcet_on(xpu.type).value_or(-1));
    }
  }
  for (const Table& table : tables.tables) {
    w.queue_of.push_back(queues(table, platform.xpus.size()));
    w.priority.push_back(table.priority);
  }
  std::map<std::string, std::size_t> number;
  for (const XNodeSpec& x : app.xnodes)
    w.module_of.push_back(number.emplace(x.module, number.size()).first->second);
  w.modules = number.size();
  for (const Xpu& xpu : platform.xpus) w.preempts.push_back(xpu.preemptive ? 1 : 0);
  return w;
}

/// One release, instant by instant. `share`: of its WCET, in 1/1000, per XNode. A job that is under
/// way at the change takes its share of the larger WCET. `moves`: what has not begun by then goes to
/// table q's XPUs. Each XPU runs its queue in order.
Us play(const World& w, std::size_t s, std::size_t t, std::size_t p, std::size_t q, Us change,
        const std::vector<int>& share, bool moves) {
  const std::size_t n = w.before.size(), xpus = w.queue_of[p].size();
  constexpr Us kNotYet = -1;
  std::vector<Us> end(n, kNotYet), free_at(xpus, 0);
  std::vector<char> begun(n, 0);
  std::vector<std::size_t> next(xpus, 0);
  std::vector<std::vector<int>> queue = w.queue_of[p];
  bool changed = false;
  Us latency = 0;
  for (std::size_t left = n; left > 0;) {
    // The earliest start among the heads of all queues.
    Us best = std::numeric_limits<Us>::max();
    std::size_t on = 0;
    for (std::size_t x = 0; x < xpus; ++x) {
      while (next[x] < queue[x].size() && begun[static_cast<std::size_t>(queue[x][next[x]])] != 0)
        ++next[x];
      if (next[x] == queue[x].size()) continue;
      Us ready = free_at[x];
      for (const int u : w.before[static_cast<std::size_t>(queue[x][next[x]])])
        ready = end[static_cast<std::size_t>(u)] == kNotYet
                    ? std::numeric_limits<Us>::max()
                    : std::max(ready, end[static_cast<std::size_t>(u)]);
      if (ready < best) {
        best = ready;
        on = x;
      }
    }
    if (best == std::numeric_limits<Us>::max()) return best;  // they wait for each other
    if (moves && !changed && best >= change) {
      changed = true;
      queue = w.queue_of[q];
      std::fill(next.begin(), next.end(), 0);
      for (Us& at : free_at) at = std::max(at, change);
      continue;
    }
    const auto i = static_cast<std::size_t>(queue[on][next[on]]);
    const Us before = w.wcet[s][i][on], after = w.wcet[t][i][on];
    const auto takes = [&](Us wcet) { return wcet * share[i] / 1000; };
    Us time = best >= change ? takes(after) : takes(before);
    if (best < change && best + time > change) time = takes(std::max(before, after));
    begun[i] = 1;
    end[i] = free_at[on] = best + time;
    latency = std::max(latency, end[i]);
    --left;
  }
  return latency;
}

/// A change of scenario s, table p, to scenario t, table q.
struct Pair {
  std::size_t s = 0, t = 0, p = 0, q = 0;
  Us change_us = 0;  ///< claimed of a release that meets it
  Us own_us = 0;     ///< claimed of one under t
  Us period_us = 0;
};

/// Releases 0, 1, ... a period apart; the first has table p, and the scenario changes during it; the
/// others have table q.
class Releases {
 public:
  static constexpr std::size_t kCount = 3;
  using Shares = std::array<std::vector<int>, kCount>;

  Releases(const World& world, const Pair& pair) : w_(world), of_(pair) {}

  /// Latencies from nominal releases. Within a release each XPU keeps its table's order. `waits`: a
  /// release begins when the one before has ended. Else the one of the higher priority has the XPU,
  /// takes it where the XPU is preemptive, at no cost, and of equal ones the older release.
  std::array<Us, kCount> play(Us change, const Shares& share, bool waits) {
    change_ = change;
    share_ = &share;
    waits_ = waits;
    const std::size_t n = w_.before.size(), xpus = w_.preempts.size();
    for (One& one : ones_) {
      one.left.assign(n, kNotBegun);
      one.next.assign(xpus, 0);
      one.in_module.assign(w_.modules, 0);
      for (const std::size_t m : w_.module_of) ++one.in_module[m];
      one.jobs = n;
      one.end = -1;
    }
    running_.assign(xpus, {});
    bool changed = change == 0;
    for (Us now = 0; ones_.back().jobs > 0;) {
      if (!changed && now >= change) {
        changed = true;
        grow();
      }
      Us next = changed ? std::numeric_limits<Us>::max() : change;
      for (std::size_t r = 1; r < kCount; ++r)
        if (nominal(r) > now) next = std::min(next, nominal(r));
      for (std::size_t x = 0; x < xpus; ++x) {
        running_[x] = chosen(x, now);
        if (running_[x].xnode >= 0) next = std::min(next, now + begun(running_[x], x, now));
      }
      for (std::size_t x = 0; x < xpus; ++x) advance(x, next - now, next);
      now = next;
    }
    std::array<Us, kCount> latency{};
    for (std::size_t r = 0; r < kCount; ++r) latency[r] = ones_[r].end - nominal(r);
    return latency;
  }

 private:
  static constexpr Us kNotBegun = -1, kEnded = -2;
  struct One {
    std::vector<Us> left;           ///< [xnode]
    std::vector<std::size_t> next;  ///< [xpu] in its queue
    std::vector<int> in_module;     ///< jobs that have not ended
    std::size_t jobs = 0;           ///< likewise
    Us end = -1;
  };
  struct Job {
    std::size_t release = 0;
    int xnode = -1;
  };

  [[nodiscard]] Us nominal(std::size_t r) const { return static_cast<Us>(r) * of_.period_us; }
  [[nodiscard]] std::size_t table(std::size_t r) const { return r == 0 ? of_.p : of_.q; }
  [[nodiscard]] Us takes(std::size_t r, std::size_t i, Us wcet) const {
    return wcet * (*share_)[r][i] / 1000;
  }

  [[nodiscard]] bool ready(std::size_t r, std::size_t i, Us now) const {
    if (now < nominal(r)) return false;
    if (r > 0) {
      const One& last = ones_[r - 1];
      // A module is in one activation at a time.
      if (waits_ ? last.jobs > 0 : last.in_module[w_.module_of[i]] > 0) return false;
    }
    return std::all_of(w_.before[i].begin(), w_.before[i].end(),
                       [&](int u) { return ones_[r].left[static_cast<std::size_t>(u)] == kEnded; });
  }

  [[nodiscard]] Job chosen(std::size_t x, Us now) const {
    const Job had = running_[x];
    if (had.xnode >= 0 && w_.preempts[x] == 0) return had;
    Job best;
    Us most = 0;
    for (std::size_t r = 0; r < kCount; ++r) {
      const std::vector<int>& queue = w_.queue_of[table(r)][x];
      if (ones_[r].next[x] == queue.size()) continue;
      const int i = queue[ones_[r].next[x]];
      const Us priority = w_.priority[table(r)][static_cast<std::size_t>(i)];
      if (best.xnode >= 0 && priority <= most) continue;
      if (!ready(r, static_cast<std::size_t>(i), now)) continue;
      best = {r, i};
      most = priority;
    }
    return best;
  }

  /// What is left of it, which begins now if it has not.
  Us begun(const Job& job, std::size_t x, Us now) {
    const auto i = static_cast<std::size_t>(job.xnode);
    Us& left = ones_[job.release].left[i];
    if (left == kNotBegun)
      left = takes(job.release, i, w_.wcet[now >= change_ ? of_.t : of_.s][i][x]);
    return left;
  }

  /// A job that is under way at the change takes its share of the larger WCET.
  void grow() {
    for (std::size_t x = 0; x < running_.size(); ++x)
      for (const int k : w_.queue_of[of_.p][x]) {
        const auto i = static_cast<std::size_t>(k);
        if (ones_[0].left[i] < 0) continue;
        const Us before = w_.wcet[of_.s][i][x], after = w_.wcet[of_.t][i][x];
        ones_[0].left[i] += takes(0, i, std::max(before, after)) - takes(0, i, before);
      }
  }

  void advance(std::size_t x, Us by, Us now) {
    Job& job = running_[x];
    if (job.xnode < 0) return;
    const auto i = static_cast<std::size_t>(job.xnode);
    One& one = ones_[job.release];
    one.left[i] -= by;
    if (one.left[i] > 0) return;
    one.left[i] = kEnded;
    ++one.next[x];
    --one.in_module[w_.module_of[i]];
    if (--one.jobs == 0) one.end = now;
    job = {};
  }

  const World& w_;
  const Pair& of_;
  Us change_ = 0;
  const Shares* share_ = nullptr;
  bool waits_ = false;
  std::array<One, kCount> ones_;
  std::vector<Job> running_;  ///< [xpu]
};

/// Plays of one rule, with a climb of its own.
struct Climb {
  Releases::Shares worst;
  Us instant = 0;
  double longest = 0;
};

void attack_pair(const World& w, const Pair& pair, std::int64_t plays, solver::Random& random,
                 Overlap& waits, Overlap& own) {
  const std::size_t n = w.before.size();
  const auto share = [&] { return static_cast<int>(random.below(1001)); };
  // So late comes a release under the new table at most, by XAuto's rule.
  const Us late = std::max<Us>(0, pair.change_us - pair.period_us);
  Releases releases(w, pair);
  Climb climbs[2];
  for (Climb& climb : climbs) climb.worst.fill(std::vector<int>(n, 1000));
  for (std::int64_t k = 0; k < plays; ++k) {
    Releases::Shares drawn;
    for (std::vector<int>& of : drawn)
      for (std::size_t i = 0; i < n; ++i) of.push_back(random.below(4) == 0 ? share() : 1000);
    const Us at = static_cast<Us>(random.below(static_cast<std::uint64_t>(pair.period_us) + 1));
    for (const bool wait : {true, false}) {
      Climb& climb = climbs[wait ? 0 : 1];
      Overlap& to = wait ? waits : own;
      const bool near = k % 3 == 1;  // the worst so far
      Releases::Shares shares = near ? climb.worst : drawn;
      if (near) shares[random.below(shares.size())][random.below(n)] = share();
      const Us instant = near ? climb.instant : at;
      const auto latency = releases.play(instant, shares, wait);
      const auto of = [](Us us, Us bound) {
        return static_cast<double>(us) / static_cast<double>(bound);
      };
      const double first = of(latency[0], pair.change_us);
      const double others =
          of(*std::max_element(latency.begin() + 1, latency.end()), late + pair.own_us);
      const double longest = std::max(first, others);
      const bool met = latency[0] > pair.period_us;
      ++to.plays;
      to.above += longest > 1;
      to.first_above += first > 1;
      to.others_above += others > 1;
      to.worst = std::max(to.worst, longest);
      to.met += met;
      if (!near && met) {
        ++to.drawn;
        to.first_of_claim += first;
        to.next_of_own += of(latency[1], pair.own_us);
      }
      if (longest >= climb.longest) climb = {shares, instant, longest};
    }
  }
}

}  // namespace

void Overlap::add(const Overlap& more) {
  plays += more.plays;
  above += more.above;
  first_above += more.first_above;
  others_above += more.others_above;
  worst = std::max(worst, more.worst);
  met += more.met;
  drawn += more.drawn;
  first_of_claim += more.first_of_claim;
  next_of_own += more.next_of_own;
}

Rules attack_rules(const AppSpec& app, const Platform& platform, const Tables& tables,
                   std::int64_t plays, std::uint64_t seed) {
  const World w = world_of(app, platform, tables);
  solver::Random random(seed);
  std::vector<Pair> pairs;
  for (const Change& change : tables.changes) {
    if (!change.worst_case_us) continue;
    const Served &from = tables.serves[static_cast<std::size_t>(change.from)],
                 &to = tables.serves[static_cast<std::size_t>(change.to)];
    const Us period = std::max(from.worst_case_us, to.worst_case_us);
    if (from.table == to.table || *change.worst_case_us <= period) continue;
    pairs.push_back({static_cast<std::size_t>(change.from), static_cast<std::size_t>(change.to),
                     static_cast<std::size_t>(from.table), static_cast<std::size_t>(to.table),
                     *change.worst_case_us, to.worst_case_us, period});
  }
  Rules rules;
  rules.pairs = static_cast<std::int64_t>(pairs.size());
  for (const Pair& pair : pairs)
    attack_pair(w, pair, plays / rules.pairs + 1, random, rules.waits, rules.own);
  return rules;
}

Attack attack_changes(const AppSpec& app, const Platform& platform, const Tables& tables,
                      std::int64_t releases, std::uint64_t seed) {
  const World w = world_of(app, platform, tables);
  solver::Random random(seed);
  std::vector<const Change*> claimed;
  for (const Change& change : tables.changes)
    if (change.worst_case_us) claimed.push_back(&change);
  Attack attack;
  if (claimed.empty()) return attack;
  const std::int64_t each = releases / static_cast<std::int64_t>(claimed.size()) + 1;
  for (const Change* const change : claimed) {
    const auto s = static_cast<std::size_t>(change->from), t = static_cast<std::size_t>(change->to);
    const auto p = static_cast<std::size_t>(tables.serves[s].table),
               q = static_cast<std::size_t>(tables.serves[t].table);
    const Us bound = *change->worst_case_us;
    const Us either = std::max(tables.serves[s].worst_case_us, tables.serves[t].worst_case_us);
    // Each protocol has its own climb.
    for (const bool moves : {false, true}) {
      std::vector<int> worst(app.xnodes.size(), 1000), shares = worst;
      Us worst_instant = 0, longest = 0;
      for (std::int64_t k = 0; k < each; ++k) {
        Us instant = static_cast<Us>(random.below(static_cast<std::uint64_t>(either) + 1));
        if (k % 3 == 1) {
          shares = worst;  // around the worst so far
          shares[random.below(shares.size())] = static_cast<int>(random.below(1001));
          instant = worst_instant;
        } else {
          for (int& share : shares)
            share = random.below(4) == 0 ? static_cast<int>(random.below(1001)) : 1000;
        }
        const Us latency = play(w, s, t, p, q, instant, shares, moves);
        if (latency >= longest) {
          longest = latency;
          worst = shares;
          worst_instant = instant;
        }
        if (moves) {
          attack.moved_above += latency > either;
        } else {
          ++attack.releases;
          attack.above += latency > bound;
        }
      }
      double& most = moves ? attack.moved_worst : attack.nearest;
      most = std::max(most,
                      static_cast<double>(longest) / static_cast<double>(moves ? either : bound));
    }
  }
  return attack;
}

}  // namespace xauto::bench
