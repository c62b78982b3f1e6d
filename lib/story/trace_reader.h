// SPDX-License-Identifier: Apache-2.0
// A trace that `xauto run --trace-out` wrote, read back: releases, what ran, what handed over to
// what. The file comes from outside and is checked as such.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

namespace xauto::story {

/// A slice on an XPU; or, as the end of a chain, an output being published.
struct TraceSlice {
  std::string name, category, module;
  int row = -1;  ///< index into rows or plan rows; -1: an output
  std::int64_t begin_ns = 0, end_ns = 0, release = -1, waited_us = 0, part = 1;
  std::int64_t activation = -1;  ///< with several rates: what belongs together; -1: by release
  std::string waited_for, preempted_by;
  std::vector<int> from;          ///< slices whose arrows end here: indices into the same list
  std::int64_t released_ns = -1;  ///< latest release whose arrow ends here; -1: none
};

struct TraceRelease {
  std::int64_t number = 0, begin_ns = 0, end_ns = 0;
  std::int64_t latency_us = -1;  ///< -1: dropped, or not over
  int output = -1;               ///< of a chain: its slice in `run`
};

/// With several rates: the results of one sink module, each from the oldest release it is made of.
struct TraceChain {
  std::string name;                   ///< the module
  std::vector<TraceRelease> results;  ///< by end
};

struct ReadTrace {
  std::string title, note;
  std::vector<std::string> rows;
  std::vector<TraceRelease> releases;
  std::vector<TraceChain> chains;  ///< empty: one rate, `releases` are what has a latency
  std::vector<TraceSlice> run;     ///< by begin; with the outputs (category "done")
  std::vector<TraceSlice> plan;    ///< by begin
  std::int64_t deadline_us = -1;   ///< -1: none
  std::int64_t lost = 0, dropped = 0;
  std::int64_t overwritten = 0;  ///< events from before `begin_ns`
  std::int64_t begin_ns = 0, end_ns = 0;
};

inline constexpr std::size_t kMaxTraceBytes = std::size_t{1} << 30;

/// Errors (kInvalid, `where` is the file): no Perfetto trace, not one of ours, broken off, slices
/// that do not nest, times or arrows that go backwards.
[[nodiscard]] Result<ReadTrace> read_trace(const std::string& bytes, const std::string& where);

}  // namespace xauto::story
