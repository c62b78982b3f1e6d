// SPDX-License-Identifier: Apache-2.0
// The counts of a run that goes on, from its board (runtime/board.h): what `xauto top` and the
// progress line of `xauto run` show. Pure apart from the look itself.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "model/json_value.h"
#include "processes/board.h"
#include "session/account.h"

namespace xauto::cli {

struct ModuleCounts {
  std::string name;
  std::uint64_t activations = 0, failed = 0, dropped = 0;
  std::uint32_t deaths = 0;   ///< of its process
  std::uint64_t off = 0;      ///< releases in whose table it is off
  std::uint64_t skipped = 0;  ///< as it was told, or a module before it
};

/// A chain, or the app as a whole; and what its last result was.
struct FlowCounts : runtime::ChainAccount {
  std::int64_t last_origin_ns = 0, oldest_us = 0;
  std::int64_t last_us = -1;                 ///< -1: none
  std::int64_t last_ns = 0, in_time_ns = 0;  ///< as FlowLine's
  std::int64_t period_us = 0;                ///< what is stated; 0: nothing
  std::int64_t allowed_us =
      0;  ///< what the worst case and the emulator's part are together; 0: nothing is claimed
  std::int64_t limit_us = 0;         ///< what in_time_ns is about; 0: nothing
  std::uint64_t off = 0;             ///< ModuleCounts::off of the chain's end
  bool gone = false;                 ///< the table that is in force does not have it
  std::int64_t gone_or_back_ns = 0;  ///< since then it is gone, or there again; 0: always there
};

/// A chain that ends on another host, of which a part knows nothing.
struct ChainElsewhere {
  std::string name, host;
};

struct XpuCounts {
  std::string name;
  std::uint64_t suspensions = 0;
  std::int64_t busy_ns = 0;
};

/// What a host's part of a run reads of an XNode of another host.
struct CrossingCounts {
  std::string xnode, from, to;  ///< hosts
  std::int64_t x_us = 0, longest_us = 0;
  std::uint64_t messages = 0, lost = 0, late = 0;
};

/// Of a run with tables: which one releases get now.
struct ScenarioCounts {
  std::string name, table, why, asked;  ///< asked: by people; empty: nothing
  std::uint64_t switches = 0;           ///< to another table
  std::uint64_t releases = 0;           ///< under this scenario
};

/// ... of all that met a change of the scenario, what was nearest to its worst case.
struct SpannedCounts {
  std::string from, to;                    ///< scenarios
  std::string chain;                       ///< whose result it is
  std::int64_t us = 0, worst_case_us = 0;  ///< worst_case_us: 0: nothing is claimed
};

struct Counts {
  std::int64_t at_ns = 0;
  std::uint64_t released = 0;
  std::vector<ModuleCounts> modules;
  FlowCounts whole;  ///< empty with several rates
  std::vector<FlowCounts> chains;
  std::vector<ChainElsewhere> elsewhere;
  runtime::Account account;  ///< its chains are those above, without when each told something last
  std::optional<ScenarioCounts> scenario;  ///< none: there is one policy
  std::vector<ScenarioCounts> scenarios;   ///< all of them
  std::optional<SpannedCounts> spanned;    ///< none: nothing met a change so far
  std::vector<XpuCounts> xpus;
  std::vector<CrossingCounts> crossings;  ///< by link
  /// Releases are counted, by `whole`; as far as can be told before the first one.
  [[nodiscard]] bool single_rate() const {
    return whole.results() + whole.lost > 0 || whole.period_us > 0 || whole.deadline_us > 0 ||
           whole.worst_case_us > 0;
  }
};

/// All counts of one moment, or nearly: each is right by itself. Of one host's part of a run what that host has.
[[nodiscard]] Counts counts_of(const runtime::Board& board);

/// The same element of the look before; T(): there was none. A run may write onto its board what it likes.
template <class T>
[[nodiscard]] T same(const std::vector<T>& before, std::size_t index, const std::string& name) {
  return index < before.size() && before[index].name == name ? before[index] : T();
}

/// Of a run with tables, one of its scenarios; `why` and `asked` of the one in force.
[[nodiscard]] ScenarioCounts scenario_of(const runtime::Board& board, std::uint32_t index);

/// Which scenario counts, and why, and what met a change; empty of runs without tables.
[[nodiscard]] std::string scenario_text(const Counts& counts);
/// The same, of a run with tables.
[[nodiscard]] Json scenario_json(const Counts& counts);
/// What met a change; null: nothing did.
[[nodiscard]] Json spanned_json(const Counts& counts);
[[nodiscard]] std::string spanned_text(const Counts& counts);

/// One flow over the time between two looks.
struct FlowNumbers {
  std::uint64_t results = 0;
  double rate_hz = 0;
  std::int64_t p50_us = -1, p99_us = -1, max_us = -1;  ///< at most 1/64 too large; -1: no result
  std::int64_t age_us = -1;  ///< of what the last result says, at the second look; -1: none yet
};
/// `before` as of another run's beginning: default constructed counts.
[[nodiscard]] FlowNumbers numbers_of(const FlowCounts& now, const FlowCounts& before,
                                     std::int64_t now_ns, std::int64_t before_ns);
/// What the progress line says: "32.8/s, p50 12.41 ms"; several rates: of all chains together.
[[nodiscard]] std::string progress_words(const Counts& now, const Counts& before);
/// Releases that are over, of `activations`; below 0: cannot be told.
[[nodiscard]] double progress_of(const Counts& now, std::uint64_t activations);

}  // namespace xauto::cli
