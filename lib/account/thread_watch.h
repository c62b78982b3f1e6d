// SPDX-License-Identifier: Apache-2.0
// What the machine runs instead of this process, and what of this process is no job: threads that had to wait
// for a core, threads and child processes beside those of the run, other machines on the same hardware. A claim
// takes for granted that there is none of it. Who exceeds a worst case is told so, and not sent to the authors.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <sys/types.h>

#include "base/rt.h"
#include "base/unique_fd.h"
#include "session/run_report.h"

namespace xauto::runtime {

/// Threads: one at a time. Of threads whose work is an XNode's on a core others know more (JobTimes).
class ThreadWatch {
 public:
  /// All threads there are belong to the run, as do those that the runtime names "xauto/..." later.
  /// `proc`: where proc(5) is.
  explicit ThreadWatch(std::vector<pid_t> xnodes_on_cores, std::string proc = "/proc");
  /// Every kLookNs: what is told of waiting is told of the time between two looks.
  void look(std::int64_t now_ns);
  /// The watching thread woke too late by so much. What it did not wait for a core of that, the whole machine stood
  /// still: nothing counts that.
  void woke(std::int64_t late_ns);
  /// After the last look, when the threads of the run may have ended.
  void finish();
  [[nodiscard]] std::vector<TakenReport> taken() const;
  /// Why waiting is not watched; empty: it is.
  [[nodiscard]] const std::string& not_watched() const { return not_watched_; }

 private:
  struct Seen {
    UniqueFd schedstat;
    std::string name;
    bool ours = true, waits_count = true;
    rt::ThreadTimes first, last;
    std::int64_t longest_ns = 0;  ///< the most that it waited between two looks
  };
  void find_threads(bool ours);

  std::string proc_;
  std::vector<pid_t> xnodes_;
  std::map<pid_t, Seen> threads_;
  std::int64_t found_ns_ = 0;                           ///< when threads were looked for
  std::int64_t process_ns_ = 0, others_ns_ = 0;         ///< CPU time: of all at first, of strangers
  std::int64_t children_ns_ = 0, children_now_ns_ = 0;  ///< likewise of child processes
  std::int64_t stolen_ns_ = 0, stolen_now_ns_ = 0;      ///< likewise by other machines
  std::int64_t waited_ns_ = 0, still_ns_ = 0;  ///< of `woke`: until the last one; the longest
  std::string not_watched_;
};

}  // namespace xauto::runtime
