// SPDX-License-Identifier: Apache-2.0
// XPU types, instances, and the scheduling handle by which an instance's work can be preempted.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include <xauto/result.h>

struct CUctx_st;          // what a CUcontext of cuda.h points at
struct cudlaDevHandle_t;  // and a cudlaDevHandle of cudla.h

namespace xauto {

/// A type of processor. Those of a Jetson have names; any other word names an XPU of the app's
/// own. That one is gated (one job at a time, not preempted), unless platform.json says that it is
/// preemptive; then its handles must be SchedHandle::custom().
class XPU {
 public:
  /// `type` as platform.json and app.json spell it: a word in lower case.
  explicit XPU(std::string_view type) : type_(type) {}
  /// "cpu"
  [[nodiscard]] const std::string& type() const { return type_; }
  /// Of the same type.
  bool operator==(const XPU&) const = default;

  static const XPU CPU;  ///< `"cpu"`
  static const XPU GPU;  ///< `"gpu"`
  static const XPU DLA;  ///< `"dla"`
  static const XPU VIC;  ///< `"vic"`, the Video Image Compositor; gated
  static const XPU PVA;  ///< `"pva"`, the Programmable Vision Accelerator; gated

 private:
  std::string type_;
};
inline const XPU XPU::CPU{"cpu"};
inline const XPU XPU::GPU{"gpu"};
inline const XPU XPU::DLA{"dla"};
inline const XPU XPU::VIC{"vic"};
inline const XPU XPU::PVA{"pva"};

/// One XPU instance, e.g. {"gpu0", XPU::GPU, 0}; what `init` receives. It names the instance and
/// nothing else: whatever there is to know of one is asked by a function that takes an XpuId.
struct XpuId {
  std::string name;  ///< as in platform.json
  XPU type{"cpu"};   ///< its type, by which the implementation was chosen
  int index = 0;     ///< among the instances of its type
};

/// What `init` returns: the thing behind which all work of this XNode on this XPU instance is
/// queued, so that suspending it suspends the XNode. A value; it does not own what it names: a
/// CUcontext, a cudlaDevHandle or an emulated context must outlive the App's run (own() sees to
/// that). Its layout stays as it is: what a further kind needs goes behind the pointer.
class SchedHandle {
 public:
  /// Which kind of thing it names, and so which backend suspends it.
  enum class Kind : std::uint8_t {
    kGate,         ///< cannot be suspended: the XPU is given to one job at a time
    kThread,       ///< the worker's own thread, on a CPU
    kCudaContext,  ///< a CUcontext; its TSG is found and suspended
    kCudlaDevice,  ///< a cudlaDevHandle; its queue is found and suspended
    kEmulated,     ///< a context of xauto-emud, see emu.h
    kCustom,       ///< two functions of the app's
    kLevels,       ///< likewise, of an XPU that preempts by priority levels
  };

  struct Callbacks;  ///< of custom() and on_levels(); the library's

  /// gate()
  SchedHandle() = default;
  /// cuda_context(): an `init` may return a CUcontext itself, as the paper's does.
  // NOLINTNEXTLINE(google-explicit-constructor): the point of it
  SchedHandle(CUctx_st* cu_context) : SchedHandle(cuda_context(cu_context)) {}
  /// cudla_device(), likewise of a cudlaDevHandle.
  // NOLINTNEXTLINE(google-explicit-constructor)
  SchedHandle(cudlaDevHandle_t* device) : SchedHandle(cudla_device(device)) {}
  /// For an XPU whose work cannot be suspended: one job at a time, to its end.
  [[nodiscard]] static SchedHandle gate() { return {Kind::kGate, 0}; }
  /// For a CPU implementation that computes in `exec`, on the thread it is called on.
  [[nodiscard]] static SchedHandle thread() { return {Kind::kThread, 0}; }
  /// For a GPU: the CUcontext that all work of the XNode goes to, and no other XNode's. Not null. On
  /// an AMD GPU what HIP calls its context: it is a name, and nothing is called through it.
  [[nodiscard]] static SchedHandle cuda_context(void* cu_context) {
    return {Kind::kCudaContext, reinterpret_cast<std::uintptr_t>(cu_context)};
  }
  /// For a DLA: the cudlaDevHandle, likewise.
  [[nodiscard]] static SchedHandle cudla_device(void* device) {
    return {Kind::kCudlaDevice, reinterpret_cast<std::uintptr_t>(device)};
  }
  /// What emu::Context::handle() returns; nobody else needs it.
  [[nodiscard]] static SchedHandle emulated(std::uint32_t context) {
    return {Kind::kEmulated, context};
  }

