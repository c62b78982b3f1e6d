// SPDX-License-Identifier: Apache-2.0
// XAUTO_CHECK: for our own bugs only, never for input. Dying is safe: whatever this process had
// suspended is resumed by the kernel module or the emulator when its descriptors close.
#pragma once

#include <cstdio>
#include <cstdlib>

#define XAUTO_CHECK(condition)                                                          \
  do {                                                                                  \
    if (!(condition)) [[unlikely]] {                                                    \
      std::fprintf(stderr, "xauto: bug: %s:%d: %s does not hold\n", __FILE__, __LINE__, \
                   #condition);                                                         \
      std::abort();                                                                     \
    }                                                                                   \
  } while (false)
