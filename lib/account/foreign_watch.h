// SPDX-License-Identifier: Apache-2.0
// Who else has the XPUs of this run. A claim takes for granted that each serves this app alone; here it is watched: other
// runs that say to have one of them (processes/marks.h), and what runs on a core that a job was waiting for.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <sys/types.h>

#include "processes/board.h"
#include "processes/marks.h"
#include "session/session.h"

namespace xauto::runtime {

/// Who runs on a core: of the threads that the kernel ran last there, those that have run in between two looks. What is
/// ready just when somebody looks proves less, and says nothing of one that lets a watcher run only while it sleeps.
class CoreWatch {
 public:
  struct Seen {
    std::vector<std::string>
        names;  ///< "stress (pid 77, SCHED_FIFO 99)", most time first, at most three
    bool realtime =
        false;  ///< they are all of a real-time policy: those of others are left out then
  };
  /// `proc`: where proc(5) is.
  explicit CoreWatch(int core, std::string proc = "/proc") : core_(core), proc_(std::move(proc)) {}
  /// Since the look before, but for threads of the processes `known`; at the first look nobody. Who was not there at
  /// the look before may have run elsewhere until now, and counts from this one on.
  [[nodiscard]] Seen look(std::int64_t now_ns, const std::vector<pid_t>& known);
  void forget() {
    ran_ns_.clear();
    looked_ns_ = 0;
  }
  [[nodiscard]] bool has_looked() const { return looked_ns_ != 0; }

 private:
  int core_;
  std::string proc_;
  std::map<pid_t, std::int64_t> ran_ns_;  ///< [thread] so far, at the last look
  std::int64_t looked_ns_ = 0;            ///< 0: nobody has
};

/// Threads: one at a time.
class ForeignWatch {
 public:
  /// What the machine's service says: processes of all runs that have joined, none: nobody says; and where it suspends
  /// work of others, by hardware, how often it could not.
  struct Neighbours {
    std::vector<pid_t> processes;
    std::map<std::string, std::int64_t> not_kept_off;
  };
  using Ask = std::function<Neighbours()>;  ///< may take seconds
  /// `leads`: of several processes of a run one looks for other runs.
  ForeignWatch(const Session& session, Board& board, bool leads, Ask ask = {});
  /// Often: it has a look at other runs each second, and who runs on a core only where a job had to wait.
  void look(std::int64_t now_ns);
  /// Other runs are admitted to cores of this one, and it could not tell them from strangers.
  [[nodiscard]] bool is_blind() const { return blind_; }

 private:
  void look_for_runs();
  void look_for_runners(std::int64_t now_ns);
  void look_for_strangers(std::size_t xpu, std::int64_t now_ns);
  void look_for_foreign_work();
  [[nodiscard]] Neighbours neighbours();

  Board& board_;
  const bool leads_;
  std::string own_;                  ///< how addresses of this run begin
  std::vector<RealXpu> xpus_;        ///< [XPU]
  std::vector<CoreWatch> cores_;     ///< [XPU]
  std::vector<std::uint64_t> seen_;  ///< [XPU] jobs that had to wait, at the last look
  std::vector<int> looks_;           ///< [XPU] how often somebody was looked for
  std::int64_t looked_ns_ = 0, asked_ns_ = 0;
  std::int64_t silent_until_ns_ = 0;  ///< whoever did not answer is left alone
  Ask ask_;
  bool blind_ = false;
  bool suspends_ = true;  ///< the service, work of others, as far as is known
  std::map<std::string, std::int64_t> not_kept_off_;  ///< when it was asked first
};

}  // namespace xauto::runtime
