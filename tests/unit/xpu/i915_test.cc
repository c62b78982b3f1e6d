// SPDX-License-Identifier: Apache-2.0
// The backend `i915` over i915 as its source says (tests/devices), seen by the real
// libxauto_watch.so, with which this program is linked.
#include "devices/i915.h"

#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "base/unique_fd.h"
#include "kernel/i915_contexts.h"
#include "xpu/kind.h"
#include "xpu/presence.h"

#include "device_test.h"

namespace xauto::xpu {
namespace {

using kernel::I915Contexts;
using kernel::QueueFile;

/// As an OpenCL or Level Zero runtime opens the GPU, with numbers of its own.
struct Runtime {
  UniqueFd fd{open("/dev/dri/renderD128", O_RDWR | O_CLOEXEC)};
  /// `longer`: with flags and extensions.
  std::uint32_t context(bool longer = true) const {
    struct {
      std::uint32_t id = 0, flags = 0;
      std::uint64_t extensions = 0;
    } args;
    static_assert(sizeof args == 16);
    EXPECT_EQ(ioctl(fd.get(), longer ? 0xc010646d : 0xc008646d, &args), 0);
    return args.id;
  }
  void destroy(std::uint32_t id) const {
    std::uint32_t args[2] = {id, 0};
    EXPECT_EQ(ioctl(fd.get(), 0x4008646e, args), 0);
  }
  int set(std::uint32_t id, std::int64_t priority, std::uint32_t size = 0) const {
    struct {
      std::uint32_t id, size;
      std::uint64_t what;
      std::int64_t value;
    } args{id, size, 6, priority};
    return ioctl(fd.get(), 0xc0186475, &args) == 0 ? 0 : errno;
  }
};

class I915Test : public DeviceTest<devices::I915, devices::I915State> {
 protected:
  /// Of all contexts, the files in any order.
  std::vector<int> priorities() {
    return look([](const auto& state) {
      std::vector<int> all;
      for (const auto& [name, priority] : state.contexts) all.push_back(priority);
      return all;
    });
  }
  void with(int scheduler, bool nice) {
    look([&](auto& state) {
      state.scheduler = scheduler;
      state.nice = nice;
      return 0;
    });
  }
};

/// What the tests rest on.
TEST_F(I915Test, TheDeviceRefusesAsTheDriverDoes) {
  with(0x2f, false);
  kernel_.run([&] {
    const Runtime runtime;
    const std::uint32_t context = runtime.context();
    EXPECT_EQ(runtime.set(context, 0, 8), EINVAL) << "a size";
    EXPECT_EQ(runtime.set(context + 1, 0), ENOENT) << "no such context";
    EXPECT_EQ(runtime.set(context, -1024), EINVAL);
    EXPECT_EQ(runtime.set(context, 1024), EINVAL);
    EXPECT_EQ(runtime.set(context, 1), EPERM);
    EXPECT_EQ(runtime.set(context, -1023), 0);
    look([](auto& state) { return state.scheduler = 0x29; });
    EXPECT_EQ(runtime.set(context, 0), ENODEV) << "a scheduler without priorities";
  });
  EXPECT_TRUE(priorities().empty()) << "closed with their file";
}

TEST_F(I915Test, TheDriverSaysHowManyLevelsThereAre) {
  struct {
    int scheduler;
    bool nice;
    int levels;
  } const cases[] = {{0x2f, true, 3}, {0x2f, false, 2}, {0x0f, true, 1024}, {0x0f, false, 1024},
                     {0x2d, true, 0}, {0x2b, true, 0},  {0x00, true, 0}};
  for (const auto& c : cases) {
    with(c.scheduler, c.nice);
    kernel_.run([&] {
      EXPECT_EQ(kernel::i915_levels(), c.levels) << c.scheduler << c.nice;
      const Xpu gpu{"gpu0", "gpu"};
      EXPECT_EQ(discipline_of(gpu, false), c.levels > 0 ? Discipline::kLevels : Discipline::kGate);
      EXPECT_EQ(levels_of(gpu, false), c.levels);
      const Platform here = platform_of(Hardware::here(), "here");
      const Xpu& found = here.xpus[static_cast<std::size_t>(here.find("gpu0"))];
      EXPECT_EQ(found.levels, c.levels);
      EXPECT_EQ(found.preemptive, c.levels > 0);
      EXPECT_TRUE(validate(here));
      std::string meaning;
      for (const kernel::Finding& f :
           kernel::probe("", kernel::Permitted::of_this_process(), devices()))
        if (f.id == "gpu") meaning = f.meaning;
      EXPECT_EQ(meaning.starts_with(c.levels > 0 ? "an Intel GPU, put on priority levels"
                                                 : "an Intel GPU, gated"),
                true)
          << meaning;
    });
  }
  EXPECT_TRUE(priorities().empty()) << "the context that was asked with is gone";
  EXPECT_EQ(kernel::i915_levels(), 0) << "there is none";
}

TEST_F(I915Test, AContextIsPutOnItsLevelAndGivenBackAsItWas) {
  kernel_.run([&] {
    const Runtime runtime;
    const std::uint32_t first = runtime.context(), second = runtime.context(false);
    EXPECT_EQ(runtime.set(second, -7), 0);
    ASSERT_EQ(kernel::find_i915_contexts().size(), 2u);
    {
      I915Contexts contexts;
      const QueueFile file = kernel::find_i915_contexts()[1];
      EXPECT_TRUE(file.target.starts_with("i915:" + std::to_string(second)));
      const auto handle = *contexts.take(file);
      EXPECT_EQ(*contexts.take(file), handle) << "taken once";
      for (const int level : {2, 0, 1}) {
        ASSERT_TRUE(contexts.level(handle, level));
        EXPECT_EQ(priorities(), (std::vector<int>{0, (level - 1) * 512}));
      }
      EXPECT_EQ(contexts.level(handle, 3).error().code, ErrorCode::kInvalid);
      EXPECT_EQ(contexts.level(handle, -1).error().code, ErrorCode::kInvalid);
      with(0x2f, false);
      const Status refused = contexts.level(handle, 2);
      ASSERT_FALSE(refused);
      EXPECT_EQ(refused.error().code, ErrorCode::kPermission);
      EXPECT_NE(refused.error().hint.find("CAP_SYS_NICE"), std::string::npos);
      EXPECT_EQ(priorities(), (std::vector<int>{0, 0})) << "where it was";
    }
    EXPECT_EQ(priorities(), (std::vector<int>{0, -7}));
    (void)first;
  });
}

TEST_F(I915Test, WithoutGucEveryPriorityIsALevelUpToTheDefault) {
  with(0x0f, false);
  kernel_.run([&] {
    const Runtime runtime;
    (void)runtime.context();
    I915Contexts contexts;
    const auto handle = *contexts.take(kernel::find_i915_contexts()[0]);
    for (const int level : {0, 5, 1023}) {
      ASSERT_TRUE(contexts.level(handle, level));
      EXPECT_EQ(priorities(), std::vector<int>{level - 1023});
    }
    EXPECT_EQ(contexts.level(handle, 1024).error().code, ErrorCode::kInvalid);
  });
}

TEST_F(I915Test, WhatIsDestroyedOrClosedIsGone) {
  kernel_.run([&] {
    Runtime runtime;
    const std::uint32_t context = runtime.context();
    I915Contexts contexts;
    const QueueFile file = kernel::find_i915_contexts()[0];
    const auto handle = *contexts.take(file);
    runtime.destroy(context);
    EXPECT_FALSE(kernel::is_open(file));
    EXPECT_EQ(contexts.level(handle, 1).error().code, ErrorCode::kUnavailable);
    EXPECT_FALSE(I915Contexts().take(file));
    EXPECT_EQ(runtime.context(), context);
    EXPECT_FALSE(kernel::is_open(file)) << "a number that is used again";
    const auto closed = *contexts.take(kernel::find_i915_contexts()[0]);
    const int number = runtime.fd.get();
    runtime.fd.reset();
    EXPECT_EQ(contexts.level(closed, 1).error().code, ErrorCode::kUnavailable);
    EXPECT_TRUE(kernel::find_i915_contexts().empty());
    // Another file with its number, which has no such context: i915 says so.
    const Runtime other;
    ASSERT_EQ(other.fd.get(), number);
    EXPECT_EQ(contexts.level(closed, 1).error().code, ErrorCode::kUnavailable);
  });
}

TEST_F(I915Test, ADriverThatFailsIsSaidAndChangesNothing) {
  kernel_.run([&] {
    const Runtime runtime;
    (void)runtime.context();
    I915Contexts contexts;
    const auto handle = *contexts.take(kernel::find_i915_contexts()[0]);
    ASSERT_TRUE(contexts.level(handle, 1));
    for (const auto& [error, code] : {std::pair{EIO, ErrorCode::kUnavailable},
                                      {ENODEV, ErrorCode::kUnavailable},
                                      {ENOMEM, ErrorCode::kIo},
                                      {EBUSY, ErrorCode::kIo}}) {
      look([error = error](auto& state) {
        state.error = error;
        return state.fail = 1;
      });
      EXPECT_EQ(contexts.level(handle, 2).error().code, code) << error;
      EXPECT_EQ(priorities(), std::vector<int>{0});
    }
    for (const int error : {EINTR, EAGAIN}) {
      look([&](auto& state) {
        state.error = error;
        return state.fail = 2;
      });
      EXPECT_TRUE(contexts.level(handle, 2)) << "asked again";
      ASSERT_TRUE(contexts.level(handle, 1));
    }
  });
}

TEST_F(I915Test, OtherDriversOfDrmAreNotTakenForIt) {
  kernel_.run([&] {
    // The same number on what is no DRM node succeeds nowhere; on a pipe it is refused.
    int ends[2];
    ASSERT_EQ(pipe(ends), 0);
    std::uint32_t args[2] = {1, 0};
    EXPECT_NE(ioctl(ends[0], 0xc008646d, args), 0);
    close(ends[0]);
    close(ends[1]);
  });
  EXPECT_TRUE(kernel::find_i915_contexts().empty());
}

TEST_F(I915Test, TheRowFindsItAndTheBackendMovesAContextWhole) {
  kernel_.run([&] {
    const Xpu gpu{"gpu0", "gpu"};
    ASSERT_EQ(kind_of("gpu").driver, "i915");
    EXPECT_TRUE(is_watched(gpu, false));
    auto backend = make_backend({gpu, {"gpu0", XPU::GPU, 0}});
    ASSERT_TRUE(backend) << backend.error().to_string();
    int context = 0;
    const SchedHandle handle = SchedHandle::cuda_context(&context);
    const Runtime runtime;
    {
      const auto around = (*backend)->before_init();
      (void)runtime.context();
      (void)runtime.context();
      ASSERT_TRUE((*backend)->attach(handle));
    }
    EXPECT_EQ(priorities(), (std::vector<int>{0, 0})) << "nobody has said a level";
    EXPECT_FALSE((*backend)->preempt(handle)) << "nobody suspends";
    EXPECT_EQ((*backend)->again_ms(true), (*backend)->again_ms(true));
    ASSERT_TRUE((*backend)->level(handle, 2));
    EXPECT_EQ(priorities(), (std::vector<int>{512, 512}));
    // What the first job opens beside is put there as soon as it is seen.
    (*backend)->admitted(handle, true);
    (void)runtime.context();
    (*backend)->finishing(handle, true);
    EXPECT_EQ(priorities(), (std::vector<int>{512, 512, 512}));
    ASSERT_TRUE((*backend)->level(handle, 0));
    EXPECT_EQ(priorities(), (std::vector<int>{-512, -512, -512}));
    look([](auto& state) { return state.fail = 1; });
    EXPECT_FALSE((*backend)->level(handle, 1));
    backend->reset();
    EXPECT_EQ(priorities(), (std::vector<int>{0, 0, 0})) << "as they were";
  });
}

TEST_F(I915Test, AnOwnerThatIsKilledLeavesNothing) {
  kill_once(
      [&](const auto& stay) {
        const Runtime runtime;
        (void)runtime.context();
        I915Contexts contexts;
        if (contexts.level(*contexts.take(kernel::find_i915_contexts()[0]), 2)) stay();
      },
      [&] { EXPECT_EQ(priorities(), std::vector<int>{512}); });
  EXPECT_TRUE(priorities().empty());
}

}  // namespace
}  // namespace xauto::xpu
