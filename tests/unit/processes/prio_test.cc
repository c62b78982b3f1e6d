// SPDX-License-Identifier: Apache-2.0
#include "processes/prio.h"

#include <gtest/gtest.h>

#include "processes/board_account.h"
#include "processes/mode.h"
#include "processes/parameters.h"

namespace xauto::runtime {
namespace {

/// "free" is not scheduled, "prio" has a priority, "key" a key, "rank" a SCHED_FIFO priority on a core.
class Prio : public ::testing::Test {
 protected:
  Prio() {
    const char* const names[] = {"free", "prio", "key", "rank"};
    for (std::size_t n = 0; n < 4; ++n) {
      name_line(board->xnode(n).name, names[n]);
      board->xnode(n).ordered.store(static_cast<std::uint32_t>(n));
    }
    board->xnode(1).planned.store(7);
  }
  std::string ask(const std::string& request) {
    const std::string answer = answer_request(request, board.get());
    const Status status = answer_error(answer);
    return status ? answer : status.error().what;
  }
  std::shared_ptr<Board> board = Board::local({.processes = 1, .modules = 1, .nodes = 4});
};

TEST_F(Prio, IsAskedForInThePolicysOwnUnitAndTakenBack) {
  EXPECT_EQ(ask(R"({"xnode": "prio", "priority": -3})"), R"({"was":{"xnode":"prio"}})");
  EXPECT_EQ(board->xnode(1).asked.load(), -3);
  EXPECT_EQ(ask(R"({"xnode": "prio", "priority": 4})"),
            R"({"was":{"xnode":"prio","priority":-3}})");
  EXPECT_EQ(ask(R"({"xnode": "prio"})"), R"({"was":{"xnode":"prio","priority":4}})");
  EXPECT_EQ(board->xnode(1).asked.load(), XNodeLine::kAsPlanned);
  EXPECT_EQ(ask(R"({"xnode": "key", "key_us": 12000})"), R"({"was":{"xnode":"key"}})");
  const std::vector<ShownUrgency> all = urgencies(*board);
  EXPECT_EQ(all[1].planned, 7);
  EXPECT_EQ(all[1].asked, std::nullopt);
  EXPECT_EQ(all[1].changes, 3u);
  EXPECT_EQ(all[2].asked, 12000);
}

TEST_F(Prio, WhatCannotBeIsRefusedAndChangesNothing) {
  const std::pair<const char*, const char*> cases[] = {
      {R"({"xnode": "free", "priority": 1})", "nobody schedules its jobs in this run"},
      {R"({"xnode": "rank", "priority": 1})", "is on a core whose order Linux keeps by ranks"},
      {R"({"xnode": "none", "priority": 1})", "the app has no XNode 'none'"},
      {R"({"xnode": "prio", "key_us": 1})", "has a priority"},
      {R"({"xnode": "key", "priority": 1})", "has a key"},
      {R"({"xnode": "key", "key_us": -1})", "-1 is not from 0"},
      {R"({"xnode": "key", "key_us": 1000000000001})", "is not from 0 to 1000000000000"},
      {R"({"xnode": "prio", "priority": 1000000000001})", "is not from -1000000000000"},
      {R"({"xnode": "prio", "priority": "1"})", "the request is malformed"},
      {R"({"xnode": "prio", "priority": 1, "key_us": 1})", "the request is malformed"},
      {R"({"xnode": 3})", "the request is malformed"},
  };
  for (const auto& [request, what] : cases)
    EXPECT_NE(ask(request).find(what), std::string::npos) << request << ": " << ask(request);
  for (std::size_t n = 0; n < 4; ++n) {
    EXPECT_EQ(board->xnode(n).asked.load(), XNodeLine::kAsPlanned);
    EXPECT_EQ(board->xnode(n).asked_times.load(), 0u);
  }
  EXPECT_EQ(
      answer_error(answer_request(R"({"xnode": "prio", "priority": 1})", nullptr)).error().code,
      ErrorCode::kUnavailable);
}

TEST_F(Prio, NothingIsClaimedOfARunInWhichItWasChanged) {
  board->header().claimed.store(static_cast<std::uint32_t>(Claimed::kOfRates));
  EXPECT_EQ(account_of(*board).count_of("changed_urgency"), 0u);
  (void)ask(R"({"xnode": "key", "key_us": 12000})");
  (void)ask(R"({"xnode": "key"})");
  const Account account = account_of(*board);
  EXPECT_EQ(account.count_of("changed_urgency"), 2u);
  EXPECT_EQ(board->xnode(2).words_of_asked(),
            "the key of XNode 'key' was changed by hand, 2 times; it is the policy's again");
}

}  // namespace
}  // namespace xauto::runtime
