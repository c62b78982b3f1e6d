// SPDX-License-Identifier: Apache-2.0
// Components and domains of an app: which XNodes release together, and which releases
// come round again. docs/keys.md.
//
// A tick is the longest time that every period is a whole number of: 1 / ticks_per_us microseconds.
// In ticks all nominal releases are integers.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

/// XNodes joined by edges. All sources that they hear of have one clock and one period. Its
/// activation n has the nominal release offset + n * period.
struct Component {
  std::vector<int> xnodes;   ///< ascending
  std::vector<int> sources;  ///< that its XNodes hear of, ascending
  std::vector<int> modules;  ///< indices into AppSpec::modules, ascending
  int clock = 0;             ///< index into AppSpec::clocks
  int domain = 0;            ///< index into Components::domains
  Period period;
  std::int64_t offset_us = 0;  ///< the least of its sources' (phi)
  std::int64_t period_ticks = 0, offset_ticks = 0;
  /// Activations per hyperperiod (q); 0: that does not fit.
  std::int64_t activations = 0;
};

/// The components of one clock. Their releases repeat every hyperperiod.
struct Domain {
  int clock = 0;
  std::vector<int> components;  ///< ascending
  /// Least common multiple of the periods; nullopt: beyond kMaxHyperperiodTicks.
  std::optional<std::int64_t> hyperperiod_ticks;
  /// Jobs of all XNodes per hyperperiod; 0: they do not fit.
  std::int64_t jobs = 0;
};

struct Components {
  std::int64_t ticks_per_us = 1;
  std::vector<int> of;                ///< [xnode] index into `components`
  std::vector<Component> components;  ///< by their least XNode
  std::vector<Domain> domains;        ///< by clock; clocks that nobody hears of have none
};

/// Their activations of one number have one nominal release: one clock, period and offset.
[[nodiscard]] inline bool released_together(const Components& all, int one, int other) {
  const Component &a = all.components[static_cast<std::size_t>(one)],
                  &b = all.components[static_cast<std::size_t>(other)];
  return a.clock == b.clock && a.period == b.period && a.offset_us == b.offset_us;
}

/// A time of kMaxTimeUs is at most 10^18 ticks: a sum of nine such fits.
inline constexpr std::int64_t kMaxTicksPerUs = 1'000'000;
/// A quarter of what fits, so that a release plus a window does.
inline constexpr std::int64_t kMaxHyperperiodTicks = INT64_MAX / 4;

/// That what edges join has one clock and one period. Part of find_components.
[[nodiscard]] Status check_joins(const AppSpec& app);
/// Of an app whose edges are acyclic and whose XNodes hear of what there is. Refused:
/// a component with two clocks or two periods, a module in two components, periods without a tick.
[[nodiscard]] Result<Components> find_components(const AppSpec& app);

}  // namespace xauto
