// SPDX-License-Identifier: Apache-2.0
// What the machine says of its clocks and modes: the files that scenarios name (Scenario::when). Read on
// a thread of its own, which no release waits for: a clock changes in milliseconds, and a file in
// /sys or /proc tells nobody that it has changed.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "model/tables.h"
#include "runtime/watch.h"

namespace xauto::runtime {

inline constexpr std::int64_t kConditionsNs = 50'000'000;  ///< between two looks

/// Whether the scenario's conditions hold; nullopt: it has none, or a file cannot be read. `read`: a
/// file's text; nullopt: it cannot be read.
using ReadText = std::function<std::optional<std::string>(const std::string& path)>;
[[nodiscard]] std::optional<bool> holds(const Scenario& scenario, const ReadText& read);

/// Which scenario the machine is in.
struct Machine {
  int scenario = -1;  ///< -1: it says nothing
  bool outside =
      false;  ///< scenarios have conditions, and none holds: `scenario` is the last resort
};
/// Of the scenarios whose conditions hold, the one with the least worst case. If none holds, of those
/// that have conditions the one with the greatest: the machine is slower than where it was measured.
[[nodiscard]] Machine machine_in(const Tables& tables, const ReadText& read);

/// The first file of a condition that cannot be read: its scenario counts as one without conditions.
[[nodiscard]] std::optional<std::string> unreadable(const Tables& tables, const ReadText& read);

/// Threads: any.
class ConditionWatch {
 public:
  /// `tables` outlive it. Without conditions nothing is read, and there is no thread. Warns of a file
  /// that cannot be read: a profile of root's may name some that others cannot.
  explicit ConditionWatch(const Tables& tables);
  [[nodiscard]] Machine now() const;

 private:
  const Tables& tables_;
  std::atomic<int> scenario_{-1};
  std::atomic<bool> outside_{false};
  std::unique_ptr<Watchdog> thread_;  ///< last: it uses the others
};

}  // namespace xauto::runtime
