// SPDX-License-Identifier: Apache-2.0
// Of a run that goes on: how urgent one XNode's jobs are from the next one on, as people ask (`xauto prio`,
// App::set_priority), in place of what the policy says. On the board (board.h), where each worker looks before each job.
// No claim is made of such a run.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/json_value.h"
#include "processes/board.h"

namespace xauto::runtime {

inline constexpr std::int64_t kMaxAskedPriority = 1'000'000'000'000;

/// Asked: {"xnode": NAME, "priority": N}, or "key_us": N, or neither: as planned. The answer: {"was": {"xnode": NAME,
/// ...}} likewise. `board` is null before there is one. Errors: kNotFound: there is no such XNode; kInvalid: malformed,
/// out of range, or the policy has the other of the two; kUnavailable: nobody keeps an order of its jobs, or Linux does
/// by ranks which were set before the run. Threads: any, in any process that may write the board.
[[nodiscard]] Result<Json> change_urgency(const Json& asked, Board* board);

/// One XNode of a run, as `xauto prio` shows it.
struct ShownUrgency {
  std::string xnode, module;
  Ordered ordered = Ordered::kNobody;
  std::int64_t planned = 0;  ///< of keys of several activations the first one
  bool several = false;      ///< it has keys of several activations
  std::optional<std::int64_t> asked;
  std::uint32_t changes = 0;
};
[[nodiscard]] std::vector<ShownUrgency> urgencies(const Board& board);

}  // namespace xauto::runtime
