// SPDX-License-Identifier: Apache-2.0
// The backend `rm` over NVIDIA's RM driver as its source says (tests/devices), seen by the real
// libxauto_watch.so, with which this program is linked.
#include "devices/rm.h"

#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "kernel/rm_queues.h"
#include "xpu/kind.h"

#include "device_test.h"

namespace xauto::xpu {
namespace {

using kernel::QueueFile;
using kernel::RmQueues;

/// As CUDA makes its objects, with numbers of its own.
class Cuda {
 public:
  Cuda() : fd_(open("/dev/nvidiactl", O_RDWR | O_CLOEXEC)) {
    client_ = alloc(0, 0x41);
    device_ = alloc(client_, 0x80);
    subdevice_ = alloc(device_, 0x2080);
  }
  /// libcuda frees its client, or has its descriptor until the process ends.
  ~Cuda() {
    if (fd_) free(client_);
  }
  std::uint32_t group() { return alloc(device_, 0xa06c); }
  /// Hopper's.
  std::uint32_t channel(std::uint32_t group) { return alloc(group, 0xc86f); }
  std::uint32_t channel_of_its_own() { return channel(device_); }

  std::uint32_t alloc(std::uint32_t parent, std::uint32_t type) {
    // NVOS64, by its own size; every other time inside a transfer.
    std::uint32_t args[12] = {client_, parent, 0, type};
    through_transfer_ = !through_transfer_;
    if (through_transfer_) {
      struct {
        std::uint32_t command, size;
        void* argument;
      } transfer{0x2b, sizeof args, args};
      EXPECT_EQ(ioctl(fd_.get(), 0xc01046d3, &transfer), 0);
    } else {
      EXPECT_EQ(ioctl(fd_.get(), 0xc030462b, args), 0);
    }
    EXPECT_EQ(args[10], 0u);
    return args[2];
  }
  /// NVOS21: the older one.
  std::uint32_t alloc_short(std::uint32_t parent, std::uint32_t type) {
    std::uint32_t args[8] = {client_, parent, 0, type};
    EXPECT_EQ(ioctl(fd_.get(), 0xc020462b, args), 0);
    EXPECT_EQ(args[7], 0u);
    return args[2];
  }
  void free(std::uint32_t object) {
    std::uint32_t args[4] = {client_, 0, object, 0};
    EXPECT_EQ(ioctl(fd_.get(), 0xc0104629, args), 0);
    EXPECT_EQ(args[3], 0u);
  }
  [[nodiscard]] std::uint32_t client() const { return client_; }
  [[nodiscard]] std::uint32_t device() const { return device_; }
  [[nodiscard]] std::uint32_t subdevice() const { return subdevice_; }
  [[nodiscard]] int fd() const { return fd_.get(); }
  void close() { fd_.reset(); }

