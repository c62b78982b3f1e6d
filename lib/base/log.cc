// SPDX-License-Identifier: Apache-2.0
#include "base/log.h"

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>

#include <spdlog/details/os.h>
#include <spdlog/sinks/ansicolor_sink.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "base/check.h"
#include "base/terminal.h"
#include "base/utf8.h"
#include "base/write_now.h"

namespace xauto::log {
namespace {

/// stderr, whoever reads it. Threads: any.
class Stderr {
 public:
  /// A line that is missed: if it is not taken, the next one that is says so.
  void tell(std::string_view line) {
    const std::lock_guard lock(mutex_);
    tell_dropped();
    if (dropped_ > 0 || !put(line)) ++dropped_;
  }
  bool show(std::string_view text) {
    const std::lock_guard lock(mutex_);
    return put(text);
  }
  void end() {
    const std::lock_guard lock(mutex_);
    tell_dropped();
  }

 private:
  void tell_dropped() {
    if (dropped_ > 0 && put(fmt::format("xauto: warning: {} line{} dropped here, since nobody read "
                                        "them\n",
                                        dropped_, dropped_ == 1 ? " was" : "s were")))
      dropped_ = 0;
  }
  bool put(std::string_view text) {
    std::string whole(torn_ ? 1 : 0, '\n');
    whole += text;
    const std::size_t taken = write_now(STDERR_FILENO, whole);
    if (taken > 0) torn_ = taken < whole.size() && whole[taken - 1] != '\n';
    return taken == whole.size();
  }

  std::mutex mutex_;
  std::uint64_t dropped_ = 0;
  bool torn_ = false;  ///< the last line has no end
};

/// Never destroyed: threads may log while the process ends.
Stderr& standard_error() {
  static Stderr* const instance = [] {
    static auto* const made = new Stderr;
    std::atexit([] { made->end(); });
    return made;
  }();
  return *instance;
}

/// What spdlog prints to: a whole message at a time, since its sink flushes after each.
FILE* stream() {
  const cookie_io_functions_t functions{nullptr,
                                        [](void*, const char* bytes, std::size_t size) {
                                          standard_error().tell({bytes, size});
                                          return static_cast<ssize_t>(size);
                                        },
                                        nullptr, nullptr};
  return fopencookie(nullptr, "w", functions);
}

spdlog::logger& logger() {
  static spdlog::logger* const instance = [] {
    const bool terminal = can_draw(STDERR_FILENO);
    using Sink = spdlog::sinks::ansicolor_sink<spdlog::details::console_mutex>;
    auto* made = new spdlog::logger(
        "xauto", std::make_shared<Sink>(
                     stream(), can_colour(STDERR_FILENO) && spdlog::details::os::is_color_terminal()
                                   ? spdlog::color_mode::always
                                   : spdlog::color_mode::never));
    // On a terminal there may be a progress line, of this process or of the one that started it:
    // what is logged takes its place, and it comes again below.
    made->set_pattern(terminal ? "\r\033[Kxauto: %^%l%$: %v" : "xauto: %^%l%$: %v");
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

bool show(std::string_view text) {
  return standard_error().show(text);
}

void Refusals::tell(std::string_view why, std::int64_t now_ns) {
  constexpr std::int64_t kEveryNs = 1'000'000'000;
  if (told_ns_ && now_ns - *told_ns_ < kEveryNs) {
    ++untold_;
    return;
  }
  told_ns_ = now_ns;
  const std::uint64_t before = std::exchange(untold_, 0);
  warn("{}: {}{}", whose_, why,
       before == 0 ? "" : fmt::format("; {} more since the last line", before));
}

Refusals::~Refusals() {
  if (untold_ > 0) warn("{}: {} more refused since the last line", whose_, untold_);
}

}  // namespace xauto::log

namespace xauto {

void die_of_bug(const char* file, int line, const char* condition) {
  (void)log::show(fmt::format("xauto: bug: {}:{}: {} does not hold\n", file, line, condition));
  std::abort();
}

}  // namespace xauto
