// SPDX-License-Identifier: Apache-2.0
// What a descriptor of this process leads to. Header only, without allocations, and with little
// stack: libxauto_watch.so asks inside of other libraries' calls, on their threads.
#pragma once

#include <charconv>
#include <cstring>
#include <string_view>

#include <unistd.h>

namespace xauto::kernel {

/// What the link in /proc reads, if it is shorter than `room`; else, or if it is closed, empty.
[[nodiscard]] inline std::string_view link_of(int fd, char* to, std::size_t room) {
  char path[32] = "/proc/self/fd/";
  *std::to_chars(path + std::strlen(path), path + sizeof path - 1, fd).ptr = 0;
  const ssize_t size = readlink(path, to, room);
  // A link that fills the buffer may be longer.
  return size > 0 && size < static_cast<ssize_t>(room)
             ? std::string_view(to, static_cast<std::size_t>(size))
             : std::string_view();
}

/// Whether the link in /proc reads `target`, a driver's file: shorter than 256 bytes. False: it is
/// closed, or another file's.
[[nodiscard]] inline bool leads_to(int fd, std::string_view target) {
  char link[256];
  return !target.empty() && target == link_of(fd, link, sizeof link);
}

}  // namespace xauto::kernel
