// SPDX-License-Identifier: Apache-2.0
// Which TSGs and DLA queues of this process are behind which scheduling handle. A CUcontext and a
// cudlaDevHandle are opaque, and what they open in the kernel is a descriptor; so what appears
// while a handle's code runs is the handle's:
//   - while `init` makes it (one at a time);
//   - while an `exec` of it runs, and of no other handle on this XPU: nvgpu has a TSG for each
//     runlist, so the first copy may open one long after the context.
// What appears while several run could be anybody's, and is nobody's: it is counted.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "kernel/queue_files.h"

namespace xauto::xpu {

/// Any thread.
class Contexts {
 public:
  using Value = std::uintptr_t;  ///< SchedHandle::value()
  /// All GPUs are one, since a TSG does not say whose it is; `instance` is -1 then.
  struct Which {
    kernel::QueueType type;
    int instance;
    bool operator<(const Which& other) const {
      return type != other.type ? type < other.type : instance < other.instance;
    }
  };

  [[nodiscard]] static Contexts& of_this_process();

  /// What is there now was made by others.
  [[nodiscard]] Status before_making(Which which);
  /// What is new belongs to `handle`. Nothing is: then it has what it had, or on a DLA the only
  /// queue of this process, for nvdla's node is opened once. kNotFound otherwise.
  [[nodiscard]] Status made(Which which, Value handle);

  /// Around an `exec`. `look`: at what it has opened; otherwise that is left to the next look.
  /// Returns how many queues appeared that are nobody's.
  std::uint32_t begin(Which which, Value handle, bool look);
  std::uint32_t end(Which which, Value handle, bool look);

  [[nodiscard]] std::vector<kernel::QueueFile> of(Value handle) const;
  /// Another handle has one of its queues, too.
  [[nodiscard]] bool shared(Value handle) const;
  /// Another one whenever `of` may say something else.
  [[nodiscard]] std::uint64_t generation() const { return generation_.load(); }

 private:
  struct Seen {
    std::vector<kernel::QueueFile> known;
    std::vector<Value> active;    ///< whose `exec` runs, once for each
    std::vector<Value> suspects;  ///< ... or has run since the last look
  };
  [[nodiscard]] static Result<std::vector<kernel::QueueFile>> files(Which which);
  [[nodiscard]] std::uint32_t look_at(Which which, Seen& seen) XAUTO_REQUIRES(mutex_);
  void claim(Value handle, const std::vector<kernel::QueueFile>& files) XAUTO_REQUIRES(mutex_);

  mutable PiMutex mutex_;
  std::map<Which, Seen> seen_ XAUTO_GUARDED_BY(mutex_);
  std::map<Value, std::vector<kernel::QueueFile>> files_ XAUTO_GUARDED_BY(mutex_);
  std::atomic<std::uint64_t> generation_{1};
};

/// It is still the file that it was: a number is used again.
[[nodiscard]] bool is_open(const kernel::QueueFile& file);

}  // namespace xauto::xpu
