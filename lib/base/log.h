// SPDX-License-Identifier: Apache-2.0
// Logs for people, on stderr (spdlog). The job path never logs; it writes trace events.
//   error  not done as asked
//   warn   done differently
//   info   a change that a user cares about
//   debug  ours
// XAUTO_LOG=debug|info|warn|error|off sets the level (default: info).
// Nobody ever waits for who reads it (write_now.h): what is not taken at once is dropped, and counted in
// the next line that is.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

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

/// A progress line, as it is: to stderr, now or not at all. Whether all of it was taken.
bool show(std::string_view text);

/// What strangers make a process say: a line a second at most, with the count of those left out.
/// Threads: one.
class Refusals {
 public:
  /// `whose`: "gpu0", before each line.
  explicit Refusals(std::string whose) : whose_(std::move(whose)) {}
  Refusals(const Refusals&) = delete;
  Refusals& operator=(const Refusals&) = delete;
  /// Says what is left to be said.
  ~Refusals();
  void tell(std::string_view why, std::int64_t now_ns);

 private:
  const std::string whose_;
  std::optional<std::int64_t> told_ns_;
  std::uint64_t untold_ = 0;
};

}  // namespace xauto::log
