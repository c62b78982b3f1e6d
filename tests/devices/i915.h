// SPDX-License-Identifier: Apache-2.0
// i915's contexts, as Linux's source says: what it refuses, and that a request has the priority that
// its context had when it was queued. Of the requests that are not done those of the highest
// priority run. As the integrated GPU of a processor: /dev/dri/renderD128.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "kernel.h"

namespace devices {

/// Guarded by Kernel::mutex().
struct I915State {
  using Name = std::pair<const File*, std::uint32_t>;
  std::map<Name, int> contexts;  ///< their priorities; each file's 0 is not among them
  std::map<Name, int> requests;  ///< of a file's objects that are not done: priorities
  int changes = 0;               ///< of a context's priority
  int preemptions = 0;           ///< a request came that was above those that ran

  int scheduler = 0x2f;  ///< I915_PARAM_HAS_SCHEDULER; 0xf: without GuC submission
  bool nice = true;      ///< the caller has CAP_SYS_NICE
  int fail = 0;          ///< so many of the next SETPARAM fail with `error`
  int error = 5;         ///< EIO

  [[nodiscard]] int preempted() const;
};

class I915 final : public Driver {
 public:
  explicit I915(I915State& state) : state_(state) {}
  bool has(const std::string& node) const override;
  std::shared_ptr<File> open(const std::string& node) override;

 private:
  I915State& state_;
};

}  // namespace devices
