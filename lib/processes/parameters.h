// SPDX-License-Identifier: Apache-2.0
// Parameters on the board (board.h): where every process of the app reads them, and the tool that
// runs it changes them.
//
// The values of a module are there twice. Its version says which of the two counts:
//
//   reader   version v ► values[v % 2] ► version is still v: they belong together
//   writer   values[(v + 1) % 2] ► version v + 1
//
// So a reader waits for nobody. A writer that is interrupted disturbs no reader: they read the other
// one. A reader that meets two changes tries again, at most kTries times, and then keeps what it has
// until the next activation.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "graph/graph.h"
#include "model/deployment.h"
#include "model/json_value.h"
#include "model/parameter.h"
#include "processes/board.h"

namespace xauto::runtime {

/// What the parameters of each module are worth at first, in the order of their declaration.
/// Errors: a parameter that nobody declares, a value that it cannot have.
[[nodiscard]] Result<std::vector<std::vector<ParameterValue>>> first_values(
    const Graph& graph, const Deployment& deployment);

/// Before the run, by the process that leads: declarations, and the values of the deployment.
/// Errors: a parameter that nobody declares, a value that it cannot have.
[[nodiscard]] Status post_parameters(Board& board, const Graph& graph,
                                     const Deployment& deployment);

/// What one module reads. Threads: one at a time.
class ParameterReader {
 public:
  ParameterReader() = default;  ///< of a module without parameters
  ParameterReader(const Board& board, const Graph& graph, int module);
  /// Takes what has changed. Never waits, never allocates.
  void look();
  [[nodiscard]] const std::vector<detail::ParameterNow>& now() const { return now_; }
  /// Grows when they change; 0: never looked.
  [[nodiscard]] std::uint64_t version() const { return version_; }

 private:
  static constexpr int kTries = 4;
  [[nodiscard]] bool copy(std::uint64_t version);
  const std::atomic<std::uint64_t>* said_ = nullptr;  ///< null: there are none
  const ParameterLine* lines_ = nullptr;
  std::vector<detail::ParameterNow> now_;
  std::vector<std::uint64_t> room_;  ///< what was read and may be thrown away
  std::uint64_t version_ = 0;
};

/// One as `xauto param list` shows it. All of it is the app's word.
struct PostedParameter {
  std::string module;
  detail::ParameterSpec spec;
  ParameterValue value;
  std::uint64_t changes = 0;  ///< by `change_parameters`
};
/// kUnavailable: the app has not started yet.
[[nodiscard]] Result<std::vector<PostedParameter>> posted_parameters(const Board& board);

/// Asked: {"module": M, "set": {NAME: "text", ...}}. All of them change, in one activation of the
/// module, or none. The answer: {"was": {NAME: "text", ...}} or {"error": {...}} (answer_error).
/// `board` is null before there is one. Threads: one.
[[nodiscard]] std::string change_parameters(std::string_view request, Board* board);
inline constexpr std::size_t kMaxParameterRequest = 16 * 1024, kMaxParameterAnswer = 64 * 1024;
inline constexpr std::size_t kMaxSetAtOnce = 32;
/// What was done, or {"error": {...}}.
[[nodiscard]] std::string to_answer(const Result<Json>& done);
/// The error that an answer carries, if it does.
[[nodiscard]] Status answer_error(std::string_view answer);

/// For the report: which ones were changed while the run went on; "": none.
[[nodiscard]] std::string changed_parameters(const Board& board);

}  // namespace xauto::runtime
