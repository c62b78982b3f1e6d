// SPDX-License-Identifier: Apache-2.0
// Asks libxauto_watch.so (watch/watch.h), which may not be in this process.
#pragma once

#include <cstddef>
#include <vector>

#include <dlfcn.h>

#include "kernel/watch/watch.h"

namespace xauto::kernel {

/// Its function of this name; null: it is not here.
template <class Function>
[[nodiscard]] Function* watch_function(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

/// All that `list` has seen. None: it is null.
template <class Seen>
[[nodiscard]] std::vector<Seen> all_watched(std::size_t (*list)(Seen*, std::size_t)) {
  std::vector<Seen> all;
  if (list == nullptr) return all;
  // More may come between two calls, or some may go.
  std::size_t n = list(nullptr, 0);
  while (n > all.size()) {
    all.resize(n);
    n = list(all.data(), all.size());
  }
  all.resize(n);
  return all;
}

}  // namespace xauto::kernel
