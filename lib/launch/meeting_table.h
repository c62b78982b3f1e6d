// SPDX-License-Identifier: Apache-2.0
// How the parts of a run on several computers come together, as the first host of platform.json sees it: a pure function
// of what comes and of the time. meeting.h has the sockets.
//
//   the other part                          the first host's
//      connects         ─────────────────►
//                       ◄───────────────── clock    its CLOCK_TAI
//      hello            ─────────────────►          host, hash, that time again, its own; run and start, if it runs
//                       ◄───────────────── welcome  once all are there (or the run goes on): run, and start if it runs
//      ready            ─────────────────►          its app is built; it has found the others over DDS
//                       ◄───────────────── start    once all are: the start, in CLOCK_TAI
//      alive            ◄────────────────► alive    each second
//                       ◄───────────────── gone     who has gone
//      report           ─────────────────►
//                       ◄───────────────── thanks
//
// A frame is 4 bytes of length, the lowest first, and JSON with a member "is". `refused` ends it from either side.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/json_value.h"

namespace xauto::launch {

inline constexpr std::size_t kMostFrameBytes = 64 << 10;
inline constexpr std::size_t kMostReportBytes = 64 << 20;
inline constexpr std::int64_t kAliveNs = 1'000'000'000;
inline constexpr std::int64_t kPartSilenceNs = 5'000'000'000;  ///< then it is gone
inline constexpr std::int64_t kStrangerNs =
    5'000'000'000;  ///< who has not said hello by then is sent away
/// From the last `ready` to the start: for the way, and what looks a few times a second.
inline constexpr std::int64_t kStartLeadNs = 1'000'000'000;

[[nodiscard]] std::vector<std::byte> frame_of(const Json& message);

/// Puts frames together. Threads: one.
class FrameReader {
 public:
  void feed(std::span<const std::byte> bytes) {
    bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  }
  /// The next whole one; nullopt: it is not there yet, or `bad`. At most `most` bytes.
  [[nodiscard]] std::optional<Json> next(std::size_t most);
  /// What came is no frame: nothing follows.
  [[nodiscard]] bool bad() const { return bad_; }

 private:
  std::deque<std::byte> bytes_;
  bool bad_ = false;
};

/// What all parts have to have in common, and what one of them is.
struct PartIdentity {
  std::string host;
  std::string hash;  ///< of app, platform, policy, version, kind of machine and releases
  std::int64_t tai_offset_s = 0;  ///< of the kernel: CLOCK_TAI less CLOCK_REALTIME
};

/// How far a part has come.
enum class PartStage : std::uint8_t { kAway, kThere, kBuilt, kReady, kReported };

struct MeetingSetUp {
  PartIdentity own;
  std::vector<std::string> hosts;  ///< all
  std::uint64_t fresh_run = 1;     ///< if none goes on
  std::int64_t limit_ns = 60'000'000'000;
  /// Clocks that are surely further apart are refused: no message could be in time. INT64_MAX: nothing crosses.
  std::int64_t most_apart_ns = INT64_MAX;
};

/// Threads: one.
class MeetingTable {
 public:
  struct Instant {
    std::int64_t now_ns;  ///< CLOCK_MONOTONIC
    std::int64_t tai_ns;
  };
  struct Say {
    int to;  ///< connection
    Json what;
    bool close = false;  ///< afterwards
  };
  using Says = std::vector<Say>;

  MeetingTable(MeetingSetUp set_up, Instant now);
  [[nodiscard]] Says connected(int connection, Instant now);
  [[nodiscard]] Says hear(int connection, const Json& message, Instant now);
  /// Its connection has ended, or its frames were bad.
  [[nodiscard]] Says gone(int connection, Instant now);
  [[nodiscard]] Says tick(Instant now);
  /// Of our own part.
  [[nodiscard]] Says own(PartStage stage, Instant now);
  /// Frames of this connection may be as long as reports.
  [[nodiscard]] bool known(int connection) const;

  [[nodiscard]] std::uint64_t run() const { return run_; }                   ///< 0: not known yet
  [[nodiscard]] std::int64_t start_tai_ns() const { return start_tai_ns_; }  ///< 0: likewise
  /// It did not come together in time: who is missing, and what to do.
  [[nodiscard]] const std::optional<Error>& error() const { return error_; }
  /// By host, of those that have reported.
  [[nodiscard]] const std::map<std::string, std::string>& reports() const { return reports_; }
  /// By host, how often its part has gone before it had reported, after the start.
  [[nodiscard]] const std::map<std::string, std::uint64_t>& deaths() const { return deaths_; }
  /// Parts that are there, and have not reported yet.
  [[nodiscard]] bool expects_reports() const;
  /// What people should know, since the last call.
  [[nodiscard]] std::vector<std::string> take_news();

 private:
  struct Part {
    PartStage stage = PartStage::kAway;
    int connection = -1;
  };
  struct Line {
    std::string host;  ///< empty: it has not said hello
    std::int64_t since_ns = 0, heard_ns = 0, told_ns = 0, clock_ns = 0;
  };
  [[nodiscard]] std::string refusal(const Json& hello, const Line& line, Instant now) const;
  void hello(int connection, const Json& message, Instant now, Says& says);
  void welcome(int connection, Says& says) const;
  void come_together(Instant now, Says& says);
  void give_up(const std::string& what, Says& says);
  [[nodiscard]] std::string those_before(PartStage stage) const;

  const MeetingSetUp set_up_;
  const std::int64_t began_ns_;
  std::map<std::string, Part> parts_;
  std::map<int, Line> lines_;
  std::uint64_t run_ = 0;
  std::int64_t start_tai_ns_ = 0;
  std::optional<Error> error_;
  std::map<std::string, std::string> reports_;
  std::map<std::string, std::uint64_t> deaths_;
  std::vector<std::string> news_;
};

}  // namespace xauto::launch
