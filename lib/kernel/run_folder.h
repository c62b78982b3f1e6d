// SPDX-License-Identifier: Apache-2.0
// What one run has pinned, /sys/fs/bpf/xauto/RUN/: made, locked as long as the run lives, and taken away with it, or by the
// next run if it was killed.
//
// Threads: one at a time.
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto::kernel {

class RunFolder {
 public:
  /// `run`: a name of letters, digits and dashes. Removes what runs that were killed left behind. kPermission: its hint
  /// says who may.
  [[nodiscard]] static Result<RunFolder> make(const std::string& run);
  RunFolder(RunFolder&& other) noexcept = default;
  RunFolder& operator=(RunFolder&& other) noexcept;
  ~RunFolder();

  [[nodiscard]] const std::string& run() const { return run_; }

  /// Names of those whose maker lives.
  [[nodiscard]] static std::vector<std::string> alive();
  [[nodiscard]] static std::string path_of(const std::string& run);
  /// Unpins whatever the run has pinned.
  static void remove(const std::string& run);
  /// kInvalid: no name for a run.
  [[nodiscard]] static Status check_name(const std::string& run);

 private:
  RunFolder() = default;
  std::string run_;
  UniqueFd life_;  ///< the folder, locked; none: moved from
};

/// Held by who makes folders of runs, or writes what several runs share.
class LockOfAllRuns {
 public:
  LockOfAllRuns();

 private:
  UniqueFd root_;
};

/// Locks that folder as long as what is returned lives.
[[nodiscard]] UniqueFd live_in(const std::string& folder);
/// Whether somebody does. A number would say less: in a container it is another's.
[[nodiscard]] bool somebody_lives_in(const std::string& folder);

}  // namespace xauto::kernel
