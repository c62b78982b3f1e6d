// SPDX-License-Identifier: Apache-2.0
// Who else has the XPUs of this run. A claim takes for granted that each serves this app alone; here it is watched: other
// runs that say to have one of them (processes/marks.h), and what runs on a core that a job was waiting for.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <sys/types.h>

#include "processes/board.h"
#include "processes/marks.h"
#include "session/session.h"

namespace xauto::runtime {

/// Threads that the kernel ran last on a core and that can run now.
struct Runners {
  std::vector<std::string> names;  ///< "stress (pid 77, SCHED_FIFO 99)", at most three
  bool realtime = false;  ///< they are all of a real-time policy: those of others are left out then
};
/// But for threads of the process `own`. `proc`: where proc(5) is.
[[nodiscard]] Runners runners_on(int core, pid_t own, const std::string& proc = "/proc");

/// Threads: one at a time.
class ForeignWatch {
 public:
  /// `leads`: of several processes of a run one looks for other runs.
  ForeignWatch(const Session& session, Board& board, bool leads);
  /// Often: it has a look at other runs each second, and who runs on a core only where a job had to wait.
  void look(std::int64_t now_ns);

 private:
  void look_for_runs();
  void look_for_runners();

  Board& board_;
  const bool leads_;
  std::string own_;                  ///< how addresses of this run begin
  std::vector<RealXpu> xpus_;        ///< [XPU]
  std::vector<std::uint64_t> seen_;  ///< [XPU] jobs that had to wait, at the last look
  std::vector<int> looks_;           ///< [XPU] how often somebody was looked for
  std::int64_t looked_ns_ = 0;
};

}  // namespace xauto::runtime
