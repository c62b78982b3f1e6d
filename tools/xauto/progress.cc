// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/terminal.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

constexpr std::int64_t kAppearAfterMs = 2000;
constexpr std::int64_t kTerminalEveryMs = 100, kPlainEveryMs = 5000;
constexpr int kBarWidth = 30;

std::int64_t now_ms() {
  return now_ns() / 1'000'000;
}

}  // namespace

bool SearchLine::due(double elapsed_s) const {
  return terminal_ ? elapsed_s >= 0.3 : elapsed_s >= next_s_;
}

void SearchLine::show(double elapsed_s, const std::string& text) {
  next_s_ = elapsed_s + 2;
  (void)log::show(fmt::format("{}{:6.1f} s   {}{}", terminal_ ? "\r\033[K" : "", elapsed_s, text,
                              terminal_ ? "" : "\n"));
  drawn_ = terminal_;
}

void SearchLine::end() {
  if (drawn_) (void)log::show("\r\033[K");
}

Progress::Progress(std::string label, double total)
    : label_(std::move(label)),
      total_(total),
      started_ms_(now_ms()),
      terminal_(can_draw(STDERR_FILENO)) {}

Progress::~Progress() {
  finish();
}

void Progress::update(double done, const std::string& note) {
  done_ = done;
  note_ = note;
  const std::int64_t now = now_ms();
  if (finished_ || now - started_ms_ < kAppearAfterMs) return;
  if (shown_ && now - drawn_ms_ < (terminal_ ? kTerminalEveryMs : kPlainEveryMs)) return;
  drawn_ms_ = now;
  shown_ = true;
  draw(false);
}

void Progress::finish() {
  if (finished_) return;
  finished_ = true;
  if (shown_) draw(true);
}

void Progress::draw(bool last) {
  std::string line = label_;
  if (total_ > 0 && done_ >= 0) {
    const double part = std::clamp(done_ / total_, 0.0, 1.0);
    const int filled = static_cast<int>(part * kBarWidth);
    line +=
        fmt::format(" [{:#<{}}{:.<{}}] {:3.0f} %", "", filled, "", kBarWidth - filled, 100 * part);
  }
  if (!note_.empty()) line += "  " + note_;
  // One line, so that one "erase" is enough for it; the cursor at its begin, so that what others
  // print begins there.
  if (winsize size{}; terminal_ && ioctl(2, TIOCGWINSZ, &size) == 0 && size.ws_col > 0)
    line = line.substr(0, size.ws_col - 1u);
  if (terminal_)
    (void)log::show("\r\033[K" + line + (last ? "\n" : "\r"));
  else if (!last)
    (void)log::show(line + "\n");
}

}  // namespace xauto::cli
