// SPDX-License-Identifier: Apache-2.0
// amdkfd's queues, as Linux's source says: what UPDATE_QUEUE refuses, and when a queue runs.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "kernel.h"

namespace devices {

/// Guarded by Kernel::mutex().
struct KfdState {
  struct Queue {
    const File* file = nullptr;
    std::uint64_t address = 0;
    std::uint32_t size = 0, percentage = 0, priority = 0;
    bool active = false;  ///< on the hardware
  };
  std::map<std::uint32_t, Queue> queues;
  int updates = 0;
  int taken_off = 0;  ///< by an update

  int fail_off = 0;  ///< so many of the next updates that take a queue off fail with `error`
  int fail_on = 0;   ///< ... that put one on
  int error = 62;    ///< ETIME: the queue did not leave

  [[nodiscard]] int active() const;
};

class Kfd final : public Driver {
 public:
  explicit Kfd(KfdState& state) : state_(state) {}
  bool has(const std::string& node) const override;
  std::shared_ptr<File> open(const std::string& node) override;

 private:
  KfdState& state_;
};

}  // namespace devices