 private:
  UniqueFd fd_;
  bool through_transfer_ = false;
  std::uint32_t client_ = 0, device_ = 0, subdevice_ = 0;
};

class RmTest : public DeviceTest<devices::Rm, devices::RmState> {
 protected:
  int disabled() {
    return look([](const auto& state) { return state.channels(true); });
  }
  template <class T>
  void set(T devices::RmState::*what, T value) {
    look([&](auto& state) { return state.*what = value; });
  }
};

/// What the tests rest on.
TEST_F(RmTest, TheDeviceRefusesAsTheDriverDoes) {
  kernel_.run([&] {
    Cuda cuda;
    std::uint32_t args[12] = {};
    EXPECT_EQ(ioctl(cuda.fd(), 0xc02c462b, args), -1) << "an allocation of another size";
    EXPECT_EQ(errno, EINVAL);
    const UniqueFd other(open("/dev/nvidiactl", O_RDWR | O_CLOEXEC));
    std::uint32_t params[134] = {1, 1};
    struct {
      std::uint32_t client, object, command, flags;
      void* params;
      std::uint32_t size, status;
    } control{cuda.client(), cuda.subdevice(), 0x2080110b, 0, params, sizeof params, 0};
    EXPECT_EQ(ioctl(other.get(), 0xc020462a, &control), 0);
    EXPECT_EQ(control.status, 0x23u) << "another file's client";
    control.size = 532;
    EXPECT_EQ(ioctl(cuda.fd(), 0xc020462a, &control), 0);
    EXPECT_EQ(control.status, 0x1fu) << "another size";
    control.size = sizeof params;
    EXPECT_EQ(ioctl(cuda.fd(), 0xc020462a, &control), 0);
    EXPECT_EQ(control.status, 0x33u) << "no such client in the list";
    params[6] = cuda.client();
    EXPECT_EQ(ioctl(cuda.fd(), 0xc020462a, &control), 0);
    EXPECT_EQ(control.status, 0x57u) << "no such channel";
  });
  EXPECT_EQ(look([](const auto& state) { return state.clients.size(); }), 0u) << "closed";
}

TEST_F(RmTest, GroupsAreSeenAsTheyComeAndGo) {
  kernel_.run([&] {
    ASSERT_TRUE(kernel::rm_is_watched());
    EXPECT_TRUE(kernel::find_rm_groups().empty());
    Cuda cuda;
    const std::uint32_t group = cuda.group();
    std::uint32_t refused[8] = {cuda.client(), 0x1234, 0x5678, 0xc86f};
    EXPECT_EQ(ioctl(cuda.fd(), 0xc020462b, refused), 0);
    EXPECT_NE(refused[7], 0u);
    std::uint32_t taken[8] = {cuda.client(), group, cuda.subdevice(), 0xc86f};
    EXPECT_EQ(ioctl(cuda.fd(), 0xc020462b, taken), 0);
    EXPECT_NE(taken[7], 0u) << "a handle that is used";
    EXPECT_TRUE(kernel::find_rm_groups().empty()) << "without a channel there is nothing";
    const std::uint32_t first = cuda.channel(group);
    (void)cuda.alloc_short(group, 0xca6f);
    (void)cuda.channel_of_its_own();
    const std::vector<QueueFile> groups = kernel::find_rm_groups();
    ASSERT_EQ(groups.size(), 2u);
    EXPECT_EQ(groups[0].fd, cuda.fd());
    EXPECT_TRUE(groups[0].target.starts_with("rm:" + std::to_string(cuda.client()) + ":" +
                                             std::to_string(group) + ":"));
    EXPECT_TRUE(kernel::is_open(groups[0]));
    cuda.free(first);
    EXPECT_EQ(kernel::find_rm_groups().size(), 2u);
    cuda.free(group);  // with what is below it
    EXPECT_EQ(kernel::find_rm_groups().size(), 1u);
    EXPECT_FALSE(kernel::is_open(groups[0]));
    cuda.free(cuda.device());
    EXPECT_TRUE(kernel::find_rm_groups().empty());
    Cuda again;
    (void)again.channel_of_its_own();
    EXPECT_EQ(kernel::find_rm_groups().size(), 1u);
  });
  kernel_.run([&] {
    EXPECT_TRUE(kernel::find_rm_groups().empty());
    Cuda closed;
    (void)closed.channel_of_its_own();
    closed.close();
    EXPECT_TRUE(kernel::find_rm_groups().empty());
  });
}

TEST_F(RmTest, AContextIsDisabledByOneCallAndEnabledByOne) {
  kernel_.run([&] {
    Cuda cuda, other;
    const std::uint32_t compute = cuda.group(), copies = cuda.group();
    for (int i = 0; i < 3; ++i) (void)cuda.channel(compute);
    (void)cuda.channel(copies);
    (void)other.channel(other.group());
    RmQueues rm;
    std::vector<RmQueues::Handle> handles;
    for (const QueueFile& group : kernel::find_rm_groups())
      if (group.fd == cuda.fd()) handles.push_back(*rm.take(group));
    ASSERT_EQ(handles.size(), 2u);
    EXPECT_EQ(*rm.take(kernel::find_rm_groups()[0]), handles[0]) << "taken once";
    ASSERT_TRUE(rm.suspend(handles));
    EXPECT_EQ(disabled(), 4);
    EXPECT_EQ(look([](const auto& state) { return state.calls; }), 1);
    rm.again();
    EXPECT_EQ(look([](const auto& state) { return state.calls; }), 1) << "it holds";
    (void)cuda.channel(compute);
    EXPECT_EQ(disabled(), 4);
    rm.again();
    EXPECT_EQ(disabled(), 5) << "a channel that came later";
    ASSERT_TRUE(rm.resume(handles));
    EXPECT_EQ(disabled(), 0);
    rm.again();
    EXPECT_EQ(disabled(), 0);
  });
}

TEST_F(RmTest, MoreChannelsThanACallTakesAreSeveralCalls) {
  kernel_.run([&] {
    Cuda cuda;
    const std::uint32_t group = cuda.group();
    for (int i = 0; i < 64; ++i) (void)cuda.channel(group);
    RmQueues rm;
    const auto handle = *rm.take(kernel::find_rm_groups()[0]);
    ASSERT_TRUE(rm.suspend({handle}));
    EXPECT_EQ(disabled(), 64);
    EXPECT_EQ(look([](const auto& state) { return state.calls; }), 1);
    ASSERT_TRUE(rm.resume({handle}));
    for (int i = 0; i < 6; ++i) (void)cuda.channel(group);
    ASSERT_TRUE(rm.suspend({handle}));
    EXPECT_EQ(disabled(), 70);
    ASSERT_TRUE(rm.resume({handle}));
    EXPECT_EQ(disabled(), 0);
    EXPECT_EQ(look([](const auto& state) { return state.calls; }), 6);
    ASSERT_TRUE(rm.suspend({handle}));
    set(&devices::RmState::status, 0x40u);
    set(&devices::RmState::fail_enable, 1);
    EXPECT_EQ(rm.resume({handle}).error().code, ErrorCode::kIo);
    EXPECT_EQ(disabled(), 64) << "the rest is resumed all the same";
    rm.again();
    EXPECT_EQ(disabled(), 0);
  });
}

/// Between the look at what there is and the call, or by who is not seen.
TEST_F(RmTest, AChannelThatWasFreedUnseenLeavesTheOthersNotDisabled) {
  kernel_.run([&] {
    Cuda cuda;
    const std::uint32_t group = cuda.group();
    const std::uint32_t freed = cuda.channel(group);
    (void)cuda.channel(group);
    (void)cuda.channel(cuda.group());
    RmQueues rm;
    std::vector<RmQueues::Handle> handles;
    for (const QueueFile& file : kernel::find_rm_groups()) handles.push_back(*rm.take(file));
    ASSERT_TRUE(rm.suspend(handles));
    std::uint32_t args[4] = {cuda.client(), 0, freed, 0};
    ASSERT_EQ(syscall(SYS_ioctl, cuda.fd(), 0xc0104629, args), 0);
    ASSERT_EQ(args[3], 0u);
    EXPECT_EQ(disabled(), 2);
    EXPECT_TRUE(rm.resume(handles)) << "what is gone needs none";
    EXPECT_EQ(disabled(), 0);
    EXPECT_FALSE(rm.owes());
  });
}

TEST_F(RmTest, OneThatDoesNotLeaveRunsAndIsLeftAlone) {
  for (const std::uint32_t status : {0x65u, 0x66u, 0x3u, 0x63u})
    kernel_.run([&] {
      Cuda cuda;
      (void)cuda.channel(cuda.group());
      RmQueues rm;
      const auto handle = *rm.take(kernel::find_rm_groups()[0]);
      set(&devices::RmState::status, status);
      set(&devices::RmState::fail_disable, 1);
      EXPECT_EQ(rm.suspend({handle}).error().code, ErrorCode::kTimeout) << status;
      EXPECT_EQ(disabled(), 0);
      const int calls = look([](const auto& state) { return state.calls; });
      EXPECT_EQ(calls % 2, 0) << "and enabled, for a part may be off";
      EXPECT_EQ(rm.suspend({handle}).error().code, ErrorCode::kUnavailable);
      EXPECT_EQ(look([](const auto& state) { return state.calls; }), calls) << "nobody is asked";
      EXPECT_FALSE(rm.gated(handle));
    });
}

TEST_F(RmTest, AGpuThatIsLostOrADriverWithoutGspIsSaidAndAResumeIsOwed) {
  kernel_.run([&] {
    Cuda cuda;
    (void)cuda.channel(cuda.group());
    RmQueues rm;
    const auto handle = *rm.take(kernel::find_rm_groups()[0]);
    set(&devices::RmState::no_gsp, true);
    const Status refused = rm.suspend({handle});
    ASSERT_FALSE(refused);
    EXPECT_NE(refused.error().to_string().find("GSP"), std::string::npos);
    set(&devices::RmState::no_gsp, false);
    ASSERT_TRUE(rm.suspend({handle}));
    set(&devices::RmState::lost, true);
    EXPECT_FALSE(rm.resume({handle}));
    EXPECT_TRUE(rm.owes());
    set(&devices::RmState::lost, false);
    rm.again();
    EXPECT_FALSE(rm.owes());
    EXPECT_EQ(disabled(), 0);
    EXPECT_FALSE(rm.gated(handle));
  });
}

TEST_F(RmTest, WhatIsFreedOrClosedIsGone) {
  kernel_.run([&] {
    Cuda cuda;
    const std::uint32_t group = cuda.group();
    (void)cuda.channel(group);
    RmQueues rm;
    const QueueFile file = kernel::find_rm_groups()[0];
    const auto handle = *rm.take(file);
    cuda.free(group);
    EXPECT_EQ(rm.suspend({handle}).error().code, ErrorCode::kUnavailable);
    EXPECT_TRUE(rm.resume({handle})) << "what is gone needs none";
    EXPECT_FALSE(rm.take({file.fd, file.type, -1, "rm:1:2:3"}));
    std::uint32_t same[8] = {cuda.client(), cuda.device(), group, 0xa06c};
    EXPECT_EQ(ioctl(cuda.fd(), 0xc020462b, same), 0);
    ASSERT_EQ(same[7], 0u);
    (void)cuda.channel(group);
    EXPECT_FALSE(kernel::is_open(file)) << "a handle that is used again";
    cuda.free(group);
    (void)cuda.channel(cuda.group());
    const auto closed = *rm.take(kernel::find_rm_groups()[0]);
    const int number = cuda.fd();
    cuda.close();  // without freeing its client
    const UniqueFd stranger(open("/dev/nvidiactl", O_RDWR | O_CLOEXEC));
    ASSERT_EQ(stranger.get(), number);
    EXPECT_EQ(kernel::find_rm_groups().size(), 1u) << "nobody has told";
    EXPECT_EQ(rm.suspend({closed}).error().code, ErrorCode::kUnavailable);
    EXPECT_EQ(kernel::find_rm_groups().size(), 0u) << "the driver has";
    EXPECT_TRUE(rm.resume({closed}));
    EXPECT_FALSE(rm.owes());

    auto last = std::make_unique<Cuda>();
    (void)last->channel(last->group());
    const auto taken = *rm.take(kernel::find_rm_groups()[0]);
    ASSERT_TRUE(rm.suspend({taken}));
    const int again = last->fd();
    last->close();
    const UniqueFd in_its_place(open("/dev/nvidiactl", O_RDWR | O_CLOEXEC));
    ASSERT_EQ(in_its_place.get(), again);
    EXPECT_TRUE(rm.resume({taken})) << "the driver says that it is gone";
    EXPECT_FALSE(rm.owes());
  });
}

TEST_F(RmTest, TheRowFindsItAndTheBackendSuspendsAContextWhole) {
  kernel_.run([&] {
    const Xpu gpu{"gpu0", "gpu"};
    ASSERT_EQ(kind_of("gpu").driver, "nvidia");
    EXPECT_EQ(discipline_of(gpu, false), Discipline::kPreemptive);
    EXPECT_TRUE(is_watched(gpu, false));
    EXPECT_FALSE(is_watched(gpu, true));
    auto backend = make_backend({gpu, {"gpu0", XPU::GPU, 0}});
    ASSERT_TRUE(backend) << backend.error().to_string();
    ContextCounts counts;
    (*backend)->count_in(counts);
    int context = 0, another = 0;
    const SchedHandle handle = SchedHandle::cuda_context(&context);
    const SchedHandle second = SchedHandle::cuda_context(&another);
    Cuda cuda;
    std::uint32_t group = 0;
    {
      const auto around = (*backend)->before_init();
      group = cuda.group();
      (void)cuda.channel(group);
      (void)cuda.channel(cuda.group());
      ASSERT_TRUE((*backend)->attach(handle));
    }
    (void)make_context([&] {
      (void)cuda.channel(cuda.group());
      return second;
    });
    {
      const auto around = (*backend)->before_init();
      ASSERT_TRUE((*backend)->attach(second)) << "made in make_context()";
    }
    ASSERT_TRUE((*backend)->preempt(handle));
    EXPECT_EQ(disabled(), 2);
    (void)cuda.channel(group);
    ASSERT_TRUE((*backend)->still_wanted());
    EXPECT_EQ(disabled(), 3);
    ASSERT_TRUE((*backend)->restore(handle));
    EXPECT_EQ(disabled(), 0);
    EXPECT_EQ(counts.assumed, 0u);
    ASSERT_TRUE((*backend)->preempt(second));
    EXPECT_EQ(disabled(), 1);
    backend->reset();
    EXPECT_EQ(disabled(), 0) << "its end resumes";
  });
}

TEST_F(RmTest, AnOwnerThatIsKilledWhileItIsSuspendedLeavesNothing) {
  kill_once(
      [&](const auto& stay) {
        Cuda cuda;
        (void)cuda.channel(cuda.group());
        RmQueues rm;
        if (rm.suspend({*rm.take(kernel::find_rm_groups()[0])})) stay();
      },
      [&] { EXPECT_EQ(disabled(), 1); });
  EXPECT_EQ(look([](const auto& state) { return state.clients.size(); }), 0u);
}

}  // namespace
}  // namespace xauto::xpu
