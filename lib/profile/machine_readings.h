// SPDX-License-Identifier: Apache-2.0
// Under which clocks, power mode and temperatures the profiler measures: what the machine's files say,
// those that conditions of scenarios name (Condition::file).
#pragma once

#include <string>
#include <vector>

#include "base/thread_safety.h"
#include "model/profile.h"

namespace xauto::runtime {

/// Threads: one. It allocates and reads some tens of files: not while anything is measured.
class MachineReadings {
 public:
  /// `root`: the folder in which the machine's /sys and /var are, without a slash at its end; "": they
  /// are where they belong. Which files there are is asked once, here.
  explicit MachineReadings(const std::string& root);
  /// Reads all of them. A file that holds nothing comparable is passed over: a thermal zone that is
  /// powered off, a text of several lines.
  void look();
  /// Of all looks, by file.
  [[nodiscard]] std::vector<Reading> taken() const;

 private:
  struct Watched {
    std::string path;  ///< below the root
    Reading reading;
    bool read = false;  ///< at least once
  };
  OneThread thread_;
  std::vector<Watched> files_;
};

}  // namespace xauto::runtime
