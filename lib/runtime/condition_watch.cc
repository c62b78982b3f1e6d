// SPDX-License-Identifier: Apache-2.0
#include "runtime/condition_watch.h"

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <set>
#include <utility>

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/inotify.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/short_file.h"
#include "base/socket.h"

namespace xauto::runtime {
namespace {

/// nullopt: what is there cannot be compared.
std::optional<bool> holds(const Condition& condition, std::string_view text) {
  if (condition.equals) return text == *condition.equals;
  const auto value = whole_number(text);
  if (!value) return std::nullopt;
  return (!condition.at_least || *value >= *condition.at_least) &&
         (!condition.at_most || *value <= *condition.at_most);
}

}  // namespace

std::optional<bool> holds(const Scenario& scenario, const ReadText& read) {
  if (scenario.when.empty()) return std::nullopt;
  bool all = true;
  for (const Condition& condition : scenario.when) {
    const auto text = read(condition.file);
    const auto one = text ? holds(condition, stripped(*text)) : std::nullopt;
    if (!one) return std::nullopt;
    all = all && *one;
  }
  return all;
}

Machine machine_in(const Tables& tables, const ReadText& read) {
  int least = -1, greatest = -1;
  const auto worst = [&](int s) {
    return tables.serves[static_cast<std::size_t>(s)].worst_case_us;
  };
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    const auto here = holds(tables.scenarios[s], read);
    if (!here) continue;
    const int k = static_cast<int>(s);
    if (greatest < 0 || worst(k) > worst(greatest)) greatest = k;
    if (*here && (least < 0 || worst(k) < worst(least))) least = k;
  }
  return least >= 0 ? Machine{least, false} : Machine{greatest, greatest >= 0};
}

std::int64_t read_every_ns(std::int64_t period_ns) {
  return period_ns > 0 ? std::clamp(period_ns / 4 * 3, kReadOftenNs, kReadSeldomNs) : kReadSeldomNs;
}

// ---- what programs write ------------------------------------------------------------------------

/// Folders are watched: a file that is replaced is another one than before.
FileChanges::FileChanges(const std::vector<std::string>& paths)
    : inotify_(inotify_init1(IN_NONBLOCK | IN_CLOEXEC)) {
  if (!inotify_) return;
  for (const std::string& path : paths) {
    const std::size_t slash = path.rfind('/');
    const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
    const int watch = inotify_add_watch(
        inotify_.get(), folder.c_str(),
        IN_MODIFY | IN_CLOSE_WRITE | IN_MOVED_TO | IN_MOVED_FROM | IN_CREATE | IN_DELETE);
    if (watch >= 0) names_[watch].push_back(path.substr(slash + 1));
  }
}

bool FileChanges::take() {
  alignas(inotify_event) char buffer[4096];
  bool ours = false;
  for (ssize_t got = 0; (got = ::read(inotify_.get(), buffer, sizeof buffer)) > 0;)
    for (ssize_t at = 0; at < got;) {
      const auto* event = reinterpret_cast<const inotify_event*>(buffer + at);
      at += static_cast<ssize_t>(sizeof(inotify_event) + event->len);
      const auto names = names_.find(event->wd);
      // Without a name: events were lost, or the folder is gone.
      ours = ours || event->len == 0 ||
             (names != names_.end() &&
              std::count(names->second.begin(), names->second.end(), std::string(event->name)) > 0);
    }
  return ours;
}

// ---- the thread ---------------------------------------------------------------------------------

namespace {

std::vector<std::string> files_of(const Tables& tables) {
  std::set<std::string> files;
  for (const Scenario& scenario : tables.scenarios)
    for (const Condition& condition : scenario.when) files.insert(condition.file);
  return {files.begin(), files.end()};
}

std::uint64_t packed(const Machine& machine) {
  return static_cast<std::uint32_t>(machine.scenario) | std::uint64_t{machine.outside} << 32;
}

}  // namespace

ConditionWatch::ConditionWatch(const Tables& tables, const Timing& timing, Glance glance)
    : tables_(tables),
      timing_(timing),
      glance_(std::move(glance)),
      files_(files_of(tables)),
      warned_(files_.size()),
      machine_(packed({})),
      quit_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  read();
  thread_ = std::thread([this] { watch(now_ns()); });
}

ConditionWatch::~ConditionWatch() {
  signal_eventfd(quit_.get());
  thread_.join();
}

Machine ConditionWatch::now() const {
  const std::uint64_t machine = machine_.load();
  return {static_cast<int>(static_cast<std::uint32_t>(machine)), (machine >> 32) != 0};
}

/// Each file once, so that no two scenarios see two values of it.
void ConditionWatch::read() {
  std::map<std::string, std::optional<std::string>> texts;
  for (std::size_t f = 0; f < files_.size(); ++f) {
    const auto& text = texts[files_[f]] = read_short_file(files_[f]);
    if (text || std::exchange(warned_[f], char{1}) != 0) continue;
    log::warn(
        "{}: cannot be read, so scenarios with a condition on it (`when`) are not recognised by "
        "the machine; run with the rights to read it, or take it out of scenarios.json",
        files_[f]);
  }
  machine_.store(
      packed(machine_in(tables_, [&](const std::string& path) { return texts.at(path); })));
}

void ConditionWatch::watch(std::int64_t since_ns) {
  rt::set_thread_name("xauto/scenario");
  FileChanges changes(files_);
  // What was written between the first read and the watch.
  std::int64_t read_at = files_.empty() ? INT64_MAX : since_ns, glance_at = since_ns;
  std::int64_t hears_at = since_ns;
  for (bool wrong = false;;) {
    const std::int64_t now_at = now_ns();
    const bool hears = now_at >= hears_at;
    pollfd fds[] = {{quit_.get(), POLLIN, 0}, {hears ? changes.fd() : -1, POLLIN, 0}};
    const std::int64_t next_at = std::min({read_at, glance_at, hears ? INT64_MAX : hears_at});
    const std::int64_t wait_ns = std::max<std::int64_t>(0, next_at - now_at);
    const timespec wait = {wait_ns / 1'000'000'000, wait_ns % 1'000'000'000};
    const bool events = ppoll(fds, std::size(fds), &wait, nullptr) > 0;
    if (events && fds[0].revents != 0) return;
    const bool heard = events && fds[1].revents != 0;
    const bool written = heard && changes.take();
    if (heard) hears_at = now_ns() + kHeardApartNs;
    const auto read_now = [&] {
      read();
      read_at = now_ns() + timing_.read_ns;
    };
    if (written || now_ns() >= read_at) {
      read_now();
    } else if (now_ns() < glance_at) {
      continue;
    }
    // The first sign of it reads the files; the next one finds them read.
    const bool before = std::exchange(wrong, glance_(now()));
    if (wrong && !before && !files_.empty()) {
      read_now();
      (void)glance_(now());
    }
    glance_at = now_ns() + timing_.glance_ns;
  }
}

}  // namespace xauto::runtime
