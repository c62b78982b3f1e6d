// SPDX-License-Identifier: Apache-2.0
// Who has a terminal that draws nothing, or wants no colours, gets plain lines.
#include "base/terminal.h"

#include <array>

#include <gtest/gtest.h>
#include <pty.h>

#include "base/unique_fd.h"

namespace xauto {
namespace {

TEST(Terminal, DrawsByTheEnvironmentOfItsUser) {
  int ours = -1, theirs = -1;
  ASSERT_EQ(openpty(&ours, &theirs, nullptr, nullptr, nullptr), 0);
  const UniqueFd master(ours), terminal(theirs);
  std::array<int, 2> pipes{};
  ASSERT_EQ(pipe(pipes.data()), 0);
  const UniqueFd reader(pipes[0]), writer(pipes[1]);
  unsetenv("NO_COLOR");
  setenv("TERM", "xterm", 1);
  EXPECT_TRUE(can_draw(terminal.get()));
  EXPECT_TRUE(can_colour(terminal.get()));
  EXPECT_FALSE(can_draw(writer.get()));
  setenv("NO_COLOR", "1", 1);
  EXPECT_TRUE(can_draw(terminal.get()));
  EXPECT_FALSE(can_colour(terminal.get()));
  setenv("NO_COLOR", "", 1);
  EXPECT_TRUE(can_colour(terminal.get()));
  for (const char* dumb : {"dumb", ""}) {
    setenv("TERM", dumb, 1);
    EXPECT_FALSE(can_draw(terminal.get())) << dumb;
    EXPECT_FALSE(can_colour(terminal.get())) << dumb;
  }
  unsetenv("TERM");
  EXPECT_FALSE(can_draw(terminal.get()));
}

}  // namespace
}  // namespace xauto
