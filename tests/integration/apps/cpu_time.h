// SPDX-License-Identifier: Apache-2.0
// CPU time of the calling thread, for apps whose jobs burn it.
#pragma once

#include <cstdint>
#include <ctime>

inline std::int64_t cpu_ns() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return t.tv_sec * 1'000'000'000 + t.tv_nsec;
}
