// SPDX-License-Identifier: Apache-2.0
#include "base/short_file.h"

#include <charconv>

#include <fcntl.h>
#include <glob.h>
#include <unistd.h>

#include "base/unique_fd.h"

namespace xauto {

std::string_view stripped(std::string_view text) {
  constexpr const char* kSpace = " \t\r\n";
  const std::size_t first = text.find_first_not_of(kSpace);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kSpace) - first + 1);
}

std::optional<std::string> read_short_file(const std::string& path) {
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!fd) return std::nullopt;
  char text[kMaxShortFile];
  const ssize_t size = read(fd.get(), text, sizeof text);
  if (size < 0) return std::nullopt;
  return std::string(stripped({text, static_cast<std::size_t>(size)}));
}

std::optional<std::int64_t> whole_number(std::string_view stripped_text) {
  std::int64_t value = 0;
  const char* end = stripped_text.data() + stripped_text.size();
  const auto [stop, error] = std::from_chars(stripped_text.data(), end, value);
  if (error != std::errc() || stop != end) return std::nullopt;
  return value;
}

std::optional<std::int64_t> read_number_file(const std::string& path) {
  const auto text = read_short_file(path);
  return text ? whole_number(*text) : std::nullopt;
}

std::vector<std::string> files_below(const std::string& root, const std::string& pattern) {
  std::string escaped;
  for (const char c : root) {
    if (std::string_view("*?[]\\").find(c) != std::string_view::npos) escaped += '\\';
    escaped += c;
  }
  std::vector<std::string> paths;
  glob_t found{};
  if (glob((escaped + pattern).c_str(), 0, nullptr, &found) == 0)
    paths.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
  globfree(&found);
  return paths;
}

std::optional<std::int64_t> resident_kb() {
  // statm may be off by what each CPU has not added up yet.
  const auto text = read_short_file("/proc/self/smaps_rollup");
  constexpr std::string_view kKey = "Rss:";
  const std::size_t at = text ? text->find(kKey) : std::string::npos;
  if (at == std::string::npos) return {};
  const std::string_view rest = std::string_view(*text).substr(at + kKey.size());
  const std::size_t end = rest.find(" kB");
  if (end == std::string_view::npos) return {};
  return whole_number(stripped(rest.substr(0, end)));
}

}  // namespace xauto
