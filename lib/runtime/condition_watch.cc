// SPDX-License-Identifier: Apache-2.0
#include "runtime/condition_watch.h"

#include <algorithm>
#include <charconv>

#include <fcntl.h>
#include <unistd.h>

#include "base/unique_fd.h"

namespace xauto::runtime {
namespace {

constexpr std::size_t kMaxText = 256;

std::optional<std::string> read_text(const std::string& path) {
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!fd) return std::nullopt;
  char text[kMaxText];
  const ssize_t size = read(fd.get(), text, sizeof text);
  if (size < 0) return std::nullopt;
  return std::string(text, static_cast<std::size_t>(size));
}

/// Without white space around it.
std::string_view stripped(std::string_view text) {
  constexpr const char* kSpace = " \t\r\n";
  const std::size_t first = text.find_first_not_of(kSpace);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kSpace) - first + 1);
}

/// nullopt: what is there cannot be compared.
std::optional<bool> holds(const Condition& condition, std::string_view text) {
  if (condition.equals) return text == *condition.equals;
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return (!condition.at_least || value >= *condition.at_least) &&
         (!condition.at_most || value <= *condition.at_most);
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

ConditionWatch::ConditionWatch(const Tables& tables) : tables_(tables) {
  const bool any = std::any_of(tables.scenarios.begin(), tables.scenarios.end(),
                               [](const Scenario& s) { return !s.when.empty(); });
  if (!any) return;
  const auto look = [this] {
    const Machine machine = machine_in(tables_, read_text);
    scenario_.store(machine.scenario);
    outside_.store(machine.outside);
  };
  look();
  thread_ = std::make_unique<Watchdog>(kConditionsNs, [look](std::int64_t) { look(); });
}

Machine ConditionWatch::now() const {
  return {scenario_.load(), outside_.load()};
}

}  // namespace xauto::runtime
