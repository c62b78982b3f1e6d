// SPDX-License-Identifier: Apache-2.0
// Anonymous files (memfd) by which a parent and a child exchange a text: nothing is left behind.
#pragma once

#include <cstddef>
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
/// From now on of this size for ever: one that shrinks kills those who have mapped it with SIGBUS.
[[nodiscard]] Status seal_memory(int fd, std::size_t bytes);
/// A new one, of zeros.
[[nodiscard]] Result<UniqueFd> sealed_memory(const char* name, std::size_t bytes);
/// A second descriptor of a memory file, by which it cannot be written. Needs /proc.
[[nodiscard]] Result<UniqueFd> read_only(int fd);
/// Replaces the content.
[[nodiscard]] Status write_memory_file(int fd, std::string_view text);
[[nodiscard]] Result<std::string> read_memory_file(int fd);

}  // namespace xauto
