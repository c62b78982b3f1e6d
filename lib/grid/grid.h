// SPDX-License-Identifier: Apache-2.0
// The time line of the releases: when each source releases nominally, and when each module's
// activation counts as released.
//
//   source s, release k:        start + offset_s + k * period_s
//   component, activation k:    start + phi + k * period, phi the least offset of its sources
//
// `start` is the run's. docs/keys.md has the words.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <xauto/result.h>

#include "graph/graph.h"
#include "model/period.h"
#include "session/session.h"

namespace xauto::runtime {

struct Grid {
  struct Source {
    Period period;
    std::int64_t offset_ns = 0;
    std::int64_t jitter_ns = 0;  ///< what app.json states
    std::size_t clock = 0;       ///< of `clock_ppm`
    std::uint32_t number = 0;    ///< in the trace: app.json's
    /// Of release `k`, after the start. In whole nanoseconds, rounded down; no drift adds up.
    [[nodiscard]] std::int64_t due_ns(std::uint64_t k) const;
    /// Releases from one that may be urgent to the next; 0: none may.
    std::uint64_t urgent_apart = 0;
    std::int64_t shift_ns = 0;  ///< it releases so much later than its component's activation
    [[nodiscard]] std::int64_t period_ns() const { return due_ns(1) - due_ns(0); }
  };
  /// Its sources, chains and offsets are app.json's: a run. Otherwise the program's.
  bool periodic = false;
  /// app.json states no rates: all sources release together, and again when all of that has ended, at a distance that
  /// is the program's longest period at least.
  bool one_at_a_time = false;
  std::vector<Source> sources;                ///< [source of the graph]
  std::vector<std::int64_t> clock_ppm = {0};  ///< [clock of app.json]
  /// [module][input] of a source's topic: its shift_ns; 0 of other topics.
  std::vector<std::vector<std::int64_t>> shift_ns;
  /// [module] source whose releases may be urgent, and by how much keys and holds are then earlier;
  /// -1 and 0: none.
  std::vector<int> urgent_source;
  std::vector<std::int64_t> urgent_by_us;
  /// [module] releases from one that it may mark urgent to the next; 0: it may mark none.
  std::vector<std::uint64_t> marks_apart;
  /// [module] activations that may be at once: the program's word, in a run app.json's.
  std::vector<int> in_flight;
  /// [module] activations that may wait at its door when the policy's keys are kept.
  std::vector<std::uint32_t> depth;

  /// Errors: an app.json that this program or this run cannot follow.
  [[nodiscard]] static Result<Grid> make(const Graph& graph, const Session& session);

 private:
  [[nodiscard]] static Grid of_program(const Graph& graph, const Session& session);
  [[nodiscard]] Status take_in_flight(const Graph& graph, const AppSpec& app);
  [[nodiscard]] Status take_sources(const Graph& graph, const AppSpec& app);
  [[nodiscard]] Status take_modules(const Graph& graph, const Session& session);
};

}  // namespace xauto::runtime
