// SPDX-License-Identifier: Apache-2.0
// Channel groups of NVIDIA's RM driver (Thor; desktop and data-centre GPUs from Turing on), this
// process's own, suspended by itself. No descriptor shows them: libxauto_watch.so sees them made.
// Read in the open driver's source, and run on an H100: docs/backends.md.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "kernel/patience.h"
#include "kernel/queue_files.h"

namespace xauto::kernel {

/// libxauto_watch.so stands before libc's ioctl in this process.
[[nodiscard]] bool rm_is_watched();

/// This process's groups, with `target` "rm:CLIENT:GROUP:MADE" and the client's descriptor.
[[nodiscard]] std::vector<QueueFile> find_rm_groups();

/// Threads: one at a time.
class RmQueues {
 public:
  using Handle = std::uint32_t;

  RmQueues() = default;
  RmQueues(const RmQueues&) = delete;
  RmQueues& operator=(const RmQueues&) = delete;
  /// Resumes all.
  ~RmQueues();

  /// A group that was taken gives its handle. kUnavailable: it is not there.
  [[nodiscard]] Result<Handle> take(const QueueFile& group);
  void give_back(Handle handle);

  /// All of them in one call for each GPU, as each is a message to the GSP. When it returns none of
  /// their channels runs. An error leaves all running. kTimeout, kUnavailable: as OwnQueues.
  [[nodiscard]] Status suspend(const std::vector<Handle>& handles);
  [[nodiscard]] Status resume(const std::vector<Handle>& handles);

  /// A suspension holds by itself; channels that a suspended group has got since are added, and what
  /// could not be resumed is tried again.
  void again();
  [[nodiscard]] bool owes() const;
  [[nodiscard]] bool gated(Handle handle) const { return groups_.at(handle).patience.gated(); }

 private:
  struct Group {
    QueueFile file;
    bool suspended = false, owed = false;
    std::size_t channels = 0;  ///< that were told
    Patience patience = {};
  };
  /// RM's status; of several what is to be tried again, before what is gone.
  [[nodiscard]] std::uint32_t tell(const std::vector<Handle>& handles, bool disable);
  [[nodiscard]] std::string names(const std::vector<Handle>& handles) const;
  std::map<Handle, Group> groups_;
  Handle last_ = 0;
};

}  // namespace xauto::kernel
