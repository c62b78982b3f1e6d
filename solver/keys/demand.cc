// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/demand.h"

#include <algorithm>

namespace xauto::solver::keys {
namespace {

constexpr std::size_t kMostSteps = 200'000;
constexpr double kLoadError = 1e-9;            ///< that is rounding, not overload
constexpr std::size_t kMostLoose = 1'000'000;  ///< of a curve, before what is below others goes

/// Nominal length -> a real one that is not longer: the clock may be fast by ppm, and moves the
/// releases of two jobs, at most `length + deepest` apart, against each other.
Tick shortest(Tick length, const Pattern& g) {
  if (g.ppm == 0) return length;
  const __int128 lost =
      (static_cast<__int128>(length + 2 * g.deepest) * g.ppm + kMillion - 1) / kMillion;
  return length - static_cast<Tick>(lost);
}

/// A function of the length of an interval: `value` from `length` on. Both rise.
struct Step {
  Tick length, value;
};

/// Largest value up to each length.
void envelope(std::vector<Step>& steps) {
  std::sort(steps.begin(), steps.end(), [](const Step& a, const Step& b) {
    return a.length != b.length ? a.length < b.length : a.value > b.value;
  });
  std::size_t kept = 0;
  for (const Step& s : steps)
    if (kept == 0 || s.value > steps[kept - 1].value) steps[kept++] = s;
  steps.resize(kept);
}

struct Curves {
  std::vector<Step> due, arrived;
};

/// Both curves of one pattern, for lengths up to `horizon`. False: too many steps.
bool curves(const Pattern& g, Tick horizon, std::size_t& budget, Curves& out) {
  out.due.clear();
  out.arrived.clear();
  struct End {
    Tick length, work, window;
  };
  std::vector<End> ends;
  const std::size_t n = g.jobs.size();
  for (std::size_t s = 0; s < n; ++s) {
    ends.clear();
    Tick arrived = 0;
    Tick turn = 0;
    for (std::size_t k = s;;) {
      const WindowedJob& job = g.jobs[k];
      const Tick since = job.arrival + turn - g.jobs[s].arrival;
      if (since > horizon) break;
      if (budget-- == 0) return false;
      arrived += job.work;
      out.arrived.push_back({shortest(std::max(Tick{0}, since - g.slip), g), arrived});
      if (since + job.length <= horizon) ends.push_back({since + job.length, job.work, job.length});
      if (++k == n) {
        k = 0;
        turn += g.period;
      }
      if (g.once && k == s) break;
    }
    for (auto* steps : {&out.due, &out.arrived})
      if (steps->size() > kMostLoose) envelope(*steps);
    std::sort(ends.begin(), ends.end(),
              [](const End& a, const End& b) { return a.length < b.length; });
    Tick sum = 0, window = 0;
    for (const End& e : ends) {
      sum += e.work;
      // No interval that holds a window is shorter than that.
      window = std::max(window, e.window);
      out.due.push_back({shortest(std::max(e.length - g.slip, window), g), sum});
    }
  }
  envelope(out.due);
  envelope(out.arrived);
  return true;
}

void sort_by_arrival(Pattern& g) {
  std::sort(g.jobs.begin(), g.jobs.end(), [](const WindowedJob& a, const WindowedJob& b) {
    return a.arrival != b.arrival ? a.arrival < b.arrival : a.length < b.length;
  });
}

Tick block(const std::vector<Blocking>& blocking, Tick length) {
  Tick longest = 0;
  for (const Blocking& b : blocking)
    if (b.until > length) longest = std::max(longest, b.work);
  return longest;
}

/// Walks the sum of the curves `of`; `visit(length, sum)` at each step, false ends it.
template <class Visit>
void walk(const std::vector<Curves>& all, std::vector<Step> Curves::*of, const Visit& visit) {
  std::vector<std::size_t> next(all.size(), 0);
  std::vector<Tick> value(all.size(), 0);
  for (;;) {
    Tick length = 0;
    bool any = false;
    for (std::size_t g = 0; g < all.size(); ++g) {
      const auto& steps = all[g].*of;
      if (next[g] < steps.size() && (!any || steps[next[g]].length < length)) {
        length = steps[next[g]].length;
        any = true;
      }
    }
    if (!any) return;
    Tick sum = 0;
    for (std::size_t g = 0; g < all.size(); ++g) {
      const auto& steps = all[g].*of;
      while (next[g] < steps.size() && steps[next[g]].length <= length)
        value[g] = steps[next[g]++].value;
      sum += value[g];
    }
    if (!visit(length, sum)) return;
  }
}

/// By when all that arrives meanwhile has been served, or kNoTick: not within `known`. Up to there the curves
/// are whole: beyond, a pattern whose clock drifts may have more than has been laid out.
Tick busy_end(const std::vector<Curves>& all, Tick blocked, Tick known) {
  Tick sum_before = blocked;
  bool first = true;
  walk(all, &Curves::arrived, [&](Tick length, Tick sum) {
    // Until this step the sum was `sum_before`.
    if (!first && sum_before <= length) return false;
    first = length <= 0;  // everything that arrives at once
    sum_before = sum + blocked;
    return true;
  });
  return sum_before <= known ? std::max(sum_before, Tick{0}) : kNoTick;
}

}  // namespace

bool demand_fits(std::vector<Pattern>& patterns, const std::vector<Blocking>& blocking,
                 Tightest* tightest) {
  Tick work = 0, horizon = 0, blocked = 0;
  for (const Blocking& b : blocking) blocked = std::max(blocked, b.work);
  for (Pattern& g : patterns) {
    Tick most = 0;
    sort_by_arrival(g);
    for (const WindowedJob& job : g.jobs) {
      if (job.length < job.work) return false;
      work += job.work;
      most = std::max(most, job.work);
      if (work > kForever) return false;
    }
    horizon += 2 * most;
  }
  // More work than time fails in some interval, which may be long: no need to find it.
  double load = 0;
  for (const Pattern& g : patterns) {
    if (g.once) continue;
    double part = 0;
    for (const WindowedJob& job : g.jobs) part += static_cast<double>(job.work);
    load += part / static_cast<double>(g.period);
  }
  if (load > 1 + kLoadError) {
    if (tightest != nullptr) *tightest = {kMillion, static_cast<Tick>(load * kMillion) + 1};
    return false;
  }
  std::size_t budget = kMostSteps;
  std::vector<Curves> all(patterns.size());
  for (horizon += 2 * blocked; horizon < kForever; horizon *= 2) {
    for (std::size_t g = 0; g < patterns.size(); ++g)
      if (!curves(patterns[g], horizon, budget, all[g])) return false;
    // Beyond the horizon of the least of them a real length is not known: leave a margin.
    Tick known = horizon;
    for (const Pattern& g : patterns) known = std::min(known, shortest(horizon - g.slip, g));
    bool fits = true;
    if (tightest != nullptr) *tightest = {};
    const Tick end = busy_end(all, blocked, known);
    walk(all, &Curves::due, [&](Tick length, Tick sum) {
      if (length > known || (end != kNoTick && length > end)) return false;
      const Tick demand = sum + block(blocking, length);
      if (tightest != nullptr &&
          (tightest->demand == 0 || length - demand < tightest->length - tightest->demand))
        *tightest = {length, demand};
      fits = fits && demand <= length;
      return fits || tightest != nullptr;
    });
    if (!fits) return false;
    if (end != kNoTick) return true;
  }
  return false;
}

}  // namespace xauto::solver::keys
