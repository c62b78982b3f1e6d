// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>

#include "emu/machine.h"

namespace xauto::emu {

inline constexpr Nanos kMs = 1'000'000, kUs = 1000;
inline constexpr Nanos kNever =
    std::numeric_limits<Nanos>::max();  ///< what next_event() says when idle

}  // namespace xauto::emu
