// SPDX-License-Identifier: Apache-2.0
// nvgpu and nvdla of L4T 36 as their source says, without work: what enables a TSG, what refuses, and
// what a file that is closed takes with it. kmod/emu/ has the same with an engine, in a kernel.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "kernel.h"

namespace devices {

/// Guarded by Kernel::mutex().
struct NvgpuState {
  struct Tsg {
    std::set<int> channels;  ///< by number
    bool enabled = true;     ///< all of them
    bool closed = false;     ///< its file is gone: it lives as long as a channel is bound
    int disables = 0, preempts = 0;
  };
  std::map<int, Tsg> tsgs;
  int last = 0;
  /// Queues of the DLA: a slot of the pool each; the firmware's suspension stays with the slot.
  std::vector<bool> slot_used = std::vector<bool>(16), slot_suspended = std::vector<bool>(16);
  int dla_commands = 0;

  bool gone = false;     ///< the driver dies: gk20a_busy fails
  int fail_enable = 0;   ///< so many of the next find a GPU that does not power on
  int pass_preempt = 0;  ///< so many of the next leave, then
  int fail_preempt = 0;  ///< so many do not: EBUSY
  int preempt_error = 16;

  [[nodiscard]] int disabled() const;
  [[nodiscard]] int suspended_slots() const;
};

class Nvgpu final : public Driver {
 public:
  explicit Nvgpu(NvgpuState& state) : state_(state) {}
  bool has(const std::string& node) const override;
  std::shared_ptr<File> open(const std::string& node) override;

 private:
  NvgpuState& state_;
};

}  // namespace devices
