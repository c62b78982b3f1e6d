// SPDX-License-Identifier: Apache-2.0
#include "base/columns.h"

#include <algorithm>

#include <fmt/format.h>

#include "base/utf8.h"

namespace xauto {
namespace {

constexpr std::string_view kArrow = " -> ", kEllipsis = "…";

/// Bytes of the first `columns` characters.
std::size_t bytes_of(std::string_view text, std::size_t columns) {
  std::size_t bytes = 0;
  for (; columns > 0 && bytes < text.size(); --columns)
    bytes += std::max<std::size_t>(1, utf8_length(text.substr(bytes)));
  return bytes;
}

}  // namespace

std::size_t columns_of(std::string_view text) {
  std::size_t columns = 0;
  for (; !text.empty(); ++columns) text.remove_prefix(bytes_of(text, 1));
  return columns;
}

std::string cut(std::string_view text, std::size_t columns) {
  if (columns_of(text) <= columns) return std::string(text);
  const std::size_t arrow = text.find(kArrow);
  if (arrow != std::string_view::npos && columns >= kArrow.size() + 6) {
    const std::string_view from = text.substr(0, arrow), to = text.substr(arrow + kArrow.size());
    const std::size_t room = columns - kArrow.size(), of_to = columns_of(to);
    const std::size_t first = std::max(room / 2, room - std::min(room, of_to));
    std::string both = cut(from, first);
    const std::size_t rest = room - columns_of(both);
    return (both += kArrow) += cut(to, rest);
  }
  if (columns == 0) return {};
  return std::string(text.substr(0, bytes_of(text, columns - 1))) += kEllipsis;
}

std::string left(std::string_view text, std::size_t columns) {
  std::string out = cut(text, columns - 1);
  return out += std::string(columns - columns_of(out), ' ');
}

std::string row_of(std::string_view name, std::size_t columns) {
  constexpr std::string_view kBlanks = "  ";
  if (columns_of(name) < columns) return std::string(kBlanks) += left(name, columns);
  std::string out(kBlanks);
  out += cut(name, kLineColumns - kBlanks.size());
  return (out += '\n') += std::string(kBlanks.size() + columns, ' ');
}

std::string ms_in_row(std::int64_t us) {
  if (us < 0) return "-";
  return fmt::format("{:.{}f}", static_cast<double>(us) / 1000,
                     us < 999'995     ? 2
                     : us < 9'999'950 ? 1
                                      : 0);
}

std::string wrapped(std::string_view text, std::size_t indent) {
  std::string out;
  std::size_t column = 0;
  bool begins = true;  // nothing but blanks is in the line
  while (!text.empty()) {
    if (text.front() == '\n') {
      out += '\n';
      column = 0;
      begins = true;
      text.remove_prefix(1);
      continue;
    }
    const std::size_t blanks = std::min(text.find_first_not_of(' '), text.size());
    const std::size_t end = std::min(text.find_first_of(" \n", blanks), text.size());
    const std::string_view word = text.substr(blanks, end - blanks);
    const std::size_t width = columns_of(word);
    if (!begins && width > 0 && column + blanks + width > kLineColumns) {
      out += '\n' + std::string(indent, ' ');
      column = indent;
    } else {
      out += text.substr(0, blanks);
      column += blanks;
    }
    out += word;
    column += width;
    begins = begins && width == 0;
    text.remove_prefix(end);
  }
  return out;
}

}  // namespace xauto
