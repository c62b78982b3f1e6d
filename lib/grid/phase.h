// SPDX-License-Identifier: Apache-2.0
// The nominal releases of sensors that release by themselves (Source::publish), out of when their
// messages came. A certificate speaks of every run in which there are instants n_k with
//
//   (1) n_k <= arrival k <= n_k + jitter         (2) |n_(k+1) - n_k - period| <= ppm * period
//
// (docs/keys.md, "Words"). Nobody has to know the sensor's own: any such instants will do.
// So they are chosen here as messages come, and where none fit, what app.json states is broken.
//
// Sources of one clock keep their phases: they share a grid, base + offset + k * period. The first
// message is taken to be half its jitter late; from then on the grid follows the messages as fast as
// the clock's tolerance allows, with the aim of half the jitter. No message moves it further: a source
// that does what app.json does not state goes off with a grid of its own (Stream::shift_ns), and takes
// no other along.
#pragma once

#include <cstdint>
#include <optional>

#include "base/thread_safety.h"
#include "grid/grid.h"

namespace xauto::runtime {

/// Beyond what the clock's tolerance allows, for each message of a clock: two clock readings, and periods that are
/// fractions.
inline constexpr std::int64_t kPhaseRoundingNs = 1000;

/// Threads: one.
class ClockPhase {
 public:
  /// `ppm`: how much faster or slower the clock may be than ours.
  explicit ClockPhase(std::int64_t ppm) : ppm_(ppm) {}

  struct Seen {
    std::uint64_t number;     ///< of its source's releases; those since the last one did not come
    std::int64_t nominal_ns;  ///< not after the arrival
    /// By how much the source's grid was moved beyond the tolerance so that this arrival fits; or, where
    /// one message alone was too late for it, by how much. 0: as stated.
    std::int64_t off_ns;
    bool early = false;  ///< it was so by being sooner than period and jitter allow
  };
  /// What has come of one source.
  struct Stream {
    std::uint64_t next = 0;  ///< the number after its last one's
    /// Left out, and may come yet: a driver that was held up brings several at a time.
    std::uint64_t owed = 0;
    std::int64_t last_ns = 0;   ///< the last arrival
    std::int64_t shift_ns = 0;  ///< of its grid against the clock's: 0 as long as it is as stated
    int late = 0;               ///< arrivals in a row that were too late
  };
  /// A message of `source` has come at `at_ns` of CLOCK_MONOTONIC. Nullopt: it is older than the
  /// clock's first release, or one that was taken to be left out.
  [[nodiscard]] std::optional<Seen> arrived(std::int64_t at_ns, const Grid::Source& source,
                                            Stream& stream);
  /// From when on the stream's next message counts as left out, if nothing came; nullopt: nobody
  /// knows. What comes then is a later one for `arrived`, too.
  [[nodiscard]] std::optional<std::int64_t> left_out_ns(const Grid::Source& source,
                                                        const Stream& stream) const;
  /// That time has come.
  static void leave_out(Stream& stream) {
    ++stream.next;
    ++stream.owed;
  }
  /// Of release 0 of a source without offset; nullopt: no message has come yet.
  [[nodiscard]] std::optional<std::int64_t> base_ns() const { return base_ns_; }

 private:
  OneThread thread_;
  const std::int64_t ppm_;
  std::optional<std::int64_t> base_ns_;
  std::int64_t seen_ns_ = 0;  ///< the last arrival
};

}  // namespace xauto::runtime
