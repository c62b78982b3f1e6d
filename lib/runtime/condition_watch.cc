// SPDX-License-Identifier: Apache-2.0
#include "runtime/condition_watch.h"

#include <algorithm>

#include "base/log.h"
#include "base/short_file.h"

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

std::optional<std::string> unreadable(const Tables& tables, const ReadText& read) {
  for (const Scenario& scenario : tables.scenarios)
    for (const Condition& condition : scenario.when)
      if (!read(condition.file)) return condition.file;
  return std::nullopt;
}

ConditionWatch::ConditionWatch(const Tables& tables) : tables_(tables) {
  const bool any = std::any_of(tables.scenarios.begin(), tables.scenarios.end(),
                               [](const Scenario& s) { return !s.when.empty(); });
  if (!any) return;
  if (const auto file = unreadable(tables, read_short_file))
    log::warn(
        "{}: cannot be read, so scenarios with a condition on it (`when`) are not recognised by "
        "the machine; run with the rights to read it, or take it out of scenarios.json",
        *file);
  const auto look = [this] {
    const Machine machine = machine_in(tables_, read_short_file);
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
