// SPDX-License-Identifier: Apache-2.0
// Text in columns: no line of a table has more than a terminal of the usual width. Whole names are in --json.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace xauto {

constexpr std::size_t kLineColumns = 80;
constexpr std::size_t kNameColumns = 27;  ///< "camera/front -> pr.predict", and a blank

/// Of UTF-8; a character is a column.
[[nodiscard]] std::size_t columns_of(std::string_view text);

/// What has more columns ends with "…". Of "lidar -> planner" both ends stay to be told from others.
[[nodiscard]] std::string cut(std::string_view text, std::size_t columns);

/// In just so many columns, the last of them a blank: cut, or filled up.
[[nodiscard]] std::string left(std::string_view text, std::size_t columns);

/// The name that begins a row, behind two blanks, in just so many columns. One that has no room there stands on a line of
/// its own.
[[nodiscard]] std::string row_of(std::string_view name, std::size_t columns);

/// "12.34", in six columns at most below a quarter of an hour; "-": below 0, nobody measured it.
[[nodiscard]] std::string ms_in_row(std::int64_t us);

/// Lines of at most `kLineColumns` where words allow it. The text's first line keeps its blanks; the others begin with
/// `indent` blanks.
[[nodiscard]] std::string wrapped(std::string_view text, std::size_t indent);

}  // namespace xauto
