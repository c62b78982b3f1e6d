// SPDX-License-Identifier: Apache-2.0
// What a descriptor of this process leads to. Header only, without allocations, and with little
// stack: libxauto_watch.so asks inside of other libraries' calls, on their threads.
#pragma once

#include <charconv>
#include <cstring>
#include <string_view>

#include <unistd.h>

namespace xauto::kernel {

/// Whether the link in /proc reads `target`, a driver's file: shorter than 256 bytes. False: it is
/// closed, or another file's.
[[nodiscard]] inline bool leads_to(int fd, std::string_view target) {
  char path[32] = "/proc/self/fd/", link[256];
  *std::to_chars(path + std::strlen(path), path + sizeof path - 1, fd).ptr = 0;
  const ssize_t size = readlink(path, link, sizeof link);
  // A link that fills the buffer may be longer.
  return size > 0 && size < static_cast<ssize_t>(sizeof link) &&
         target == std::string_view(link, static_cast<std::size_t>(size));
}

}  // namespace xauto::kernel
