// SPDX-License-Identifier: Apache-2.0
// What the bridge's thread, "xauto/dds", waits for.
#pragma once

#include <atomic>

#include "transport/doorbell.h"

namespace xauto::transport {

/// Rung by publishers, which may be real-time threads, and by threads of Cyclone DDS.
struct Work {
  std::atomic<bool> quit{false};
  Doorbell doorbell;
};

}  // namespace xauto::transport
