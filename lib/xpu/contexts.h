// SPDX-License-Identifier: Apache-2.0
// Which TSGs and DLA queues of this process are behind which scheduling handle. A CUcontext and a
// cudlaDevHandle are opaque, and what they open in the kernel is a descriptor; so what appears
// while a handle's code runs is the handle's:
//   - while `init` or make_context() makes it (one at a time);
//   - while an `exec` of it runs, and of no other handle on this XPU: nvgpu has a TSG for each
//     runlist, so the first copy may open one long after the context.
// What appears while several run could be anybody's, and is nobody's: it is counted. So is a TSG
// that the GPU has and no descriptor leads to.
// A handle of which nothing is known was made before: it is assumed to have all that is nobody's.
// Of two such handles neither has anything.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "kernel/queue_files.h"

namespace xauto::xpu {

/// Any thread.
class Contexts {
 public:
  using Value = std::uintptr_t;  ///< SchedHandle::value()
  using Files = std::vector<kernel::QueueFile>;
  /// All GPUs are one, since a TSG does not say whose it is; `instance` is -1 then.
  struct Which {
    kernel::QueueType type;
    int instance;
    bool operator<(const Which& other) const {
      return type != other.type ? type < other.type : instance < other.instance;
    }
  };

  [[nodiscard]] static Contexts& of_this_process();

  /// While it lives a context is being made: what appears is looked at by nobody else. Another
  /// thread's waits; a thread may make one while it makes another. It dies on its thread.
  class Making {
   public:
    explicit Making(Contexts& all);
    ~Making();
    Making(const Making&) = delete;
    Making& operator=(const Making&) = delete;
    /// What has appeared since belongs to `handle`. Nothing has: false.
    [[nodiscard]] Result<bool> made(Which which, Value handle);

   private:
    Contexts& all_;
    const std::unique_lock<std::recursive_mutex> alone_;
    Files before_;
  };

  /// `init` has returned `handle`, `user` will suspend it. It has what has appeared; if nothing has,
  /// what it had; or on a DLA the only queue of this process, for nvdla's node is opened once; or
  /// else all that is nobody's. kNotFound: nothing is; or another handle has got all, and is refuted.
  [[nodiscard]] Status made(Making& making, Which which, Value handle, const void* user);
  /// `user` suspends nothing any more.
  void leave(const void* user);

  /// Around an `exec`. `look`: at what it has opened; otherwise that is left to the next look, but
  /// not while another one's runs that began with a look: what that has opened so far is its own.
  /// Returns how many queues are nobody's; each is told once after each `made`.
  std::uint32_t begin(Which which, Value handle, bool look);
  std::uint32_t end(Which which, Value handle, bool look);

  /// At what all that run have opened so far.
  std::uint32_t look(Which which);

  [[nodiscard]] Files of(Value handle) const;
  /// Another handle has one of its queues, or another user the handle.
  [[nodiscard]] bool shared(Value handle) const;
  /// It was there before any `init`, and has what was nobody's.
  [[nodiscard]] bool assumed(Value handle) const;
  /// ... and so was another: what it has may be the other's.
  [[nodiscard]] bool refuted(Value handle) const;
  /// Another one whenever `of` may say something else.
  [[nodiscard]] std::uint64_t generation() const { return generation_.load(); }

 private:
  struct Hidden {
    std::size_t count = 0, told = 0;
    std::size_t candidate = 0;  ///< the fewest of all looks since then, all of them above `count`
    std::int64_t since_ns = 0;
    void look(std::size_t descriptors);
    [[nodiscard]] std::uint32_t untold();
  };
  struct Seen {
    Files known, told;
    Files ambiguous;              ///< appeared while several ran
    std::vector<Value> active;    ///< whose `exec` runs, once for each
    std::vector<Value> first;     ///< ... and began with a look
    std::vector<Value> suspects;  ///< ... or has run since the last look
    Hidden hidden;
  };
  struct Context {
    Files files;
    bool assumed = false, refuted = false;
    std::vector<const void*> users;
  };
  [[nodiscard]] static Result<Files> files(Which which);
  void look_at(Which which, Seen& seen) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] std::uint32_t untold(Seen& seen) const XAUTO_REQUIRES(mutex_);
  [[nodiscard]] Status assume(Which which, Value handle, const Files& now) XAUTO_REQUIRES(mutex_);
  void claim(Value handle, const Files& files) XAUTO_REQUIRES(mutex_);
  void forget_closed() XAUTO_REQUIRES(mutex_);
  /// Which of `files` are nobody's.
  [[nodiscard]] Files unowned(const Files& files) const XAUTO_REQUIRES(mutex_);

  std::recursive_mutex alone_;  ///< before mutex_
  mutable PiMutex mutex_;
  int making_ XAUTO_GUARDED_BY(mutex_) = 0;
  Files taken_ XAUTO_GUARDED_BY(mutex_);  ///< by what was made within what is being made
  std::map<Which, Seen> seen_ XAUTO_GUARDED_BY(mutex_);
  std::map<Value, Context> contexts_ XAUTO_GUARDED_BY(mutex_);
  std::atomic<std::uint64_t> generation_{1};
};

}  // namespace xauto::xpu
