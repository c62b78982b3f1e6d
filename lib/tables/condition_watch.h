// SPDX-License-Identifier: Apache-2.0
// What the machine says of its clocks and modes: the files that scenarios name (Scenario::when). And
// the thread that reads them, on which it is also seen that an assumption is wrong. No release waits
// while it reads. It is an ordinary thread: where real-time threads fill the CPUs, releases look alone.
//
// When the files are read:
//   by the clock   a clock's file in /sys tells nobody that it has changed. As often as nvgpu's governor
//                  decides, every 25 ms, or less
//   inotify        what programs write (nvpmodel's status)
//   a job          that is too long may be the first sign of a clock that has fallen
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "model/tables.h"
#include "tables/scenario_order.h"

namespace xauto::runtime {

/// Between two reads by the clock.
inline constexpr std::int64_t kReadOftenNs = 25'000'000, kReadSeldomNs = 50'000'000;
/// Who writes without end is heard no more often: anybody who may write beside such a file could keep
/// the thread busy.
inline constexpr std::int64_t kHeardApartNs = 1'000'000;
/// Of releases so far apart (0: nobody says): three quarters of a period where those limits allow it,
/// so that what has changed is known within a period.
[[nodiscard]] std::int64_t read_every_ns(std::int64_t period_ns);

/// A file's text; nullopt: it cannot be read.
using ReadText = std::function<std::optional<std::string>(const std::string& path)>;
/// By how much the scenario's conditions are missed, as parts of their limits, added up; 0: they hold;
/// nullopt: it has none, or a file cannot be read.
[[nodiscard]] std::optional<double> passed_by(const Scenario& scenario, const ReadText& read);

/// Which scenario the machine is in.
struct MachineState {
  /// What of `scenario` does not hold.
  struct Outside {
    std::string file;
    std::string words;  ///< "/sys/.../cur_freq is 318000, every scenario needs at least 612000"
  };
  int scenario = -1;  ///< -1: it says nothing
  /// Not empty: scenarios have conditions, and none holds; `scenario` is the last resort.
  std::vector<Outside> outside = {};
};
/// Of the scenarios whose conditions hold, one that covers no other; of several the least. If none holds,
/// of those that have conditions the one that covers most: the machine is slower than where it was
/// measured.
[[nodiscard]] MachineState machine_in(const Tables& tables, const ScenarioOrder& order,
                                      const ReadText& read);

/// Tells when somebody writes, replaces or removes one of some files. Sees what programs do, and not
/// what the kernel does to its own files. Threads: one.
class FileChanges {
 public:
  explicit FileChanges(const std::vector<std::string>& paths);
  /// Readable when there is something to take; -1: the system has no inotify to give.
  [[nodiscard]] int fd() const { return inotify_.get(); }
  /// Takes what has happened since. True: one of the files may say something else.
  [[nodiscard]] bool take();

 private:
  OneThread thread_;
  UniqueFd inotify_;
  std::map<int, std::vector<std::string>> names_;  ///< folder's watch -> names in it
};

/// Threads: any.
class ConditionWatch {
 public:
  struct Timing {
    std::int64_t read_ns = kReadSeldomNs;
    std::int64_t glance_ns = kReadSeldomNs;
  };
  /// Asked every `glance_ns`, and whenever files were read, on the watch's thread: whether jobs show that
  /// the scenario in force is not the machine's.
  using Glance = std::function<bool(const MachineState& machine)>;
  /// `tables` and `order` outlive it. Without conditions nothing is read. Warns of a file that cannot be read, once
  /// of each: a profile of root's may name some that others cannot. kUnavailable: there is no thread for it.
  [[nodiscard]] static Result<std::unique_ptr<ConditionWatch>> start(const Tables& tables,
                                                                     const ScenarioOrder& order,
                                                                     const Timing& timing,
                                                                     Glance glance);
  ~ConditionWatch();
  ConditionWatch(const ConditionWatch&) = delete;
  ConditionWatch& operator=(const ConditionWatch&) = delete;
  [[nodiscard]] MachineState now() const;

 private:
  ConditionWatch(const Tables& tables, const ScenarioOrder& order, const Timing& timing,
                 Glance glance);
  void read();
  void watch(std::int64_t since_ns);

  const Tables& tables_;
  const ScenarioOrder& order_;
  const Timing timing_;
  const Glance glance_;
  std::vector<std::string> files_;  ///< of all conditions, each once
  std::vector<char> warned_;        ///< [file]
  mutable PiMutex mutex_;           ///< of the releases and the watch
  MachineState machine_ XAUTO_GUARDED_BY(mutex_);
  UniqueFd quit_;       ///< eventfd
  std::thread thread_;  ///< last: it uses the others
};

}  // namespace xauto::runtime
