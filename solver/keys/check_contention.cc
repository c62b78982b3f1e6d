// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/check_contention.h"

#include <algorithm>
#include <numeric>
#include <set>

#include <fmt/format.h>

namespace xauto::solver::keys::checking {
namespace contention {

/// Above so many pairs of windows two XNodes are said to meet.
constexpr std::int64_t kMostPairs = 50'000'000;

/// Beginnings of two windows that are at least or at most so far apart in real time.
struct Between {
  Ticks above, below;
};

/// The window of `y` begins above..below after that of `x` where they overlap: x = [r + e, r + d), y likewise.
Between overlap(const World& w, int x, std::int64_t n, int y, std::int64_t m) {
  return {w.earliest(x, n) - w.window(y, m).d, w.window(x, n).d - w.earliest(y, m)};
}

/// Whether so much of the clock may be in there, however fast it is.
bool may_be(Ticks distance, const Between& between, std::int64_t ppm) {
  return least(distance, ppm) < between.below && most(distance, ppm) > between.above;
}

/// They are released together, and who waits for whom counts.
bool meet_together(const World& w, int x, int y, const std::vector<std::int64_t>& after,
                   const std::vector<std::int64_t>& before) {
  const Component& c = w.home(x);
  for (std::int64_t n = 0; n < c.classes; ++n) {
    // The longest window of y is not known: activations are tried while any may be near enough.
    Ticks deepest = 0;
    for (const Window& window : w.windows[at(y)]) deepest = std::max(deepest, window.d);
    const Ticks span = most(w.window(x, n).d + deepest, c.ppm);
    const std::int64_t far = span / least(c.period, c.ppm) + 1;
    for (std::int64_t lag = -far; lag <= far; ++lag) {
      if (lag >= after[at(y)] || -lag >= before[at(y)]) continue;
      if (may_be(lag * c.period, overlap(w, x, n, y, n + lag), c.ppm)) return true;
    }
  }
  return false;
}

/// Of one clock: any two of their activations whose windows are of these classes are a multiple of g more apart.
bool meet_on_one_clock(const World& w, int x, int y) {
  const Component &of_x = w.home(x), &of_y = w.home(y);
  const Ticks g = std::gcd(of_x.pattern(), of_y.pattern());
  if (of_x.classes > kMostPairs / of_y.classes) return true;
  for (std::int64_t n = 0; n < of_x.classes; ++n)
    for (std::int64_t m = 0; m < of_y.classes; ++m) {
      const Between between = overlap(w, x, n, y, m);
      const Ticks first = of_y.phi + m * of_y.period - of_x.phi - n * of_x.period;
      // The least distance that is not too short, from below: the shortest that may last `above`.
      const Ticks short_of = least(between.above, of_x.ppm) - 1;
      Ticks distance = first + floor_div(static_cast<__int128>(short_of) - first, g) * g;
      while (most(distance, of_x.ppm) <= between.above) distance += g;
      if (least(distance, of_x.ppm) < between.below) return true;
    }
  return false;
}

/// Whether jobs of both may run at the same time.
class Meetings {
 public:
  Meetings(const World& w, int x)
      : w_(w), x_(x), after_(w.lags_after(x)), before_(w.lags_before(x)) {}
  [[nodiscard]] bool with(int y) const {
    const Component &mine = w_.home(x_), &other = w_.home(y);
    if (mine.clock != other.clock) return true;
    const bool together = mine.period == other.period && mine.phi == other.phi &&
                          mine.classes == other.classes && w_.part_of[at(x_)] == w_.part_of[at(y)];
    return together ? meet_together(w_, x_, y, after_, before_) : meet_on_one_clock(w_, x_, y);
  }

 private:
  const World& w_;
  int x_;
  std::vector<std::int64_t> after_, before_;
};

/// The least that is stated of a load of at least that much; of none, what it takes alone.
std::int64_t takes(const XNodeSpec& x, const std::string& on, const Load& met) {
  std::int64_t least_us = met.empty() ? x.wcet_us.find(on)->second : -1;
  for (const BesideSpec& stated : x.beside) {
    if (stated.on != on) continue;
    const bool as_much = std::ranges::all_of(met, [&](const auto& load) {
      const auto there = stated.load.find(load.first);
      return there != stated.load.end() && there->second >= load.second;
    });
    if (as_much && (least_us < 0 || stated.wcet_us < least_us)) least_us = stated.wcet_us;
  }
  return least_us;
}

}  // namespace contention

std::vector<Load> loads_met(const World& w) {
  const auto on = [&](std::size_t i) { return w.policy.placements[i].xpu; };
  std::vector<Load> met(w.app.xnodes.size());
  for (std::size_t i = 0; i < met.size(); ++i) {
    const std::string& own = w.platform.xpus[at(on(i))].type;
    std::set<std::string_view> types;
    for (const BesideSpec& stated : w.app.xnodes[i].beside)
      if (stated.on == own)
        for (const auto& load : stated.load) types.insert(load.first);
    if (types.empty()) continue;
    const contention::Meetings meets(w, static_cast<int>(i));
    std::vector<char> loaded(w.platform.xpus.size(), 0);
    for (std::size_t j = 0; j < met.size(); ++j) {
      char& there = loaded[at(on(j))];
      const std::string& type = w.platform.xpus[at(on(j))].type;
      if (on(j) == on(i) || there != 0 || !types.contains(type)) continue;
      there = meets.with(static_cast<int>(j)) ? 1 : 0;
      if (there != 0) ++met[i][type];
    }
  }
  return met;
}

Status prove_counted(const World& w, bool others) {
  if (std::ranges::all_of(w.app.xnodes, [](const XNodeSpec& x) { return x.beside.empty(); }))
    return {};
  const std::vector<Load> met = others ? std::vector<Load>(w.app.xnodes.size()) : loads_met(w);
  for (std::size_t i = 0; i < met.size(); ++i) {
    const XNodeSpec& x = w.app.xnodes[i];
    const Xpu& xpu = w.platform.xpus[at(w.policy.placements[i].xpu)];
    std::int64_t needs = contention::takes(x, xpu.type, met[i]);
    for (const BesideSpec& stated : x.beside)
      if (others && stated.on == xpu.type) needs = std::max(needs, stated.wcet_us);
    // Not w.wcet, which is longer by what a host's clock may be off. Where the policy says nothing the longest counts.
    const std::int64_t counted = w.policy.placements[i].wcet_us.value_or(needs);
    if (needs >= 0 && needs <= counted) continue;
    const std::string where = fmt::format("XNode '{}', XPU {}", x.name, xpu.id);
    if (others)
      return fail(ErrorCode::kInfeasible,
                  fmt::format("its policy counts {} us, and beside other apps it may take {} us",
                              counted, needs),
                  where, "solve it with --reserve or --beside: then the longest times count");
    return fail(
        ErrorCode::kInfeasible,
        needs < 0
            ? fmt::format("it may run beside {}, of which no time is stated", words_of(met[i]))
            : fmt::format("{} us are counted; it may run beside {}, where it takes {} us", counted,
                          words_of(met[i]), needs),
        where, "solve again");
  }
  return {};
}

}  // namespace xauto::solver::keys::checking
