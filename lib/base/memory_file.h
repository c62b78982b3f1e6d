// SPDX-License-Identifier: Apache-2.0
// Anonymous files (memfd) by which a parent and a child exchange a text: nothing is left behind.
#pragma once

#include <string>
#include <string_view>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto {

inline constexpr std::size_t kMaxMemoryFileBytes = 1u << 30;

/// memfd_create(2), for its owner alone: the kernel makes them writable by everybody who comes by a
/// path to them. -1 and errno where it fails.
[[nodiscard]] UniqueFd private_memfd(const char* name, unsigned flags);
[[nodiscard]] Result<UniqueFd> make_memory_file(const char* name);
/// Replaces the content.
[[nodiscard]] Status write_memory_file(int fd, std::string_view text);
[[nodiscard]] Result<std::string> read_memory_file(int fd);

}  // namespace xauto
