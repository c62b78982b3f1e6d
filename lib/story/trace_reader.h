// SPDX-License-Identifier: Apache-2.0
// A trace that `xauto run --trace-out` wrote, read back: releases, what ran, what handed over to
// what. The file comes from outside and is checked as such.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

namespace xauto::story {

/// A message that was sampled.
struct TraceSample {
  std::string read;                     ///< the module or source that published it
  std::int64_t number = -1;             ///< -1: there was nothing
  std::int64_t at_ns = 0, age_us = -1;  ///< -1: unknown
  int slice = -1;    ///< the last of what published it, index into `run`; -1: none
  int release = -1;  ///< or the sensor's, index into `releases`
};

/// A slice on an XPU.
struct TraceSlice {
  std::string name, category, module;
  int row = -1;  ///< index into rows
  std::int64_t begin_ns = 0, end_ns = 0, release = -1, waited_us = 0, part = 1;
  std::int64_t activation = -1;   ///< what belongs together; -1: not told
  std::vector<int> from;          ///< slices whose arrows end here: indices into the same list
  std::int64_t released_ns = -1;  ///< latest release whose arrow ends here; -1: none
  std::vector<int> releases;      ///< all of them: indices into `releases`
  std::vector<TraceSample> samples;
  // Of a run by keys: in the first slice of a job, and in its last.
  std::optional<std::int64_t> since_release_us, key_us, lateness_us;
  std::int64_t held_us = 0;  ///< in the first slice: so long of `waited_us`, from the first on
  std::int64_t without_core_us = 0;  ///< in the last slice of a job on a core
};

struct TraceRelease {
  std::int64_t number = 0, begin_ns = 0;
  std::string source;
};

/// What a whole run counted of a chain, and what is stated and claimed of it; -1: not told, or nothing is.
struct ChainCounts {
  std::string name;
  std::int64_t results = -1, p50_us = -1, p99_us = -1, max_us = -1;
  std::int64_t worst_case_us = -1, lower_bound_us = -1;
  std::int64_t deadline_us = -1, misses = -1, lost = -1;
  bool exceeded = false;  ///< a result took longer than its worst case
};

/// A chain of app.json, with its reactions.
struct TraceReactions {
  std::string name, note;         ///< note: its source, and what is claimed of it
  std::int64_t deadline_us = -1;  ///< -1: none
  struct One {
    std::int64_t number = 0, released_ns = 0, reaction_us = 0;
    std::string xnode;             ///< whose job was the first to know it
    std::int64_t activation = -1;  ///< as TraceSlice's
    bool urgent = false;
  };
  std::vector<One> releases;  ///< by number
};

/// Of a run with tables. -1: not told; of a worst case: nothing is claimed.
struct TraceScenario {
  std::string name, table;
  std::int64_t releases = -1;
};
/// Another scenario counts, and what met that.
struct TraceChange {
  std::int64_t at_ns = 0, release = -1;
  std::string from, to, table, why;
  std::string chain;  ///< whose result met it; empty: none did
  std::int64_t spanned_us = -1, worst_case_us = -1;
};

struct ReadTrace {
  std::string title, note;
  std::vector<std::string> rows;
  std::vector<TraceRelease> releases;
  std::vector<TraceReactions> reactions;  ///< of the chains of app.json
  std::vector<ChainCounts> counts;        ///< of the whole run; empty: it went on
  std::vector<TraceScenario> scenarios;
  std::vector<TraceChange> changes;  ///< by time
  std::string verdict;               ///< what became of the claims
  std::vector<TraceSlice> run;       ///< by begin
  std::int64_t lost = 0, dropped = 0;
  std::int64_t overwritten = 0;  ///< events from before `begin_ns`
  std::int64_t begin_ns = 0, end_ns = 0;
};

inline constexpr std::size_t kMaxTraceBytes = std::size_t{1} << 30;

/// Errors (kInvalid, `where` is the file): no Perfetto trace, not one of ours, broken off, slices
/// that do not nest, times or arrows that go backwards.
[[nodiscard]] Result<ReadTrace> read_trace(const std::string& bytes, const std::string& where);

}  // namespace xauto::story
