// SPDX-License-Identifier: Apache-2.0
// Without a driver; what it is for is tested over the emulators (tests/kselftest/kmod).
#include <atomic>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/xpu.h>

namespace xauto {
namespace {

TEST(MakeContext, ReturnsTheHandleWithoutADriver) {
  int context = 0;
  for (const SchedHandle& handle :
       {SchedHandle::cuda_context(&context), SchedHandle::cudla_device(&context),
        SchedHandle::gate(), SchedHandle::thread()})
    EXPECT_EQ(make_context([&] { return handle; }), handle);
}

TEST(MakeContext, WhatMakeThrowsComesOutAndOthersMayMake) {
  EXPECT_THROW(make_context([]() -> SchedHandle { throw std::runtime_error("no memory"); }),
               std::runtime_error);
  std::thread([] { make_context([] { return SchedHandle(); }); }).join();
}

TEST(MakeContext, OneAtATimeButWithinAnotherOfTheThread) {
  std::atomic<int> inside{0}, together{0};
  std::vector<std::thread> threads;
  for (int n = 0; n < 4; ++n)
    threads.emplace_back([&] {
      for (int i = 0; i < 50; ++i)
        make_context([&] {
          if (++inside > 1) ++together;
          make_context([] { return SchedHandle(); });
          std::this_thread::yield();
          --inside;
          return SchedHandle();
        });
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(together, 0);
}

}  // namespace
}  // namespace xauto
