// SPDX-License-Identifier: Apache-2.0
// Which word was meant.
#include "base/nearest.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

TEST(Nearest, AThirdMayBeWrong) {
  const std::vector<std::string> verbs = {"solve", "simulate", "compare", "recording", "run"};
  EXPECT_EQ(nearest("slove", verbs), "solve") << "two neighbours exchanged are one edit";
  EXPECT_EQ(nearest("slv", verbs), "");
  EXPECT_EQ(nearest("simluate", verbs), "simulate");
  EXPECT_EQ(nearest("explode", verbs), "");
  EXPECT_EQ(nearest(std::string(100, 's'), verbs), "");
}

TEST(Nearest, OrAllBehindWhatIsGivenMayBeMissing) {
  const std::vector<std::string> verbs = {"solve", "simulate", "compare", "recording", "run"};
  EXPECT_EQ(nearest("record", verbs), "recording");
  EXPECT_EQ(nearest("sim", verbs), "simulate");
  EXPECT_EQ(nearest("re", verbs), "") << "too little";
  EXPECT_EQ(nearest("record", {"report", "recording"}), "recording") << "two edits are farther";
}

}  // namespace
}  // namespace xauto
