// SPDX-License-Identifier: Apache-2.0
// The backend `own` over nvgpu and nvdla as their source says (tests/devices): what a process does to
// its own TSGs and DLA queues, and what is left of it when it dies.
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "kernel/own_queues.h"
#include "kernel/queue_files.h"
#include "xpu/kind.h"

#include "device_test.h"
#include "devices/nvgpu.h"

namespace xauto::xpu {
namespace {

using kernel::OwnQueues;
using kernel::QueueFile;

/// As CUDA opens them, with numbers of its own.
UniqueFd open_ctrl() {
  return UniqueFd(open("/dev/nvgpu/igpu0/ctrl", O_RDWR | O_CLOEXEC));
}
UniqueFd open_tsg() {
  std::uint32_t args[6] = {};
  return UniqueFd(ioctl(open_ctrl().get(), 0xc0184709, args) == 0 ? static_cast<int>(args[0]) : -1);
}
UniqueFd open_channel() {
  int args = -1;
  return UniqueFd(ioctl(open_ctrl().get(), 0xc004470b, &args) == 0 ? args : -1);
}
struct Tsg {
  UniqueFd tsg = open_tsg(), channel = open_channel();
  Tsg() { bind(channel); }
  void bind(const UniqueFd& which) const {
    int fd = which.get();
    EXPECT_EQ(ioctl(tsg.get(), 0x40045401, &fd), 0);
  }
};
UniqueFd open_dla(bool queue = true) {
  UniqueFd fd(open("/dev/nvhost-ctrl-nvdla0", O_RDWR | O_CLOEXEC));
  if (queue) {
    EXPECT_EQ(ioctl(fd.get(), 0x4409, 0), 0);
  }
  return fd;
}

/// What is found of `fd`.
QueueFile file_of(int fd) {
  const auto files = kernel::find_queue_files(getpid()).value();
  for (const QueueFile& file : files)
    if (file.fd == fd) return file;
  return {};
}

class Own : public DeviceTest<devices::Nvgpu, devices::NvgpuState> {
 protected:
  int disabled() {
    return look([](const auto& state) { return state.disabled(); });
  }
  int preempts() {
    return look([](const auto& state) {
      int all = 0;
      for (const auto& [id, tsg] : state.tsgs) all += tsg.preempts;
      return all;
    });
  }
  int suspended_slots() {
    return look([](const auto& state) { return state.suspended_slots(); });
  }
};

/// What the tests rest on.
TEST_F(Own, TheDevicesRefuseAsTheDriversDo) {
  kernel_.run([&] {
    const Tsg tsg;
    const UniqueFd ctrl = open_ctrl();
    std::uint32_t r35[2] = {};
    EXPECT_EQ(ioctl(ctrl.get(), 0xc0084709, r35), -1) << "r35's size";
    EXPECT_EQ(errno, ENOTTY);
    EXPECT_EQ(ioctl(tsg.tsg.get(), 0x5400, 0), -1) << "number 0";
    EXPECT_EQ(errno, EINVAL);
    EXPECT_EQ(ioctl(tsg.channel.get(), 0x5404, 0), -1) << "of a channel";
    EXPECT_EQ(errno, ENOTTY);
    const UniqueFd none(dup(tsg.tsg.get()));
    EXPECT_EQ(file_of(none.get()).target, file_of(tsg.tsg.get()).target) << "a dup keeps its name";
  });
  EXPECT_EQ(look([](const auto& state) { return state.tsgs.size(); }), 0u) << "all closed";
}

TEST_F(Own, ATsgIsDisabledAndPreemptedAndEnabledAgain) {
  kernel_.run([&] {
    OwnQueues own;
    const Tsg tsg, other;
    const auto handle = own.take(file_of(tsg.tsg.get()));
    ASSERT_TRUE(handle) << handle.error().to_string();
    EXPECT_EQ(*own.take(file_of(tsg.tsg.get())), *handle) << "taken once";
    ASSERT_TRUE(own.suspend(*handle));
    EXPECT_EQ(disabled(), 1);
    EXPECT_EQ(preempts(), 1);
    ASSERT_TRUE(own.suspend(*handle)) << "a repeated vote";
    ASSERT_TRUE(own.resume(*handle));
    ASSERT_TRUE(own.resume(*handle)) << "resuming what runs";
    EXPECT_EQ(disabled(), 0);
  });
}

TEST_F(Own, WhatTheDriverHasEnabledIsSuspendedAgain) {
  kernel_.run([&] {
    OwnQueues own;
    const Tsg tsg;
    const auto handle = *own.take(file_of(tsg.tsg.get()));
    ASSERT_TRUE(own.suspend(handle));
    const UniqueFd channel = open_channel();
    tsg.bind(channel);
    EXPECT_EQ(disabled(), 0) << "a new channel enables all";
    own.again();
    EXPECT_EQ(disabled(), 1);
    tsg.bind(channel);
    ASSERT_TRUE(own.suspend(handle));
    EXPECT_EQ(disabled(), 1) << "and by a repeated vote";
    ASSERT_TRUE(own.resume(handle));
    own.again();
    EXPECT_EQ(disabled(), 0) << "what was resumed is not told again";
  });
}

TEST_F(Own, OneThatDoesNotLeaveRunsAndIsLeftAloneAndInTheEndGated) {
  for (const int error : {EBUSY, EAGAIN})
    kernel_.run([&] {
      OwnQueues own;
      const Tsg tsg;
      const auto handle = *own.take(file_of(tsg.tsg.get()));
      const auto stays = [&] {
        look([&](auto& state) {
          state.fail_preempt = 1, state.preempt_error = error;
          return 0;
        });
        Status done = own.suspend(handle);
        // Not before its time: it would be told at once.
        while (!done && done.error().code == ErrorCode::kUnavailable && !own.gated(handle)) {
          usleep(10'000);
          done = own.suspend(handle);
        }
        return done;
      };
      const int before = preempts();
      EXPECT_EQ(stays().error().code, ErrorCode::kTimeout);
      EXPECT_EQ(disabled(), 0) << "half a suspension is none";
      EXPECT_EQ(own.suspend(handle).error().code, ErrorCode::kUnavailable) << "left alone";
      EXPECT_EQ(preempts(), before + 1);
      EXPECT_FALSE(own.gated(handle));
      if (error == EAGAIN) return;  // the rest takes three seconds
      EXPECT_EQ(stays().error().code, ErrorCode::kTimeout);
      EXPECT_EQ(stays().error().code, ErrorCode::kTimeout);
      EXPECT_TRUE(own.gated(handle));
      look([](auto& state) {
        state.fail_preempt = 0;
        return 0;
      });
      EXPECT_FALSE(own.suspend(handle));
      OwnQueues later;
      EXPECT_TRUE(later.gated(*later.take(file_of(tsg.tsg.get())))) << "nvgpu counts on, too";
    });
}

TEST_F(Own, ADeviceThatDisappearsIsAnErrorAndOneThatComesBackIsResumed) {
  kernel_.run([&] {
    OwnQueues own;
    const Tsg tsg;
    const auto handle = *own.take(file_of(tsg.tsg.get()));
    ASSERT_TRUE(own.suspend(handle));
    look([](auto& state) {
      state.gone = true;
      return 0;
    });
    const Status resumed = own.resume(handle);
    ASSERT_FALSE(resumed);
    EXPECT_EQ(resumed.error().code, ErrorCode::kUnavailable);
    EXPECT_NE(resumed.error().to_string().find("anon_inode:nvgpu-ga10b-tsg"), std::string::npos);
    EXPECT_TRUE(own.owes());
    EXPECT_FALSE(own.suspend(handle));
    look([](auto& state) {
      state.gone = false;
      return 0;
    });
    own.again();
    EXPECT_EQ(disabled(), 0) << "nobody else would resume it";
    EXPECT_FALSE(own.owes());
  });
}

TEST_F(Own, TheEndOfTheBackendTriesUntilItRuns) {
  kernel_.run([&] {
    const Tsg tsg;
    {
      OwnQueues own;
      ASSERT_TRUE(own.suspend(*own.take(file_of(tsg.tsg.get()))));
      look([](auto& state) {
        state.fail_enable = 3;
        return 0;
      });
    }
    EXPECT_EQ(disabled(), 0);
    EXPECT_EQ(look([](const auto& state) { return state.fail_enable; }), 0);
  });
}

TEST_F(Own, AFileThatIsNoneOrIsClosedIsRefused) {
  kernel_.run([&] {
    OwnQueues own;
    UniqueFd ctrl = open_ctrl();
    QueueFile wrong{ctrl.get(), kernel::QueueType::kGpuTsg, -1, "/dev/nvgpu/igpu0/ctrl"};
    const auto refused = own.take(wrong);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
    const UniqueFd empty = open_dla(false);
    const auto none = own.take(file_of(empty.get()));
    ASSERT_FALSE(none);
    EXPECT_EQ(none.error().code, ErrorCode::kInvalid);
    EXPECT_NE(none.error().what.find("no queue"), std::string::npos);

    auto tsg = std::make_unique<Tsg>();
    const int number = tsg->tsg.get();
    const auto handle = *own.take(file_of(number));
    tsg->tsg.reset();
    const Tsg stranger;
    const UniqueFd other = open_channel();
    ASSERT_EQ(dup2(other.get(), number), number);
    const Status closed = own.suspend(handle);
    close(number);
    ASSERT_FALSE(closed);
    EXPECT_EQ(closed.error().code, ErrorCode::kUnavailable) << "a number is used again";
    EXPECT_EQ(closed.error().what, "is closed");
    EXPECT_EQ(disabled(), 0);
    EXPECT_TRUE(own.resume(handle)) << "what is closed needs none";
  });
}

/// It outlives its file while a channel is bound.
TEST_F(Own, ATsgThatIsClosedWhileItIsSuspendedRunsAgain) {
  kernel_.run([&] {
    Tsg tsg;
    OwnQueues own;
    const QueueFile file = file_of(tsg.tsg.get());
    const auto handle = *own.take(file);
    ASSERT_TRUE(own.suspend(handle));
    EXPECT_EQ(kernel::find_own_queues()->size(), 1u) << "what is held is no other queue";
    tsg.tsg.reset();
    EXPECT_FALSE(kernel::is_open(file));
    EXPECT_EQ(disabled(), 1);
    ASSERT_TRUE(own.resume(handle));
    EXPECT_EQ(disabled(), 0);
    EXPECT_EQ(look([](const auto& state) { return state.tsgs.begin()->second.closed; }), true)
        << "and is held no longer";
  });
}

TEST_F(Own, ADlaQueueIsSuspendedInItsSlotAlsoInANewOne) {
  kernel_.run([&] {
    look([](auto& state) { return state.slot_suspended[0] = true; });  // left by whom it was
    const UniqueFd dla = open_dla();
    OwnQueues own;
    const auto handle = own.take(file_of(dla.get()));
    ASSERT_TRUE(handle) << handle.error().to_string();
    EXPECT_EQ(suspended_slots(), 0) << "resumed when it is taken";
    ASSERT_TRUE(own.suspend(*handle));
    EXPECT_EQ(suspended_slots(), 1);
    const int commands = look([](const auto& state) { return state.dla_commands; });
    own.again();
    EXPECT_EQ(look([](const auto& state) { return state.dla_commands; }), commands)
        << "a command may take a second: not each time";
    // It is released and allocated anew in another slot, without a word.
    EXPECT_EQ(ioctl(dla.get(), 0x440a, 0), 0);
    look([](auto& state) { return state.slot_used[0] = true; });
    EXPECT_EQ(ioctl(dla.get(), 0x4409, 0), 0);
    own.again();
    EXPECT_TRUE(look([](const auto& state) { return bool{state.slot_suspended[1]}; }));
    ASSERT_TRUE(own.resume(*handle));
    EXPECT_FALSE(look([](const auto& state) { return bool{state.slot_suspended[1]}; }));
    EXPECT_EQ(ioctl(dla.get(), 0x440a, 0), 0);
    EXPECT_FALSE(own.suspend(*handle)) << "no queue";
    EXPECT_TRUE(own.resume(*handle)) << "nothing to resume";
  });
}

TEST_F(Own, TheBackendSuspendsAContextOfTwoTsgsWholeOrNotAtAll) {
  kernel_.run([&] {
    const Xpu gpu{"gpu0", "gpu"};
    EXPECT_EQ(discipline_of(gpu, false), Discipline::kPreemptive);
    ContextCounts counts;
    auto backend = make_backend({gpu, {"gpu0", XPU::GPU, 0}});
    ASSERT_TRUE(backend) << backend.error().to_string();
    (*backend)->count_in(counts);
    EXPECT_LT((*backend)->again_ms(false), 0);
    int context = 0;
    const SchedHandle handle = SchedHandle::cuda_context(&context);
    std::unique_ptr<Tsg> compute, copies;
    {
      const auto around = (*backend)->before_init();
      compute = std::make_unique<Tsg>();
      copies = std::make_unique<Tsg>();
      ASSERT_TRUE((*backend)->attach(handle));
    }
    ASSERT_TRUE((*backend)->preempt(handle));
    EXPECT_EQ(disabled(), 2);
    EXPECT_EQ((*backend)->again_ms(true), kernel::kAgainMs);
    copies->bind(copies->channel);
    EXPECT_EQ(disabled(), 1);
    ASSERT_TRUE((*backend)->still_wanted());
    EXPECT_EQ(disabled(), 2);
    ASSERT_TRUE((*backend)->restore(handle));
    EXPECT_EQ(disabled(), 0);

    look([](auto& state) {
      state.fail_preempt = 1;
      return 0;
    });
    look([](auto& state) { return state.pass_preempt = 1; });
    EXPECT_FALSE((*backend)->preempt(handle)) << "the second of its two";
    EXPECT_EQ(disabled(), 0) << "half a context suspended is none";

    look([](auto& state) { return state.fail_enable = 2; });
    EXPECT_FALSE((*backend)->restore(handle));
    EXPECT_EQ((*backend)->again_ms(false), kernel::kAgainMs) << "it owes a resume";
    ASSERT_TRUE((*backend)->still_wanted());
    EXPECT_LT((*backend)->again_ms(false), 0);
  });
}

TEST_F(Own, AnOwnerThatIsKilledWhileItIsSuspendedLeavesNothing) {
  kill_once(
      [&](const auto& stay) {
        OwnQueues own;
        const Tsg tsg;
        const UniqueFd dla = open_dla();
        if (own.suspend(*own.take(file_of(tsg.tsg.get()))) &&
            own.suspend(*own.take(file_of(dla.get()))))
          stay();
      },
      [&] {
        EXPECT_EQ(disabled(), 1);
        EXPECT_EQ(suspended_slots(), 1);
      });
  EXPECT_EQ(look([](const auto& state) { return state.tsgs.size(); }), 0u);
  kernel_.run([&] {
    const UniqueFd dla = open_dla();
    OwnQueues own;
    ASSERT_TRUE(own.take(file_of(dla.get())));
  });
  EXPECT_EQ(suspended_slots(), 0) << "the firmware may not forget: who takes the slot resumes it";
}

}  // namespace
}  // namespace xauto::xpu
