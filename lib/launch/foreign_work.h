// SPDX-License-Identifier: Apache-2.0
// Work of processes that know nothing of XAuto, on a Jetson's GPU or DLA that runs share: one job of the largest key,
// which every other one preempts (docs/keys.md, "Apps compose"). To the XPU's coordinator it is a worker like others: who
// wants the XPU takes it, and a FINISH gives it back. Suspended by xauto.ko, so whoever dies, nothing stays suspended:
// this process, and the module resumes all; the coordinator, and its successor has us again, or the XPU is nobody's.
//
// Processes are looked at every kLookNs, so a queue that is new may have run unseen for so long. That is counted, where jobs
// had the XPU meanwhile, as is a queue that could not be suspended: then a run beside it claims nothing.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"
#include "coord/port.h"
#include "kernel/queue_control.h"

namespace xauto::launch {

/// Threads: any, once it has started. Needs CAP_SYS_NICE, and CAP_SYS_PTRACE for pidfd_getfd(2).
class ForeignWork {
 public:
  static constexpr std::int64_t kLookNs = 250'000'000;

  struct Options {
    std::string door;  ///< of the coordinator (coord/door.h): a lease of its own, with one XNode
    kernel::QueueType type = kernel::QueueType::kGpuTsg;
    int instance = -1;  ///< which DLA; -1: a GPU
  };
  /// It connects to the coordinator in a thread of its own: who calls may be the one that lets it in. kUnavailable:
  /// xauto.ko is not loaded.
  [[nodiscard]] static Result<std::unique_ptr<ForeignWork>> start(Options options);
  /// Nothing stays suspended.
  ~ForeignWork();
  ForeignWork(const ForeignWork&) = delete;
  ForeignWork& operator=(const ForeignWork&) = delete;

  /// Whose queues are none of it.
  void set_joined(std::set<pid_t> processes);

  struct Told {
    std::uint32_t queues = 0;       ///< that are there now
    std::uint64_t suspensions = 0;  ///< of all of them together
    std::uint64_t not_kept_off =
        0;  ///< times that one ran, or may have run, while a job had the XPU
  };
  [[nodiscard]] Told told() const {
    return {queues_.load(), suspensions_.load(), not_kept_off_.load()};
  }
  /// What the coordinator has it in; -1: it is not connected.
  [[nodiscard]] int slot() const { return slot_.load(); }

 private:
  /// A queue as it was found, with a descriptor of ours.
  struct Found {
    pid_t process = 0;
    UniqueFd fd;
  };
  ForeignWork(Options options, kernel::QueueControl control)
      : options_(std::move(options)), control_(std::move(control)) {}
  void look_often();
  [[nodiscard]] std::vector<Found> look();
  void manage();
  [[nodiscard]] bool connect();
  void take_found();
  void take_one();
  [[nodiscard]] bool has_joined(pid_t process);
  void forget_joined();
  template <class Which>
  void forget(Which which);
  void follow_job();
  void carry_out(coord::Command command);
  void let_run(bool run);
  void suspend(std::uint32_t handle);
  void feed(std::int64_t now_ns);

  Options options_;
  // Of the managing thread:
  kernel::QueueControl control_;
  std::unique_ptr<coord::Port> port_;
  std::map<std::uint32_t, pid_t> handles_;  ///< registered, and whose they are
  std::vector<Found> found_;                ///< still to be registered, ...
  std::set<std::uint32_t> still_;           ///< ... and those of this look that were
  bool looks_ = false;                      ///< found_ is not through
  bool begun_ = false;                      ///< it has a job
  bool taken_ = false;                      ///< whose XPU somebody has taken
  bool runs_ = true;                        ///< nothing is suspended
  std::int64_t fed_ns_ = 0;
  std::int64_t others_ns_ = 0;  ///< jobs had the XPU for, at the last look

  std::atomic<bool> stop_{false};
  std::atomic<int> slot_{-1};
  std::atomic<std::uint32_t> queues_{0};
  std::atomic<std::uint64_t> suspensions_{0}, not_kept_off_{0};
  PiMutex mutex_;
  std::set<pid_t> joined_ XAUTO_GUARDED_BY(mutex_);
  std::vector<Found> new_ XAUTO_GUARDED_BY(mutex_);
  bool looked_ XAUTO_GUARDED_BY(mutex_) = false;  ///< new_ is a whole look
  std::atomic<bool> others_joined_{false};
  coord::Port* interruptible_ XAUTO_GUARDED_BY(mutex_) = nullptr;
  std::thread manager_, looker_;
};

}  // namespace xauto::launch
