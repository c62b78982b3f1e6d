// SPDX-License-Identifier: Apache-2.0
// The account of a run by its board: of one that goes on whatever is known so far, and at its end what the board knows.
#pragma once

#include "processes/board.h"
#include "session/account.h"

namespace xauto::runtime {

/// A chain, or the app as a whole (flow 0), as the board has it: latencies are at most 1/64 too large.
[[nodiscard]] ChainAccount chain_of(const FlowLine& line);

/// Adds every kind of assumption that is watched, and what was not kept of it. Where `account` has words of a kind
/// already, who knows more has spoken.
void add_assumptions(const Board& board, Account& account);

/// Of a run that goes on, whoever looks. The app may write there what it likes.
[[nodiscard]] Account account_of(const Board& board);

}  // namespace xauto::runtime
