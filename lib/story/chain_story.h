// SPDX-License-Identifier: Apache-2.0
// One release of a chain, traced back from the job that was the first to know it,
// through what fires and what is sampled, to the sensors. Between a trace that was read back and
// `xauto explain --trace`. Pure.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "story/trace_reader.h"

namespace xauto::story {

/// Who had the XPU meanwhile, and for how much of the time.
struct Blocker {
  std::string who;  ///< "XNODE RELEASE"
  std::int64_t us = 0;
};

/// A message that a job's activation has read of a topic that does not fire it.
struct StoryRead {
  std::string read;  ///< module or source
  std::int64_t number = -1, at_us = 0;
  std::int64_t age_us = -1;  ///< -1: unknown
};

/// One job on the way. Times since the chain's release; it may be negative, since what is sampled is
/// older.
struct StoryJob {
  std::string xnode, module, xpu;
  std::int64_t number = 0, activation = -1;  ///< activation: as TraceSlice's
  std::int64_t ready_us = 0, began_us = 0, ended_us = 0, ran_us = 0;
  std::optional<std::int64_t> released_us, key_us;  ///< of its activation, by its policy
  std::optional<std::int64_t> held_until_us;        ///< likewise; nullopt: it was not held
  std::int64_t late_us = 0;  ///< of a job that a sensor fires: ready so long after the release
  std::vector<Blocker> waited_for;          ///< who had its XPU while it was ready, and not held
  std::vector<Blocker> preempted_by;        ///< ... between its begin and its end, when it had not
  std::optional<std::int64_t> lateness_us;  ///< end less key; negative: early
  std::vector<StoryRead> reads;
  std::vector<std::pair<std::int64_t, std::int64_t>> parts;  ///< begin and end of each on the XPU
  std::int64_t without_core_us = 0;  ///< of `ran_us`: the kernel ran somebody else on its core
};

/// What a stretch of a release's time went to.
enum class SpentOn : std::uint8_t {
  kMissed,     ///< the release came to nothing of its own: what made the result is of a newer one
  kSource,     ///< its source was late
  kHeld,       ///< its policy held the job
  kWaiting,    ///< ready, and another had the XPU
  kRunning,    ///< on the XPU
  kSuspended,  ///< begun, and off the XPU
  kNoCore,     ///< the kernel ran somebody else on the job's core; where in the job is not known
  kUntaken,  ///< made, and not yet taken: who comes next has not read it, or waits for its other inputs
  kUntold,  ///< the trace does not say
};
[[nodiscard]] const char* to_string(SpentOn on);  ///< "held", for people

struct Spent {
  SpentOn on = SpentOn::kRunning;
  int job = -1;  ///< index into ChainStory::jobs; of kUntaken who made it; -1: none
  std::int64_t begin_us = 0, end_us = 0;
};

struct StorySensor {
  std::string source;
  std::int64_t number = 0, released_us = 0;
};

struct ChainStory {
  std::string chain, note;  ///< note: source, and what is claimed
  std::int64_t number = 0, reaction_us = 0;
  bool urgent = false;                           ///< its source marked it so
  std::int64_t rank = 1, of = 1, median_us = 0;  ///< rank 1: the longest
  std::vector<StorySensor> sensors;              ///< by time
  std::vector<StoryJob> jobs;                    ///< by begin
  /// Of the XNodes on that way, by begin, until the end of `jobs`: what else was made of the release, and what
  /// began after it and had neither it nor a newer one.
  std::vector<StoryJob> own, missed;
  bool cut = false;  ///< it goes back further than kMostStoryJobs
  /// All of its time, without a gap from 0 to `reaction_us`: back from the last job to the release, each time along
  /// the last of what the job is made of and knows the release, or a newer one.
  std::vector<Spent> way;
};

inline constexpr std::size_t kMostStoryJobs = 500;

/// The release of the longest reaction, the first of several; of the median (of an even number the
/// lower) one. null: there is none.
[[nodiscard]] const TraceReactions::One* worst_of(const TraceReactions& chain);
[[nodiscard]] const TraceReactions::One* median_of(const TraceReactions& chain);

/// Errors (kInfeasible): the job that knew it first is not in the trace.
[[nodiscard]] Result<ChainStory> story_of(const ReadTrace& trace, const TraceReactions& chain,
                                          const TraceReactions::One& release);

/// Waits below this are not told.
inline constexpr std::int64_t kWorthSayingUs = 50;

/// "waited 3.100 ms for a 7 (3.000)", and for how long of it nobody had the XPU.
[[nodiscard]] std::string waited_text(std::int64_t us, const std::vector<Blocker>& waited_for);

/// Why a job did not end sooner, in words; empty: nothing but its work.
[[nodiscard]] std::string reasons_of(const StoryJob& job);

/// "48.900 ms: running 26.100, waiting 9.800, held 3.000": the most first.
[[nodiscard]] std::string way_text(const ChainStory& story);

/// For people, without the verdict on the claims.
[[nodiscard]] std::string story_text(const ChainStory& story);

/// "26.104"
[[nodiscard]] std::string in_ms(std::int64_t us);

}  // namespace xauto::story
