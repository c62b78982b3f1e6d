// SPDX-License-Identifier: Apache-2.0
// Files of /sys, /proc and the like that hold one value.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace xauto {

inline constexpr std::size_t kMaxShortFile = 256;

/// Without white space around it.
[[nodiscard]] std::string_view stripped(std::string_view text);

/// The first kMaxShortFile bytes of the file, stripped; nullopt: it cannot be read. Never waits for a
/// writer.
[[nodiscard]] std::optional<std::string> read_short_file(const std::string& path);

/// The whole number that the file holds, and nothing else; nullopt: it holds something else, or
/// cannot be read.
[[nodiscard]] std::optional<std::int64_t> read_number_file(const std::string& path);
/// The same of a text.
[[nodiscard]] std::optional<std::int64_t> whole_number(std::string_view stripped_text);

/// The process's resident memory, all pages counted now; nullopt: the kernel does not tell (before 4.14).
[[nodiscard]] std::optional<std::int64_t> resident_kb();

/// The files that fit a pattern of glob(7), which begins with a slash, below the folder `root`; "" is
/// the machine's own. `root` itself is no pattern.
[[nodiscard]] std::vector<std::string> files_below(const std::string& root,
                                                   const std::string& pattern);

}  // namespace xauto
