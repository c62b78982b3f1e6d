// SPDX-License-Identifier: Apache-2.0
// XAUTO_CHECK: for our own bugs only, never for input. Dying is safe: whatever this process had
// suspended is resumed by the kernel module or the emulator when its descriptors close.
#pragma once

namespace xauto {

/// Says so, whoever reads it, and aborts. In log.cc.
[[noreturn]] void die_of_bug(const char* file, int line, const char* condition);

}  // namespace xauto

#define XAUTO_CHECK(condition)                             \
  do {                                                     \
    if (!(condition)) [[unlikely]]                         \
      ::xauto::die_of_bug(__FILE__, __LINE__, #condition); \
  } while (false)
