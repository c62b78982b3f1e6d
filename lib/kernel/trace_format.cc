// SPDX-License-Identifier: Apache-2.0
#include "kernel/trace_format.h"

#include <algorithm>
#include <charconv>
#include <fstream>
#include <optional>
#include <string_view>

#include <sys/mount.h>
#include <sys/stat.h>

namespace xauto::kernel {
namespace {

constexpr std::uint32_t kOfBpf = 8;          ///< in place of what all records begin with
constexpr std::uint32_t kLongest = 8192;     ///< the kernel's PERF_MAX_TRACE_SIZE
constexpr std::size_t kLongestText = 65536;  ///< a page is usual

/// "offset:" in "field:pid_t prev_pid;\toffset:24;\tsize:4;\tsigned:1;" -> 24
std::optional<std::uint32_t> number_after(std::string_view line, std::string_view word) {
  const std::size_t at = line.find(word);
  if (at == std::string_view::npos) return std::nullopt;
  const std::string_view rest = line.substr(at + word.size());
  std::uint32_t number = 0;
  const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), number);
  if (error != std::errc() || end == rest.data() + rest.size() || *end != ';') return std::nullopt;
  return number;
}

/// "char next_comm[16]" -> "next_comm"
std::string_view name_of(std::string_view declared) {
  declared = declared.substr(0, declared.find('['));
  const std::size_t space = declared.find_last_of(" *");
  return space == std::string_view::npos ? declared : declared.substr(space + 1);
}

}  // namespace

Result<TraceField> trace_field(const std::string& format, const std::string& name) {
  constexpr std::string_view kField = "field:";
  for (std::string_view text = format; !text.empty();) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(line.size() + 1, text.size()));
    const std::size_t begin = line.find(kField), end = line.find(';');
    if (begin == std::string_view::npos || end == std::string_view::npos ||
        end < begin + kField.size() ||
        name_of(line.substr(begin + kField.size(), end - begin - kField.size())) != name)
      continue;
    const auto at = number_after(line.substr(end), "offset:");
    const auto size = number_after(line.substr(end), "size:");
    if (!at || !size || *at < kOfBpf || *size == 0 || *at >= kLongest || *size > kLongest - *at)
      return fail(ErrorCode::kInvalid, "a field that is in no record", name);
    return TraceField{*at, *size};
  }
  return fail(ErrorCode::kInvalid, "no such field", name);
}

Result<std::string> trace_format(const std::string& event, const std::string& root) {
  const std::string tracefs = root + "/sys/kernel/tracing";
  struct stat there {};
  // Where CONFIG_TRACING is, the folder is there, and empty until somebody mounts it.
  if (root.empty() && stat((tracefs + "/events").c_str(), &there) != 0)
    (void)mount("tracefs", tracefs.c_str(), "tracefs", 0, nullptr);
  const std::string path = tracefs + "/events/" + event + "/format";
  std::ifstream file(path);
  std::string text(kLongestText, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(file.gcount()));
  if (text.empty())
    return fail(ErrorCode::kUnavailable, path + " cannot be read", {},
                "root may, on a kernel with CONFIG_FTRACE");
  return text;
}

}  // namespace xauto::kernel
