// SPDX-License-Identifier: Apache-2.0
// Child processes that cannot outlive us: killed by the kernel when the spawning thread dies
// (PR_SET_PDEATHSIG), and by the destructor.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"

namespace xauto {

struct SpawnOptions {
  std::vector<std::string> argv;  ///< argv[0]: a path, or a name to look for in PATH
  std::vector<int>
      inherit;  ///< descriptors to keep, under their own numbers; all others are closed
  std::vector<std::pair<std::string, std::string>> environment;  ///< added to ours
  /// A process group of its own: the terminal's Ctrl-C then reaches only us, who forward it once.
  bool own_group = true;
};

/// How a child ended.
struct Exit {
  bool signalled = false;
  int value = 0;            ///< exit status, or the signal's number
  std::int64_t cpu_us = 0;  ///< user and system time that it used
  /// Nothing is known: the program that we are part of ignores SIGCHLD, or reaps every child.
  bool unknown = false;
  [[nodiscard]] std::string to_string() const;
};

/// /dev/null for those of stdin, stdout and stderr that are closed: else the next file that is
/// opened is one of them, and children read or print into it. First thing in main().
void open_standard_streams();

/// Threads: one. Must be destroyed on the thread that spawned it, since that thread's end kills the
/// child.
class Child {
 public:
  [[nodiscard]] static Result<Child> spawn(const SpawnOptions& options);
  Child() = default;
  Child(Child&& other) noexcept;
  Child& operator=(Child&& other) noexcept;
  ~Child();

  [[nodiscard]] pid_t pid() const { return pid_; }
  [[nodiscard]] int pidfd() const { return pidfd_.get(); }  ///< readable once it has ended
  [[nodiscard]] bool running() const { return pid_ > 0 && !exit_; }
  void signal(int number) const;
  /// Reaps it if it has ended.
  std::optional<Exit> poll();
  /// Waits at most `timeout_ms`.
  std::optional<Exit> wait(int timeout_ms);
  /// SIGTERM, then SIGKILL after `grace_ms`; reaps. Nothing to do if it has ended.
  Exit stop(int grace_ms);

 private:
  pid_t pid_ = -1;
  UniqueFd pidfd_;
  std::optional<Exit> exit_;
  OneThread thread_;
};

/// The directory of the running program, for finding the programs that are installed beside it. Without /proc: where
/// packages install them.
[[nodiscard]] std::string program_directory();

}  // namespace xauto
