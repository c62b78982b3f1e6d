// SPDX-License-Identifier: Apache-2.0
// LTTng's traces (Common Trace Format), read by libbabeltrace2: those events and fields that somebody wants.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <xauto/result.h>

namespace xauto::import {

/// An event of which something is wanted.
struct WantedEvent {
  const char* name;  ///< "callback_start", without its provider
  std::array<const char*, 3> numbers = {};
  std::array<const char*, 2> texts = {};
};

struct TraceEvent {
  int kind = -1;                         ///< which of the wanted ones
  std::int64_t time_ns = 0;              ///< of the trace's clock
  std::int64_t process = 0, thread = 0;  ///< 0: the trace has none
  std::int32_t cpu = -1;                 ///< -1: likewise
  std::uint32_t texts =
      0;  ///< index into Trace::texts, of the first; they are there one behind the other
  std::array<std::uint64_t, 3> numbers = {};  ///< 0: it has no such field
};

struct Trace {
  std::vector<TraceEvent> events;  ///< by time
  std::vector<std::string> texts;
  std::map<std::string, std::uint64_t>
      others;  ///< events that nobody wants, by name; of more than kMaxOthers names the first
  std::uint64_t lost_events = 0;   ///< that the tracer says it has lost
  std::uint64_t lost_packets = 0;  ///< likewise, each with events
  /// Why a part was not read to its end, a line each; at most kMaxBroken.
  std::vector<std::string> broken;
};

inline constexpr std::size_t kMaxTraceEvents = 10'000'000, kMaxTraces = 64, kMaxStreams = 4096,
                             kMaxTraceText = 256u << 20, kMaxOthers = 1000, kMaxBroken = 20;

/// All traces in `folder` and below it. What is damaged is left from there on, stream by stream. Errors: no trace is
/// there; libbabeltrace2 was not there when this program was built.
/// `providers`: of those events, "ros2:"; what others record nobody wants.
[[nodiscard]] Result<Trace> read_ctf(const std::string& folder,
                                     const std::vector<const char*>& providers,
                                     const std::vector<WantedEvent>& wanted);

}  // namespace xauto::import
