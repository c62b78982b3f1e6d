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
  explicit XPU(std::string_view type) : type_(type) {}
  [[nodiscard]] const std::string& type() const { return type_; }
  bool operator==(const XPU&) const = default;

  static const XPU CPU, GPU, DLA;

 private:
  std::string type_;
};
inline const XPU XPU::CPU{"cpu"};
inline const XPU XPU::GPU{"gpu"};
inline const XPU XPU::DLA{"dla"};

/// One XPU instance, e.g. {"gpu0", XPU::GPU, 0}; what `init` receives.
struct XpuId {
  std::string name;
  XPU type{"cpu"};
  int index = 0;  ///< among the instances of its type
};

/// What `init` returns: the thing behind which all work of this XNode on this XPU instance is
/// queued, so that suspending it suspends the XNode. A value; it does not own what it names: a
/// CUcontext, a cudlaDevHandle or an emulated context must outlive the App's run.
class SchedHandle {
 public:
  enum class Kind : std::uint8_t {
    kGate,         ///< cannot be suspended: the XPU is given to one job at a time
    kThread,       ///< the worker's own thread, on a CPU
    kCudaContext,  ///< a CUcontext; its TSG is found and suspended
    kCudlaDevice,  ///< a cudlaDevHandle; its queue is found and suspended
    kEmulated,     ///< a context of xauto-emud, see emu.h
  };

  SchedHandle() = default;
  [[nodiscard]] static SchedHandle gate() { return {Kind::kGate, 0}; }
  [[nodiscard]] static SchedHandle thread() { return {Kind::kThread, 0}; }
  [[nodiscard]] static SchedHandle cuda_context(void* cu_context) {
    return {Kind::kCudaContext, reinterpret_cast<std::uintptr_t>(cu_context)};
  }
  [[nodiscard]] static SchedHandle cudla_device(void* device) {
    return {Kind::kCudlaDevice, reinterpret_cast<std::uintptr_t>(device)};
  }
  [[nodiscard]] static SchedHandle emulated(std::uint32_t context) {
    return {Kind::kEmulated, context};
  }

  [[nodiscard]] Kind kind() const { return kind_; }
  [[nodiscard]] std::uintptr_t value() const { return value_; }
  bool operator==(const SchedHandle&) const = default;

 private:
  SchedHandle(Kind kind, std::uintptr_t value) : kind_(kind), value_(value) {}
  Kind kind_ = Kind::kGate;
  std::uintptr_t value_ = 0;
};

}  // namespace xauto