  /// For an XPU type of the app's own that can be preempted. `suspend`: when it returns, none of
  /// the XNode's work runs on the XPU; an error leaves it running, and the coordinator then lets it
  /// finish. The more urgent job is not held up until then: its `exec` may begin before `suspend` has
  /// returned. So the XPU must bear the work of two jobs for that long, as a GPU's queues do.
  /// `resume`: lets it go on where it was. Each may be called when it has nothing to do,
  /// then it succeeds. Threads: both from the worker's management thread, one at a time, while
  /// `exec` is on another; so both must be safe beside `exec`. They are copied, and live until the
  /// run has ended. What they throw counts as an error. The XPU must be `"preemptive": true` in
  /// platform.json; otherwise it is gated and neither is called.
  [[nodiscard]] static SchedHandle custom(std::function<Status()> suspend,
                                          std::function<Status()> resume);

  /// For an XPU whose hardware preempts by priority levels (`"levels"` in platform.json), and whose queues are the
  /// app's: CUDA streams (cuda.h makes such a handle), Vulkan or Level Zero queues. `take(level)`: what this XNode
  /// queues from now on runs on that level, 0 being the lowest of levels(). It is called on the execution thread
  /// before each job; a level is no other job's as long as that one has started and not ended. So `exec` has to wait
  /// for its work. An error leaves the work where it was, and is counted. `xauto profile` times each XNode on the
  /// highest level also beside others on the lowest: how long it waits for what cannot be taken off is in its WCET.
  [[nodiscard]] static SchedHandle on_levels(std::function<Status(int level)> take);

  /// The kind.
  [[nodiscard]] Kind kind() const { return kind_; }
  /// The name of the function above that made it.
  [[nodiscard]] const char* kind_name() const;
  /// The pointer or number given; 0 for gate(), thread(), custom() and on_levels().
  [[nodiscard]] std::uintptr_t value() const { return value_; }
  /// Of custom() and on_levels(); else null.
  [[nodiscard]] const Callbacks* callbacks() const { return callbacks_.get(); }
  /// Of the same thing.
  bool operator==(const SchedHandle&) const = default;

 private:
  SchedHandle(Kind kind, std::uintptr_t value) : kind_(kind), value_(value) {}
  Kind kind_ = Kind::kGate;
  std::uintptr_t value_ = 0;
  std::shared_ptr<const Callbacks> callbacks_;
};

/// Within an `init`: by how many priority levels jobs are started on this XPU (`"levels"` in platform.json). 0: by none;
/// jobs are suspended, or one runs at a time, or nobody schedules. Elsewhere: 0.
[[nodiscard]] int levels(const XpuId& xpu);

/// For a CUcontext or a cudlaDevHandle that is not made in an `init`, but in main() or by a library.
/// Calls `make`, which makes it, and returns the handle that `make` returned. What appears meanwhile
/// is suspended with it in later runs of this process. Not needed where the process has but one
/// context (docs/api.md). On a machine without a driver, and for other handles, it does nothing
/// else. It fails with nothing of its own; what `make` throws comes out. Threads: any; one makes
/// contexts at a time, others and `init`s of GPUs and DLAs wait. Not while stages run that may open
/// more themselves: what they open is taken for this context's.
SchedHandle make_context(const std::function<SchedHandle()>& make);

}  // namespace xauto
