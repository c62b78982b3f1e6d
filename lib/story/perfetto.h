// SPDX-License-Identifier: Apache-2.0
// A trace file in Perfetto's format (perfetto.proto): tracks, slices, instants, counters, arrows.
// Knows nothing of runs and policies; run_trace.h says what is drawn of those.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace xauto::story {

/// Collects in any order, writes in the order of time. Slices of one track must come in the order
/// in which they begin and end: properly nested, a child inside its parent.
/// Threads: one owner.
class PerfettoWriter {
 public:
  using Track = std::uint64_t;

  /// `sequence`: from 1 on. Files of different ones can be put one behind the other: their tracks
  /// stay apart.
  explicit PerfettoWriter(std::uint32_t sequence = 1) : sequence_(sequence) {}

  static constexpr Track kNoParent = 0;

  /// What a viewer shows when the slice is picked.
  using Arg = std::pair<std::string, std::variant<std::int64_t, std::string>>;

  struct Details {
    std::string category;
    std::vector<Arg> args;
    std::vector<std::uint64_t> flows_out, flows_in;  ///< arrows that begin, end here
    /// Those from and to other files: numbers of 64 bits on which both agree.
    std::vector<std::uint64_t> across_out, across_in;
  };

  /// Children are shown in the order in which they were added. Siblings of one name are lanes of
  /// one track.
  Track add_track(Track parent, const std::string& name, const std::string& description = {});
  Track add_counter(Track parent, const std::string& name);

  void begin(Track track, std::int64_t ts_ns, const std::string& name, Details details = {});
  void end(Track track, std::int64_t ts_ns);
  void instant(Track track, std::int64_t ts_ns, const std::string& name, Details details = {});
  void count(Track track, std::int64_t ts_ns, std::int64_t value);
  /// Tells viewers that events before the first are missing.
  void mark_lossy() { lossy_ = true; }

  /// The file. `clock_offset_ns` is added to each time: CLOCK_BOOTTIME, which viewers assume, less
  /// the clock of the given times. Times below 0 become 0.
  [[nodiscard]] std::string write(std::int64_t clock_offset_ns) const;

 private:
  enum class Kind : std::uint8_t { kBegin, kEnd, kInstant, kCount };
  struct Described {
    Track parent;
    std::string name, description;
    bool counter;
  };
  struct Event {
    std::int64_t ts_ns;
    Track track;
    Kind kind;
    std::uint32_t name;  ///< index into names_
    std::int64_t value = 0;
    std::int32_t details = -1;  ///< index into details_
  };
  std::uint32_t name_of(const std::string& name);
  void add(Track track, std::int64_t ts_ns, Kind kind, const std::string& name, Details details);

  std::vector<Described> tracks_;  ///< track N is tracks_[N - 1]
  std::vector<Event> events_;
  std::vector<std::string> names_;
  std::map<std::string, std::uint32_t> name_index_;
  std::vector<Details> details_;
  std::uint32_t sequence_;
  bool lossy_ = false;
};

/// CLOCK_BOOTTIME - CLOCK_MONOTONIC, now.
[[nodiscard]] std::int64_t boottime_offset_ns();

}  // namespace xauto::story
