// SPDX-License-Identifier: Apache-2.0
// Who has a terminal that draws nothing, or wants no colours, gets plain lines.
#include "base/terminal.h"

#include <array>
#include <cstdlib>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "base/unique_fd.h"

namespace xauto {
namespace {

TEST(Terminal, DrawsByTheEnvironmentOfItsUser) {
  // Not openpty: before glibc 2.34 it is in a library of its own.
  const UniqueFd master(posix_openpt(O_RDWR | O_NOCTTY));
  ASSERT_TRUE(grantpt(master.get()) == 0 && unlockpt(master.get()) == 0);
  const UniqueFd terminal(open(ptsname(master.get()), O_RDWR | O_NOCTTY));
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
