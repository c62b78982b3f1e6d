// SPDX-License-Identifier: Apache-2.0
#include "grid/phase.h"

#include <algorithm>
#include <utility>

namespace xauto::runtime {
namespace {

constexpr std::int64_t kFollow = 16;  ///< of the distance to half the jitter, a part per message
constexpr int kMoved = 8;  ///< late ones in a row: the source's grid has moved, they are not late
constexpr std::int64_t kMostLeftOut = 1000;  ///< more are a sensor that was started anew

}  // namespace

std::optional<ClockPhase::Seen> ClockPhase::arrived(std::int64_t at_ns, const Grid::Source& source,
                                                    Stream& stream) {
  thread_.check();
  const std::int64_t jitter = source.jitter_ns, middle = jitter / 2, period = source.period_ns();
  const bool at_once = at_ns - std::exchange(stream.last_ns, at_ns) < period / 2;
  if (!base_ns_) {
    base_ns_ = at_ns - middle - source.due_ns(stream.next);
    seen_ns_ = at_ns;
    return Seen{stream.next++, at_ns - middle, 0};
  }
  const std::int64_t tolerance =
      kPhaseRoundingNs +
      static_cast<std::int64_t>(static_cast<__int128>(at_ns - seen_ns_) * ppm_ / 1'000'000);
  seen_ns_ = at_ns;
  // Against the grid of the clock, if it is there; else against the source's own.
  const auto lateness = [&] {
    const std::int64_t of_clock = at_ns - *base_ns_ - source.due_ns(stream.next);
    if (of_clock >= -tolerance && of_clock <= jitter + tolerance) stream.shift_ns = 0;
    return of_clock - stream.shift_ns;
  };
  std::int64_t late = lateness();
  // As late as the one after it would be: it is that one.
  if (late > jitter + tolerance && late >= period - middle) {
    const std::int64_t skipped = std::max<std::int64_t>(1, (late + middle) / period);
    if (skipped <= kMostLeftOut) {
      stream.next += static_cast<std::uint64_t>(skipped);
      stream.owed += static_cast<std::uint64_t>(skipped);
      late = lateness();
    }
  } else if (late < -tolerance && stream.owed > 0 && at_once) {
    --stream.owed;
    return std::nullopt;
  } else if (late < -period / 2 && stream.next == 0) {
    return std::nullopt;
  } else if (late >= 0 && late <= jitter) {
    stream.owed = 0;  // in time: nothing is held up any more
  }
  const std::uint64_t number = stream.next++;
  const std::int64_t nominal = at_ns - late;
  if (late < 0) {  // whatever the jitter: its release was not after it
    stream.late = 0;
    const bool early = late < -tolerance;
    // Others must not hurry because it does.
    (early ? stream.shift_ns : *base_ns_) += late;
    return Seen{number, at_ns, early ? -late : 0, early};
  }
  if (late > jitter) {
    const std::int64_t beyond = late - jitter;
    if (beyond <= tolerance) {
      *base_ns_ += beyond;
      return Seen{number, nominal + beyond, 0};
    }
    if (++stream.late < kMoved && beyond < period) return Seen{number, nominal, beyond};
    stream.late = 0;
    stream.shift_ns += late - middle;
    return Seen{number, at_ns - middle, beyond};
  }
  stream.late = 0;
  const std::int64_t pull = std::clamp((late - middle) / kFollow, -tolerance, tolerance);
  *base_ns_ += pull;
  return Seen{number, nominal + pull, 0};
}

std::optional<std::int64_t> ClockPhase::left_out_ns(const Grid::Source& source,
                                                    const Stream& stream) const {
  thread_.check();
  if (!base_ns_) return std::nullopt;
  const std::int64_t period = source.period_ns();
  const std::int64_t nominal = *base_ns_ + stream.shift_ns + source.due_ns(stream.next);
  // The tolerance as it will be then, or a little more.
  const std::int64_t silent = nominal + source.jitter_ns + 2 * period - seen_ns_;
  const std::int64_t tolerance =
      2 * kPhaseRoundingNs +
      static_cast<std::int64_t>(static_cast<__int128>(silent) * ppm_ / 1'000'000);
  return nominal + std::max(source.jitter_ns + tolerance, period - source.jitter_ns / 2);
}

}  // namespace xauto::runtime
