// SPDX-License-Identifier: Apache-2.0
// The client of xauto.ko where there is none. With it: tests/kselftest/kmod/, in VMs.
#include "kernel/queue_control.h"

#include <filesystem>

#include <gtest/gtest.h>

namespace xauto::kernel {
namespace {

TEST(QueueControl, SaysWhatIsMissingAndWhatToDo) {
  if (std::filesystem::exists("/sys/module/xauto")) GTEST_SKIP() << "xauto.ko is loaded here";
  const auto control = QueueControl::open();
  ASSERT_FALSE(control);
  EXPECT_EQ(control.error().code, ErrorCode::kUnavailable);
  EXPECT_NE(control.error().to_string().find("xauto.ko"), std::string::npos)
      << control.error().to_string();
}

}  // namespace
}  // namespace xauto::kernel
