// SPDX-License-Identifier: Apache-2.0
#include "base/log.h"

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "base/utf8.h"

namespace xauto::log {
namespace {

spdlog::logger& logger() {
  // Never destroyed: threads may log while the process ends.
  static spdlog::logger* const instance = [] {
    auto* made =
        new spdlog::logger("xauto", std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
    // Whole lines, so that those of several processes do not mix.
    if (isatty(STDERR_FILENO) == 1) setvbuf(stderr, nullptr, _IOLBF, BUFSIZ);
    // On a terminal there may be a progress line, of this process or of the one that started it:
    // what is logged takes its place, and it comes again below.
    made->set_pattern(isatty(STDERR_FILENO) == 1 ? "\r\033[Kxauto: %^%l%$: %v"
                                                 : "xauto: %^%l%$: %v");
    const char* level = std::getenv("XAUTO_LOG");
    made->set_level(level == nullptr ? spdlog::level::info : spdlog::level::from_str(level));
    return made;
  }();
  return *instance;
}

}  // namespace

void write(Level level, std::string_view text) {
  static constexpr spdlog::level::level_enum kLevels[] = {spdlog::level::debug, spdlog::level::info,
                                                          spdlog::level::warn, spdlog::level::err};
  // What an app throws, a file is called or a driver says is in it.
  logger().log(kLevels[static_cast<int>(level)], "{}", for_terminal(text));
}

}  // namespace xauto::log
