// SPDX-License-Identifier: Apache-2.0
// How many cases a test of many tries.
#pragma once

#include <cstdlib>

namespace xauto::test {

/// The first `few` in `make check`, `all` in `make check-full` (XAUTO_FULL=1).
inline int cases(int few, int all) {
  return std::getenv("XAUTO_FULL") != nullptr ? all : few;
}

}  // namespace xauto::test
