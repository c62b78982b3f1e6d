// SPDX-License-Identifier: Apache-2.0
// The parts of a run on several computers, over TCP: `xauto run --part HOST --meet ADDRESS:PORT`. The part of the
// platform's first host listens there, the others connect. meeting_table.h has what they say. Nothing in it is secret, and
// nobody is asked who he is: the network is the app's own, as that of its messages.
//
// A thread keeps the connections. Each part notices by itself who goes; one that is started again joins. Without the
// first part the others go on, and look for it each second.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"
#include "launch/clock_watch.h"
#include "launch/meeting_table.h"
#include "session/account.h"

namespace xauto::launch {

struct MeetingRequest {
  std::string address;  ///< "front:7400", "10.0.0.1:7400", "[fe80::1%eth0]:7400"
  MeetingSetUp set_up;
  const std::atomic<bool>* stop = nullptr;
};

/// Threads: `begin` and what it returns one, which may be another one than made it.
class Meeting {
 public:
  /// Returns when all parts are there, or the run goes on: from then on `run` is known. Errors: the address; nobody came;
  /// we were refused; told to stop.
  [[nodiscard]] static Result<std::unique_ptr<Meeting>> begin(MeetingRequest request);
  ~Meeting();
  Meeting(const Meeting&) = delete;
  Meeting& operator=(const Meeting&) = delete;

  [[nodiscard]] std::uint64_t run() const;
  /// Our app is so far.
  void reached(PartStage stage);
  /// On our CLOCK_MONOTONIC; 0: not known yet.
  [[nodiscard]] std::int64_t start_ns() const;
  /// CLOCK_TAI less our CLOCK_MONOTONIC, by which the start was fixed; 0: not known yet.
  [[nodiscard]] std::int64_t clock_offset_ns() const;
  /// Why there will be no start.
  [[nodiscard]] std::optional<Error> error() const;
  /// Our report. On the first host: waits for those of the others that are there, at most `patience_ns`. Ends the meeting.
  void end(const std::string& report, std::int64_t patience_ns);
  [[nodiscard]] bool leads() const { return leads_; }
  /// Of the others, by host. After `end`.
  [[nodiscard]] std::map<std::string, std::string> reports() const;
  /// "clock_step", of our own clock so far. Before `end`: each part tells its own, to the report of all, too.
  void tell_steps(runtime::Account& into) const;
  /// "part_gone". After `end`.
  void report(runtime::Account& into, std::vector<std::string>& notes) const;

 private:
  struct Line {
    UniqueFd socket;
    FrameReader frames;
  };
  explicit Meeting(MeetingRequest request);
  [[nodiscard]] Status open();
  [[nodiscard]] MeetingTable::Instant now() const;
  void serve();
  void accept() XAUTO_REQUIRES(mutex_);
  void hear(int connection) XAUTO_REQUIRES(mutex_);
  void carry_out(MeetingTable::Says says) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] bool wants_line() XAUTO_REQUIRES(mutex_);
  void seek(UniqueFd fresh) XAUTO_REQUIRES(mutex_);
  void heard(const Json& message) XAUTO_REQUIRES(mutex_);
  void tell(const Json& message) XAUTO_REQUIRES(mutex_);
  void tell_stage() XAUTO_REQUIRES(mutex_);
  void lose() XAUTO_REQUIRES(mutex_);
  void start_at(std::int64_t tai_ns) XAUTO_REQUIRES(mutex_);
  void look_at_clock() XAUTO_REQUIRES(mutex_);

  const MeetingRequest request_;
  const bool leads_;
  UniqueFd listener_, wake_;
  std::atomic<bool> quit_{false};
  ClockWatch clock_;
  mutable PiMutex mutex_;
  MeetingTable table_ XAUTO_GUARDED_BY(mutex_);  ///< of the first host's
  std::map<int, Line> lines_ XAUTO_GUARDED_BY(mutex_);
  // Of the others:
  std::optional<Line> line_ XAUTO_GUARDED_BY(mutex_);
  std::int64_t sought_ns_ XAUTO_GUARDED_BY(mutex_) = 0, heard_ns_ XAUTO_GUARDED_BY(mutex_) = 0,
                          told_ns_ XAUTO_GUARDED_BY(mutex_) = 0;
  bool welcome_ XAUTO_GUARDED_BY(mutex_) = false, thanked_ XAUTO_GUARDED_BY(mutex_) = false;
  std::map<std::string, std::uint64_t> deaths_ XAUTO_GUARDED_BY(mutex_);
  // Of both:
  std::uint64_t run_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::int64_t start_tai_ns_ XAUTO_GUARDED_BY(mutex_) = 0, start_ns_ XAUTO_GUARDED_BY(mutex_) = 0;
  PartStage stage_ XAUTO_GUARDED_BY(mutex_) = PartStage::kThere;
  std::string report_ XAUTO_GUARDED_BY(mutex_);
  std::optional<Error> error_ XAUTO_GUARDED_BY(mutex_);
  std::uint64_t steps_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::int64_t longest_step_ns_ XAUTO_GUARDED_BY(mutex_) = 0;
  std::thread thread_;
};

}  // namespace xauto::launch
