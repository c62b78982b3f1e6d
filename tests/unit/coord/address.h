// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <string>

#include <unistd.h>

namespace xauto::coord {

/// An abstract socket of this test's own.
inline std::string unique_address() {
  static std::atomic<int> count{0};
  return "xauto-test/" + std::to_string(getpid()) + "-" + std::to_string(count.fetch_add(1)) +
         "/gpu0";
}

}  // namespace xauto::coord
