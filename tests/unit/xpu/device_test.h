// SPDX-License-Identifier: Apache-2.0
// What the tests of backends over drivers of user space (tests/devices) have in common.
#pragma once

#include <csignal>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include "devices/kernel.h"

namespace xauto::xpu {

template <class Driver, class State>
class DeviceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string why = devices::Kernel::missing(); !why.empty()) GTEST_SKIP() << why;
  }
  /// `what` with the driver's state, once all that was closed is closed for it.
  template <class What>
  auto look(What what) {
    kernel_.settle();
    const std::lock_guard lock(kernel_.mutex());
    return what(state_);
  }
  /// A process that has come to its `stay()` is killed there; `meanwhile` is looked at before.
  void kill_once(const std::function<void(const std::function<void()>& stay)>& body,
                 const std::function<void()>& meanwhile) {
    int pipe_ends[2];
    ASSERT_EQ(pipe(pipe_ends), 0);
    const pid_t child = kernel_.fork([&] {
      body([&] {
        (void)!write(pipe_ends[1], "", 1);
        for (;;) pause();
      });
    });
    ASSERT_GT(child, 0);
    close(pipe_ends[1]);
    char byte;
    const bool stays = read(pipe_ends[0], &byte, 1) == 1;
    close(pipe_ends[0]);
    if (stays) meanwhile();
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    ASSERT_TRUE(stays) << "the process has ended before";
  }

  State state_;
  devices::Kernel kernel_{{std::make_shared<Driver>(state_)}};
};

}  // namespace xauto::xpu
