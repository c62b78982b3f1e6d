// SPDX-License-Identifier: Apache-2.0
// Which TSGs and DLA queues does a process hold? A CUcontext and a cudlaDevHandle are opaque; what
// they opened in the kernel is visible as descriptors.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "kernel/queue_control.h"

namespace xauto::kernel {

struct QueueFile {
  int fd = -1;  ///< in that process
  QueueType type = QueueType::kGpuTsg;
  int instance = -1;   ///< which DLA; -1 for what is a GPU's
  std::string target;  ///< what the descriptor leads to: "anon_inode:nvgpu-ga10b-tsg12"
  bool operator==(const QueueFile&) const = default;
};

/// What the link of a descriptor says about it; nothing if it is neither. The names are nvgpu's and
/// nvdla's (include/uapi/xauto/nvgpu.h, nvdla.h); xauto.ko has the last word.
[[nodiscard]] bool classify_queue_file(const std::string& target, QueueFile& file);

/// In order of descriptors. kNotFound: no such process; kPermission: not ours to look at. `root`
/// stands for / in tests.
[[nodiscard]] Result<std::vector<QueueFile>> find_queue_files(pid_t pid,
                                                              const std::string& root = {});

/// How many TSGs a process has opened and the GPU still has, by nvgpu's "sched" node: a TSG outlives
/// its descriptors while a channel is bound to it. Nothing: there is no such node here, it is not
/// ours to open, somebody else has it open at the moment, or (in a container) nvgpu knows the
/// process by another number.
[[nodiscard]] std::optional<std::size_t> count_tsgs(pid_t pid);

/// This process's, of every driver: also those that no descriptor shows.
[[nodiscard]] Result<std::vector<QueueFile>> find_own_queues();
/// It is still there, and what it was: a number is used again.
[[nodiscard]] bool is_open(const QueueFile& file);

/// A duplicate of this process's descriptor, if it leads to `target`: what a driver is asked through
/// it goes to that file, whoever closes the number meanwhile. find_own_queues() does not list it.
class Duplicate {
 public:
  Duplicate() = default;
  Duplicate(int fd, const std::string& target);
  Duplicate(Duplicate&&) = default;
  Duplicate& operator=(Duplicate&& other) noexcept;
  ~Duplicate() { close(); }
  [[nodiscard]] int get() const { return fd_.get(); }
  explicit operator bool() const { return static_cast<bool>(fd_); }

 private:
  void close();
  UniqueFd fd_;
};

/// Types of queues that a context on a GPU may have.
inline constexpr QueueType kGpuQueues[] = {QueueType::kGpuTsg, QueueType::kRmGroup,
                                           QueueType::kKfdQueue, QueueType::kI915Context};
/// Where nobody sees what this process opens.
inline constexpr const char* kWatchHint =
    "start it by `xauto run`, or with LD_PRELOAD=libxauto_watch.so, or plan with \"preemptive\": "
    "false (docs/backends.md)";

/// A duplicate, in this process, of another's descriptor: pidfd_getfd(2), so ptrace's rules hold.
[[nodiscard]] Result<UniqueFd> take_descriptor(pid_t pid, int fd);

}  // namespace xauto::kernel
