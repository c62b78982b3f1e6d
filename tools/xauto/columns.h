// SPDX-License-Identifier: Apache-2.0
// Text in columns: no line of a table has more than a terminal of the usual width. Whole names are in --json.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace xauto::cli {

constexpr std::size_t kLineColumns = 80;

/// Of UTF-8; a character is a column.
[[nodiscard]] std::size_t columns_of(std::string_view text);

/// What has more columns ends with "…". Of "lidar -> planner" both ends stay to be told from others.
[[nodiscard]] std::string cut(std::string_view text, std::size_t columns);

/// In just so many columns, the last of them a blank: cut, or filled up.
[[nodiscard]] std::string left(std::string_view text, std::size_t columns);

/// Lines of at most `kLineColumns` where words allow it. The text's first line keeps its blanks; the others begin with
/// `indent` blanks.
[[nodiscard]] std::string wrapped(std::string_view text, std::size_t indent);

}  // namespace xauto::cli
