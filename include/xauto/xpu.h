// SPDX-License-Identifier: Apache-2.0
// XPU types, instances, and the scheduling handle by which an instance's work can be preempted.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace xauto {

/// A type of processor. The three of a Jetson have names; any other word names any other XPU, which
/// is then gated (one job at a time, not preempted).
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

 private:
  std::string type_;
};
inline const XPU XPU::CPU{"cpu"};
inline const XPU XPU::GPU{"gpu"};
inline const XPU XPU::DLA{"dla"};

/// One XPU instance, e.g. {"gpu0", XPU::GPU, 0}; what `init` receives.
struct XpuId {
  std::string name;  ///< as in platform.json
  XPU type{"cpu"};   ///< its type, by which the implementation was chosen
  int index = 0;     ///< among the instances of its type
};

/// What `init` returns: the thing behind which all work of this XNode on this XPU instance is
/// queued, so that suspending it suspends the XNode. A value; it does not own what it names: a
/// CUcontext, a cudlaDevHandle or an emulated context must outlive the App's run.
class SchedHandle {
 public:
  /// Which kind of thing it names, and so which backend suspends it.
  enum class Kind : std::uint8_t {
    kGate,         ///< cannot be suspended: the XPU is given to one job at a time
    kThread,       ///< the worker's own thread, on a CPU
    kCudaContext,  ///< a CUcontext; its TSG is found and suspended
    kCudlaDevice,  ///< a cudlaDevHandle; its queue is found and suspended
    kEmulated,     ///< a context of xauto-emud, see emu.h
  };

  /// gate()
  SchedHandle() = default;
  /// For an XPU whose work cannot be suspended: one job at a time, to its end.
  [[nodiscard]] static SchedHandle gate() { return {Kind::kGate, 0}; }
  /// For a CPU implementation that computes in `exec`, on the thread it is called on.
  [[nodiscard]] static SchedHandle thread() { return {Kind::kThread, 0}; }
  /// For a GPU: the CUcontext that all work of the XNode goes to, and no other XNode's. Not null.
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

  /// The kind.
  [[nodiscard]] Kind kind() const { return kind_; }
  /// The pointer or number given; 0 for gate() and thread().
  [[nodiscard]] std::uintptr_t value() const { return value_; }
  /// Of the same thing.
  bool operator==(const SchedHandle&) const = default;

 private:
  SchedHandle(Kind kind, std::uintptr_t value) : kind_(kind), value_(value) {}
  Kind kind_ = Kind::kGate;
  std::uintptr_t value_ = 0;
};

}  // namespace xauto
