// SPDX-License-Identifier: Apache-2.0
// Logs for people, on stderr (spdlog). The job path never logs; it writes trace events.
//   error  not done as asked
//   warn   done differently
//   info   a change that a user cares about
//   debug  ours
// XAUTO_LOG=debug|info|warn|error|off sets the level (default: info).
#pragma once

#include <cstdint>
#include <string_view>

#include <fmt/format.h>

namespace xauto::log {

enum class Level { kDebug, kInfo, kWarn, kError };
void write(Level level, std::string_view text);

#if FMT_VERSION >= 80000
using fmt::format_string;
#else  // not looked at by the compiler yet
template <class...>
using format_string = fmt::string_view;
#endif

template <class... Args>
void debug(format_string<Args...> format, Args&&... args) {
  write(Level::kDebug, fmt::format(format, std::forward<Args>(args)...));
}
template <class... Args>
void info(format_string<Args...> format, Args&&... args) {
  write(Level::kInfo, fmt::format(format, std::forward<Args>(args)...));
}
template <class... Args>
void warn(format_string<Args...> format, Args&&... args) {
  write(Level::kWarn, fmt::format(format, std::forward<Args>(args)...));
}
template <class... Args>
void error(format_string<Args...> format, Args&&... args) {
  write(Level::kError, fmt::format(format, std::forward<Args>(args)...));
}
/// What to do about the error just reported.
template <class... Args>
void hint(format_string<Args...> format, Args&&... args) {
  write(Level::kError, "  hint: " + fmt::format(format, std::forward<Args>(args)...));
}

}  // namespace xauto::log
