// SPDX-License-Identifier: Apache-2.0
// The backend `kfd` over amdkfd as its source says (tests/devices), seen by the real
// libxauto_watch.so, with which this program is linked.
#include "devices/kfd.h"

#include <cstring>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "kernel/kfd_queues.h"
#include "xpu/kind.h"

#include "device_test.h"

namespace xauto::xpu {
namespace {

using kernel::KfdQueues;
using kernel::QueueFile;

/// As ROCm's runtime makes queues, with numbers of its own.
struct Rocm {
  UniqueFd fd{open("/dev/kfd", O_RDWR | O_CLOEXEC)};
  /// `longer`: of a header that has a field more.
  std::uint32_t queue(std::uint32_t percentage = 100, bool longer = false) const {
    struct {
      std::uint64_t ring = 0x7f0000100000, write = 0, read = 0, doorbell = 0;
      std::uint32_t size = 65536, gpu = 0, type = 2, percentage = 100, priority = 7, id = 0;
      std::uint64_t eop = 0, eop_size = 0, save = 0;
      std::uint32_t save_size = 0, stack_size = 0, engine = 0, pad = 0;
    } args;
    static_assert(sizeof args == 96);
    args.percentage = percentage;
    EXPECT_EQ(ioctl(fd.get(), longer ? 0xc0604b02 : 0xc0584b02, &args), 0);
    return args.id;
  }
  int update(std::uint32_t id, std::uint32_t percentage, std::uint32_t priority = 7,
             std::uint32_t size = 65536) const {
    struct {
      std::uint64_t ring;
      std::uint32_t id, size, percentage, priority;
    } args{0x7f0000100000, id, size, percentage, priority};
    return ioctl(fd.get(), 0x40184b07, &args) == 0 ? 0 : errno;
  }
  void destroy(std::uint32_t id) const {
    std::uint32_t args[2] = {id, 0};
    EXPECT_EQ(ioctl(fd.get(), 0xc0084b03, args), 0);
  }
};

class KfdTest : public DeviceTest<devices::Kfd, devices::KfdState> {
 protected:
  int active() {
    return look([](const auto& state) { return state.active(); });
  }
  void fail(int devices::KfdState::*what, int error) {
    look([&](auto& state) {
      state.error = error;
      return state.*what = 1;
    });
  }
};

/// What the tests rest on.
TEST_F(KfdTest, TheDeviceRefusesAsTheDriverDoes) {
  kernel_.run([&] {
    const Rocm rocm;
    const std::uint32_t queue = rocm.queue();
    EXPECT_EQ(rocm.update(queue, 101), EINVAL);
    EXPECT_EQ(rocm.update(queue, 100, 16), EINVAL);
    EXPECT_EQ(rocm.update(queue, 100, 7, 65535), EINVAL) << "no power of two";
    EXPECT_EQ(rocm.update(queue, 100, 7, 131072), EFAULT) << "a ring that is not mapped so far";
    EXPECT_EQ(rocm.update(queue + 1, 100), EFAULT) << "no such queue";
  });
  EXPECT_EQ(look([](const auto& state) { return state.queues.size(); }), 0u);
}

TEST_F(KfdTest, AQueueIsTakenOffAndPutBackAsItsProcessWantsIt) {
  kernel_.run([&] {
    const Rocm rocm;
    const std::uint32_t first = rocm.queue(), second = rocm.queue(60, true);
    ASSERT_EQ(kernel::find_kfd_queues().size(), 2u);
    EXPECT_TRUE(kernel::find_kfd_queues()[0].target.starts_with("kfd:" + std::to_string(first)));
    KfdQueues kfd;
    const auto handle = *kfd.take(kernel::find_kfd_queues()[1]);
    EXPECT_EQ(*kfd.take(kernel::find_kfd_queues()[1]), handle) << "taken once";
    ASSERT_TRUE(kfd.suspend(handle));
    EXPECT_EQ(active(), 1);
    const int updates = look([](const auto& state) { return state.updates; });
    kfd.again();
    EXPECT_EQ(look([](const auto& state) { return state.updates; }), updates) << "it holds";
    EXPECT_EQ(rocm.update(second, 80, 9), 0);
    EXPECT_EQ(active(), 2) << "the process itself has put it back";
    kfd.again();
    EXPECT_EQ(active(), 1);
    const int told = look([](const auto& state) { return state.updates; });
    kfd.again();
    EXPECT_EQ(look([](const auto& state) { return state.updates; }), told) << "once";
    ASSERT_TRUE(kfd.resume(handle));
    EXPECT_EQ(active(), 2);
    look([&](const auto& state) {
      EXPECT_EQ(state.queues.at(second).percentage, 80u);
      EXPECT_EQ(state.queues.at(second).priority, 9u);
      return 0;
    });
    EXPECT_EQ(rocm.update(second, 0), 0);
    ASSERT_TRUE(kfd.suspend(handle));
    ASSERT_TRUE(kfd.resume(handle));
    EXPECT_EQ(active(), 1) << "its process had taken it off";
  });
}

TEST_F(KfdTest, OneThatDoesNotLeaveRunsAndIsLeftAlone) {
  for (const int error : {ETIME, ETIMEDOUT, EBUSY, EAGAIN})
    kernel_.run([&] {
      const Rocm rocm;
      const std::uint32_t queue = rocm.queue();
      KfdQueues kfd;
      const auto handle = *kfd.take(kernel::find_kfd_queues()[0]);
      fail(&devices::KfdState::fail_off, error);
      EXPECT_EQ(kfd.suspend(handle).error().code, ErrorCode::kTimeout) << error;
      look([](const auto& state) {
        EXPECT_EQ(state.queues.begin()->second.percentage, 100u) << "half a suspension is none";
        return 0;
      });
      const int updates = look([](const auto& state) { return state.updates; });
      EXPECT_EQ(kfd.suspend(handle).error().code, ErrorCode::kUnavailable);
      EXPECT_EQ(look([](const auto& state) { return state.updates; }), updates);
      rocm.destroy(queue);
    });
}

TEST_F(KfdTest, AGpuThatWasResetIsSaidAndAResumeIsOwed) {
  kernel_.run([&] {
    const Rocm rocm;
    (void)rocm.queue();
    KfdQueues kfd;
    const auto handle = *kfd.take(kernel::find_kfd_queues()[0]);
    ASSERT_TRUE(kfd.suspend(handle));
    for (const int error : {EACCES, ENODEV, EIO}) {
      fail(&devices::KfdState::fail_on, error);
      const Status resumed = kfd.resume(handle);
      ASSERT_FALSE(resumed) << error;
      EXPECT_EQ(resumed.error().code, ErrorCode::kUnavailable);
      EXPECT_NE(resumed.error().hint.find("reset"), std::string::npos);
      EXPECT_TRUE(kfd.owes());
    }
    EXPECT_EQ(active(), 0);
    kfd.again();
    EXPECT_EQ(active(), 1);
    EXPECT_FALSE(kfd.owes());
  });
}

TEST_F(KfdTest, WhatIsDestroyedOrClosedIsGone) {
  kernel_.run([&] {
    Rocm rocm;
    const std::uint32_t queue = rocm.queue();
    KfdQueues kfd;
    const QueueFile file = kernel::find_kfd_queues()[0];
    const auto handle = *kfd.take(file);
    rocm.destroy(queue);
    EXPECT_FALSE(kernel::is_open(file));
    EXPECT_EQ(kfd.suspend(handle).error().code, ErrorCode::kUnavailable);
    EXPECT_TRUE(kfd.resume(handle)) << "what is gone needs none";
    EXPECT_FALSE(KfdQueues().take(file));
    EXPECT_EQ(rocm.queue(), queue);
    EXPECT_FALSE(kernel::is_open(file)) << "a number that is used again";
    const auto closed = *kfd.take(kernel::find_kfd_queues()[0]);
    rocm.fd.reset();
    EXPECT_EQ(kfd.suspend(closed).error().code, ErrorCode::kUnavailable);
    EXPECT_FALSE(kfd.owes());
  });
}

TEST_F(KfdTest, TheRowFindsItAndTheBackendSuspendsAContextWhole) {
  kernel_.run([&] {
    const Xpu gpu{"gpu0", "gpu"};
    ASSERT_EQ(kind_of("gpu").driver, "amdkfd");
    EXPECT_TRUE(is_watched(gpu, false));
    auto backend = make_backend({gpu, {"gpu0", XPU::GPU, 0}});
    ASSERT_TRUE(backend) << backend.error().to_string();
    int context = 0;
    const SchedHandle handle = SchedHandle::cuda_context(&context);
    const Rocm rocm;
    {
      const auto around = (*backend)->before_init();
      (void)rocm.queue();
      (void)rocm.queue();
      ASSERT_TRUE((*backend)->attach(handle));
    }
    ASSERT_TRUE((*backend)->preempt(handle));
    EXPECT_EQ(active(), 0);
    ASSERT_TRUE((*backend)->restore(handle));
    EXPECT_EQ(active(), 2);
    ASSERT_TRUE((*backend)->preempt(handle));
    fail(&devices::KfdState::fail_on, EIO);
    EXPECT_FALSE((*backend)->restore(handle));
    EXPECT_EQ(active(), 1) << "the other one is resumed all the same";
    EXPECT_GT((*backend)->again_ms(false), 0);
    ASSERT_TRUE((*backend)->still_wanted());
    EXPECT_EQ(active(), 2);
    ASSERT_TRUE((*backend)->preempt(handle));
    backend->reset();
    EXPECT_EQ(active(), 2) << "its end resumes";
  });
}

TEST_F(KfdTest, AnOwnerThatIsKilledWhileItIsSuspendedLeavesNothing) {
  kill_once(
      [&](const auto& stay) {
        const Rocm rocm;
        (void)rocm.queue();
        KfdQueues kfd;
        if (kfd.suspend(*kfd.take(kernel::find_kfd_queues()[0]))) stay();
      },
      [&] { EXPECT_EQ(active(), 0); });
  EXPECT_EQ(look([](const auto& state) { return state.queues.size(); }), 0u);
}

}  // namespace
}  // namespace xauto::xpu
