// SPDX-License-Identifier: Apache-2.0
// What runs on an XPU, seen from beside its protocol: reads the shared words (shm_layout.h), writes
// none, and costs those who run nothing. The memory outlives the coordinator that gave it, and is
// its successor's.
//
// Threads: any, once it is made.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "coord/door.h"
#include "coord/shm_layout.h"

namespace xauto::coord {

class Observer {
 public:
  /// Of the coordinator at `address` (door.h).
  [[nodiscard]] static Result<std::unique_ptr<Observer>> connect(const std::string& address);
  ~Observer();
  Observer(const Observer&) = delete;
  Observer& operator=(const Observer&) = delete;

  /// A job of this run that may run and is not suspended; generation and slot tell it from all others.
  struct Running {
    int slot;
    std::uint32_t generation;
    std::uint32_t xnode;
    Key key;
  };
  /// Appends those of now. What changes while it looks may be missed, and is seen by the next look.
  void running(std::vector<Running>& out) const;
  [[nodiscard]] Discipline discipline() const {
    return static_cast<Discipline>(shm_.header->discipline);
  }

 private:
  Observer() = default;
  Door door_;
  Shm shm_;
  std::size_t bytes_ = 0;
};

}  // namespace xauto::coord
