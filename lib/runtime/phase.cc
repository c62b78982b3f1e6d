// SPDX-License-Identifier: Apache-2.0
#include "runtime/phase.h"

#include <algorithm>

namespace xauto::runtime {
namespace {

constexpr std::int64_t kRoundingNs =
    1000;  ///< our own: two clock readings, and periods that are fractions
constexpr std::int64_t kFollow = 16;  ///< of the distance to half the jitter, a part per message
constexpr int kMoved = 8;             ///< late ones in a row: the grid has moved, they are not late
constexpr std::int64_t kMostLeftOut = 1000;  ///< more are a sensor that was started anew

}  // namespace

std::optional<ClockPhase::Seen> ClockPhase::arrived(std::int64_t at_ns, const Grid::Source& source,
                                                    std::uint64_t next) {
  const std::int64_t jitter = source.jitter_ns, middle = jitter / 2;
  if (!base_ns_) {
    base_ns_ = at_ns - middle - source.due_ns(next);
    seen_ns_ = at_ns;
    return Seen{next, at_ns - middle, 0};
  }
  const std::int64_t tolerance =
      kRoundingNs +
      static_cast<std::int64_t>(static_cast<__int128>(at_ns - seen_ns_) * ppm_ / 1'000'000);
  seen_ns_ = at_ns;
  std::int64_t late = at_ns - *base_ns_ - source.due_ns(next);
  // As late as the one after it would be: it is that one.
  if (const std::int64_t period = source.period_ns();
      late > jitter + tolerance && late >= period - middle) {
    const std::int64_t skipped = std::max<std::int64_t>(1, (late + middle) / period);
    if (skipped <= kMostLeftOut) {
      next += static_cast<std::uint64_t>(skipped);
      late = at_ns - *base_ns_ - source.due_ns(next);
    }
  }
  if (next == 0 && late < -source.period_ns() / 2) return std::nullopt;
  const std::int64_t nominal = at_ns - late;
  if (late < 0) {  // whatever the jitter: its release was not after it
    late_ = 0;
    *base_ns_ += late;
    return Seen{next, at_ns, late < -tolerance ? -late : 0};
  }
  if (late > jitter) {
    const std::int64_t beyond = late - jitter;
    if (beyond <= tolerance) {
      *base_ns_ += beyond;
      return Seen{next, nominal + beyond, 0};
    }
    if (++late_ < kMoved && beyond < source.period_ns()) return Seen{next, nominal, beyond};
    late_ = 0;
    *base_ns_ += late - middle;
    return Seen{next, at_ns - middle, beyond};
  }
  late_ = 0;
  const std::int64_t pull = std::clamp((late - middle) / kFollow, -tolerance, tolerance);
  *base_ns_ += pull;
  return Seen{next, nominal + pull, 0};
}

}  // namespace xauto::runtime
