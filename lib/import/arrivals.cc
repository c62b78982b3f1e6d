// SPDX-License-Identifier: Apache-2.0
#include "import/arrivals.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "model/components.h"

namespace xauto::import {
namespace {

constexpr double kNsPerS = 1e9;
constexpr double kMostDrift = 500e-6;            ///< of a clock that is slewed
constexpr std::int64_t kLeastDriftNs = 100'000;  ///< less is the machine's, not the clock's
constexpr std::size_t kLeastForDrift = 20;
constexpr double kRounded = 0.01;  ///< a rate as near to a whole one is that
constexpr double kMissed = 1.7;    ///< of the usual distance: a message did not come
/// By so much the instant that a timer was made may be told too late.
constexpr std::int64_t kToldLateNs = 50'000;

/// How much later than its grid a timer is called at least, first and last: a part of the time between.
double drift_of(const std::vector<std::int64_t>& starts, const Grid& grid, std::int64_t first,
                std::int64_t period) {
  if (starts.size() < kLeastForDrift) return 0;
  const auto earliest = [&](std::size_t from, std::size_t to) {
    std::pair<std::int64_t, std::int64_t> least{std::numeric_limits<std::int64_t>::max(), 0};
    for (std::size_t i = from; i < to; ++i)
      least = std::min(least, {starts[i] - first - grid.release[i] * period, grid.release[i]});
    return least;
  };
  const auto [early, at_early] = earliest(0, starts.size() / 2);
  const auto [late, at_late] = earliest(starts.size() / 2, starts.size());
  if (at_late <= at_early || std::abs(late - early) < kLeastDriftNs) return 0;
  const double drift =
      static_cast<double>(late - early) / static_cast<double>((at_late - at_early) * period);
  return std::abs(drift) < kMostDrift ? drift : 0;
}

/// Instants on a grid that begins so that none is early.
struct Fit {
  double period = 0, begin = 0, latest = 0;  ///< ns; begin: since the first instant
  std::vector<std::int64_t> release;
};

Fit fit_of(const std::vector<std::int64_t>& instants, double period) {
  Fit fit{period, 0, 0, {}};
  std::int64_t last = -1;
  for (const std::int64_t instant : instants) {
    const auto since = static_cast<double>(instant - instants.front());
    last = std::max(last + 1, static_cast<std::int64_t>(std::llround(since / period)));
    fit.release.push_back(last);
    const double off = since - static_cast<double>(last) * period;
    fit.begin = std::min(fit.begin, off);
    fit.latest = std::max(fit.latest, off);
  }
  fit.latest -= fit.begin;
  return fit;
}

}  // namespace

Period meant_period(double period_ns, double tolerance, std::int64_t round_us) {
  const double hz = std::round(kNsPerS / period_ns);
  if (hz >= 1 && hz <= 1e6 && std::abs(period_ns * hz / kNsPerS - 1) <= tolerance)
    if (const auto rate = Period::of_rate(std::to_string(static_cast<std::int64_t>(hz))))
      return *rate;
  const double rounds = std::round(period_ns / 1000 / static_cast<double>(round_us));
  return {std::clamp<std::int64_t>(static_cast<std::int64_t>(rounds) * round_us, 1, kMaxPeriodUs),
          1};
}

std::optional<Grid> timer_grid(const std::vector<std::int64_t>& starts_ns, std::int64_t made_ns,
                               std::int64_t period_ns) {
  if (period_ns < 1000 || period_ns > kMaxPeriodUs * 1000 || starts_ns.empty()) return std::nullopt;
  Grid grid;
  grid.period = meant_period(static_cast<double>(period_ns), 1e-6, 1);
  const std::int64_t first = made_ns + period_ns;
  std::int64_t last = -1;
  for (const std::int64_t start : starts_ns) {
    const std::int64_t k = std::max(last + 1, (start + kToldLateNs - first) / period_ns);
    grid.release.push_back(last = k);
  }
  if (static_cast<std::size_t>(last) >= kMaxReleases) return std::nullopt;
  const double drift = drift_of(starts_ns, grid, first, period_ns);
  for (std::int64_t k = 0; k <= last; ++k)
    grid.nominal_ns.push_back(
        first + k * period_ns +
        static_cast<std::int64_t>(drift * static_cast<double>(k * period_ns)));
  return grid;
}

std::optional<Grid> seen_grid(const std::vector<std::int64_t>& instants_ns) {
  if (instants_ns.size() < 3) return std::nullopt;
  std::vector<std::int64_t> apart;
  for (std::size_t i = 1; i < instants_ns.size(); ++i)
    apart.push_back(instants_ns[i] - instants_ns[i - 1]);
  std::ranges::nth_element(apart, apart.begin() + static_cast<std::ptrdiff_t>(apart.size() / 2));
  const auto usual = static_cast<double>(apart[apart.size() / 2]);
  if (usual < 1000 || usual > static_cast<double>(kMaxPeriodUs) * 1000) return std::nullopt;
  double count = 0;  // of periods, with those of which no message came
  for (const std::int64_t one : apart) {
    const double times = static_cast<double>(one) / usual;
    count += times > kMissed ? std::round(times) : 1;
  }
  const double seen = static_cast<double>(instants_ns.back() - instants_ns.front()) / count;
  const Period period = meant_period(seen, kRounded, 100);
  // What was meant, unless its clock runs otherwise.
  const double meant = static_cast<double>(period.num) * 1000 / static_cast<double>(period.den);
  Fit fit = fit_of(instants_ns, meant);
  if (Fit other = fit_of(instants_ns, seen); other.latest < fit.latest) fit = std::move(other);
  if (static_cast<std::size_t>(fit.release.back()) >= kMaxReleases) return std::nullopt;
  Grid grid;
  grid.period = period;
  for (std::int64_t k = 0; k <= fit.release.back(); ++k)
    grid.nominal_ns.push_back(
        instants_ns.front() +
        static_cast<std::int64_t>(fit.begin + static_cast<double>(k) * fit.period));
  grid.release = std::move(fit.release);
  return grid;
}

void settle_periods(AppSpec& app) {
  const auto common = [&app] {
    std::int64_t ticks = 1;
    for (const SourceSpec& source : app.sources)
      if (ticks <= kMaxTicksPerUs) ticks = std::lcm(ticks, source.period.den);
    return ticks;
  };
  while (common() > kMaxTicksPerUs) {
    Period& finest = std::ranges::max_element(app.sources, {}, [](const SourceSpec& s) {
                       return s.period.den;
                     })->period;
    finest = {std::max<std::int64_t>(1, (finest.num + finest.den / 2) / finest.den), 1};
  }
}

}  // namespace xauto::import
