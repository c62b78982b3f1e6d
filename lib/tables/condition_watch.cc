// SPDX-License-Identifier: Apache-2.0
#include "tables/condition_watch.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/inotify.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/short_file.h"
#include "base/socket.h"
#include "base/thread.h"
#include "base/utf8.h"

namespace xauto::runtime {
namespace {

/// By how much of its limit the file passes it; 0: it holds. nullopt: what is there cannot be compared.
std::optional<double> passed_by(const Condition& condition, std::string_view text) {
  if (condition.equals) return text == *condition.equals ? 0 : 1;
  const auto number = whole_number(text);
  if (!number) return std::nullopt;
  const auto value = static_cast<double>(*number);
  const auto part = [&](double limit, double short_by) {
    return std::max(0.0, short_by) / std::max(1.0, std::abs(limit));
  };
  double passed = 0;
  if (condition.at_least) {
    const auto limit = static_cast<double>(*condition.at_least);
    passed += part(limit, limit - value);
  }
  if (condition.at_most) {
    const auto limit = static_cast<double>(*condition.at_most);
    passed += part(limit, value - limit);
  }
  return passed;
}

/// Nothing that passes `other` keeps this one.
bool no_weaker(const Condition& other, const Condition& condition, bool below) {
  if (other.file != condition.file) return false;
  if (condition.equals) return other.equals == condition.equals;
  return below ? other.at_least && *other.at_least >= *condition.at_least
               : other.at_most && *other.at_most <= *condition.at_most;
}

/// What one condition of `scenario` misses, in words.
std::string words_of(const Condition& condition, std::string_view text, const Tables& tables,
                     int scenario) {
  const auto number = condition.equals ? std::nullopt : whole_number(text);
  const bool below = number && condition.at_least && *number < *condition.at_least;
  const bool every =
      std::all_of(tables.scenarios.begin(), tables.scenarios.end(), [&](const Scenario& other) {
        return std::any_of(other.when.begin(), other.when.end(),
                           [&](const Condition& one) { return no_weaker(one, condition, below); });
      });
  const std::string who =
      every ? "every scenario"
            : "'" + tables.scenarios[static_cast<std::size_t>(scenario)].name + "'";
  if (condition.equals)
    return fmt::format("{} is '{}', {} needs '{}'", condition.file, valid_utf8(text), who,
                       *condition.equals);
  return fmt::format("{} is {}, {} needs at {} {}", condition.file, text, who,
                     below ? "least" : "most", below ? *condition.at_least : *condition.at_most);
}

}  // namespace

std::optional<double> passed_by(const Scenario& scenario, const ReadText& read) {
  if (scenario.when.empty()) return std::nullopt;
  double all = 0;
  for (const Condition& condition : scenario.when) {
    const auto text = read(condition.file);
    const auto one = text ? passed_by(condition, stripped(*text)) : std::nullopt;
    if (!one) return std::nullopt;
    all += *one;
  }
  return all;
}

MachineState machine_in(const Tables& tables, const ScenarioOrder& order, const ReadText& read) {
  std::vector<std::optional<double>> passed;  // [scenario]
  for (const Scenario& scenario : tables.scenarios) passed.push_back(passed_by(scenario, read));
  const auto holds = [&](std::size_t s) { return passed[s] && *passed[s] == 0; };
  // Where a slower clock is enough, a faster one is, too: what is there is the least in WCETs of all that
  // hold, whatever is lost there.
  const int here = order.least([&](std::size_t s) {
    if (!holds(s)) return false;
    for (std::size_t other = 0; other < order.size(); ++other)
      if (holds(other) && order.above(s, other)) return false;
    return true;
  });
  if (here >= 0) return {here, {}};
  MachineState machine;
  machine.scenario = order.most([&](std::size_t s) { return passed[s].has_value(); },
                                [&](std::size_t s) { return *passed[s]; });
  if (machine.scenario < 0) return machine;
  for (const Condition& condition :
       tables.scenarios[static_cast<std::size_t>(machine.scenario)].when) {
    const auto text = read(condition.file);
    if (const auto one = passed_by(condition, stripped(*text)); *one > 0)
      machine.outside.push_back(
          {condition.file, words_of(condition, stripped(*text), tables, machine.scenario)});
  }
  return machine;
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
  thread_.check();
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

}  // namespace

ConditionWatch::ConditionWatch(const Tables& tables, const ScenarioOrder& order,
                               const Timing& timing, Glance glance)
    : tables_(tables),
      order_(order),
      timing_(timing),
      glance_(std::move(glance)),
      files_(files_of(tables)),
      warned_(files_.size()),
      quit_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

Result<std::unique_ptr<ConditionWatch>> ConditionWatch::start(const Tables& tables,
                                                              const ScenarioOrder& order,
                                                              const Timing& timing, Glance glance) {
  std::unique_ptr<ConditionWatch> watch(
      new ConditionWatch(tables, order, timing, std::move(glance)));
  watch->read();
  XAUTO_ASSIGN(watch->thread_, start_thread([w = watch.get()] { w->watch(now_ns()); }));
  return watch;
}

ConditionWatch::~ConditionWatch() {
  if (!thread_.joinable()) return;
  signal_eventfd(quit_.get());
  thread_.join();
}

MachineState ConditionWatch::now() const {
  const Guard lock(mutex_);
  return machine_;
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
  MachineState machine =
      machine_in(tables_, order_, [&](const std::string& path) { return texts.at(path); });
  const Guard lock(mutex_);
  std::swap(machine_, machine);
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
