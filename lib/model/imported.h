// SPDX-License-Identifier: Apache-2.0
// What app.json holds beyond the app where `xauto import` made it: what a trace of the program showed as it ran
// without XAuto ("seen"), and what nobody knows yet ("todo"). No plan depends on either.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

/// Who calls the callbacks, as rclcpp names it.
enum class ExecutorKind : std::uint8_t {
  kSingleThreaded,
  kStaticSingleThreaded,
  kMultiThreaded,
  kEvents,
};
/// "single_threaded", "static_single_threaded", "multi_threaded", "events"
[[nodiscard]] const char* name_of(ExecutorKind kind);

struct SeenGroup {
  bool reentrant = false;  ///< else: one callback of it at a time
  std::vector<int>
      xnodes;  ///< indices into AppSpec::xnodes, in the order in which the executor looks at them
  bool operator==(const SeenGroup&) const = default;
};

struct SeenExecutor {
  std::string name;
  ExecutorKind kind = ExecutorKind::kSingleThreaded;
  int threads = 1;
  std::vector<SeenGroup> groups;
  bool operator==(const SeenExecutor&) const = default;
};

struct SeenXNode {
  std::vector<std::int64_t> times_us =
      {};  ///< of its activations, in their order; the first of them, if there were more
  std::int64_t delay_us = 0;  ///< median, from ready to begun where nothing else was in the way
  std::int64_t lead_us = 0;   ///< median, from its message to its end
  std::int64_t depth = 1;     ///< of its queue: of more messages the oldest is lost
  bool operator==(const SeenXNode&) const = default;
};

struct SeenChain {
  int chain = -1;                                          ///< index into AppSpec::chains
  std::int64_t count = 0;                                  ///< releases
  std::int64_t median_us = 0, p99_us = 0, longest_us = 0;  ///< reaction times
  bool operator==(const SeenChain&) const = default;
};

struct Seen {
  std::string from;              ///< of what, in words
  std::int64_t duration_us = 0;  ///< how long was looked
  int cores = 1;                 ///< on which callbacks ran
  std::vector<SeenExecutor> executors;
  std::vector<SeenXNode> xnodes;  ///< [xnode]
  std::vector<SeenChain> chains;
  bool operator==(const Seen&) const = default;
};

/// A question that the file could not answer.
struct Todo {
  std::string at;    ///< JSON pointer: where an answer goes; empty: no key says it
  std::string what;  ///< at most kMaxNameBytes
  bool operator==(const Todo&) const = default;
};

/// As Todo::what: cut where it is too long, and without what no name may have.
[[nodiscard]] std::string todo_text(const std::string& text);

struct ImportedApp {
  AppSpec app;
  std::vector<std::vector<std::string>> groups;  ///< app.json's "groups"
  Seen seen;                                     ///< nothing was where `from` is empty
  std::vector<Todo> todo;
  bool operator==(const ImportedApp&) const = default;
};

inline constexpr std::size_t kMaxTodo = 4096, kMaxSeenTimes = 1000, kMaxExecutors = 4096;
inline constexpr int kMaxSeenThreads = 1024;

/// The app of app.json with "seen", "todo" and "groups". Errors: parse_app(), and what does not fit the app.
[[nodiscard]] Result<ImportedApp> parse_imported(std::string_view text, std::string_view origin);
[[nodiscard]] Result<ImportedApp> load_imported(const std::string& path);
[[nodiscard]] std::string to_json(const ImportedApp& imported);

}  // namespace xauto
