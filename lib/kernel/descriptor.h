// SPDX-License-Identifier: Apache-2.0
// What a descriptor of this process leads to. Header only and without allocations:
// libxauto_watch.so asks inside of other libraries' calls.
#pragma once

#include <charconv>
#include <climits>
#include <cstring>
#include <string_view>

#include <unistd.h>

namespace xauto::kernel {

/// Whether the link in /proc reads `target`. False: it is closed, or another file's.
[[nodiscard]] inline bool leads_to(int fd, std::string_view target) {
  char path[32] = "/proc/self/fd/", link[PATH_MAX];
  *std::to_chars(path + std::strlen(path), path + sizeof path - 1, fd).ptr = 0;
  const ssize_t size = readlink(path, link, sizeof link);
  return size > 0 && target == std::string_view(link, static_cast<std::size_t>(size));
}

}  // namespace xauto::kernel
