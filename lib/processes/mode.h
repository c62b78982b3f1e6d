// SPDX-License-Identifier: Apache-2.0
// Of a run with tables: people's wish for a scenario, on the board (board.h), where whoever releases
// finds it. And the one place that answers requests from outside.
#pragma once

#include <string>
#include <string_view>

#include <xauto/result.h>

#include "processes/board.h"

namespace xauto::runtime {

/// From the next release on at least what this scenario covers counts; "": nobody asks any more. Errors:
/// kNotFound: there is no such scenario; kUnavailable: the run has no tables. Threads: any, in any
/// process that may write the board.
[[nodiscard]] Status ask_for_scenario(Board& board, std::string_view name);

/// Asked: {"mode": NAME}, or what change_urgency or change_parameters takes. The answer: {"was": {"mode": NAME}}, or
/// {"error": {...}}, or what those give. `board` is null before there is one. Threads: one.
[[nodiscard]] std::string answer_request(std::string_view request, Board* board);

}  // namespace xauto::runtime
