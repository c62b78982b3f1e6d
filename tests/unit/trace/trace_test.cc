// SPDX-License-Identifier: Apache-2.0
#include "trace/trace.h"

#include <atomic>
#include <thread>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include "base/memory_file.h"

namespace xauto::trace {
namespace {

TEST(Trace, ReadsBackWhatManyThreadsWrote) {
  auto file = make_memory_file("trace");
  auto writer = Writer::create(file->get(), 10'000);
  ASSERT_TRUE(writer);
  std::vector<std::thread> threads;
  for (std::uint16_t t = 0; t < 4; ++t)
    threads.emplace_back([&, t] {
      for (std::uint64_t i = 0; i < 1000; ++i) (*writer)->write(XAUTO_EV_RUN, i, t, 1, 2, 3);
    });
  for (std::thread& thread : threads) thread.join();
  const auto recording = read(file->get());
  ASSERT_TRUE(recording);
  EXPECT_EQ(recording->lost, 0u);
  EXPECT_EQ(recording->overwritten, 0u);
  ASSERT_EQ(recording->events.size(), 4000u);
  std::uint64_t next[4] = {};
  for (std::size_t i = 0; i < 4000; ++i) {
    const Event& e = recording->events[i];
    EXPECT_EQ(e.seq, next[e.xnode]++);  // each thread's events stay in order
    if (i > 0) {
      EXPECT_GE(e.ts_ns, recording->events[i - 1].ts_ns);
    }
  }
}

TEST(Trace, KeepsTheNewestAndCountsWhatItDropped) {
  auto file = make_memory_file("trace");
  auto writer = Writer::create(file->get(), 10);
  for (std::uint64_t i = 0; i < 25; ++i) (*writer)->write(XAUTO_EV_RUN, i, 0, 0, 0);
  const auto recording = read(file->get());
  ASSERT_EQ(recording->events.size(), 10u);
  for (std::size_t i = 0; i < 10; ++i) EXPECT_EQ(recording->events[i].seq, 15 + i);
  EXPECT_EQ(recording->lost, 0u);
  EXPECT_EQ(recording->overwritten, 15u);
}

/// Of a written event every field follows from two numbers, so that one put together from two
/// events is recognised.
std::uint16_t field(std::uint64_t seq, std::uint16_t thread, int number) {
  return static_cast<std::uint16_t>((seq * 7 + thread * 31 + static_cast<unsigned>(number)) &
                                    0xfff);
}

TEST(Trace, ManyThreadsGoRoundWhileItIsRead) {
  constexpr std::uint64_t kCapacity = 64, kPerThread = 20'000;
  constexpr int kThreads = 4;
  auto file = make_memory_file("trace");
  auto writer = Writer::create(file->get(), kCapacity);
  std::vector<std::thread> threads;
  std::atomic<int> left{kThreads};
  for (std::uint16_t t = 0; t < kThreads; ++t)
    threads.emplace_back([&, t] {
      for (std::uint64_t i = 0; i < kPerThread; ++i)
        (*writer)->write(XAUTO_EV_RUN, i, t, field(i, t, 1), field(i, t, 2),
                         static_cast<std::uint32_t>(field(i, t, 3)));
      --left;
    });
  const auto check = [&](const Recording& recording) {
    std::uint64_t next[kThreads] = {};
    for (const Event& e : recording.events) {
      ASSERT_LT(e.xnode, kThreads);
      ASSERT_EQ(e.kind, XAUTO_EV_RUN);
      ASSERT_EQ(e.module, field(e.seq, e.xnode, 1));
      ASSERT_EQ(e.xpu, field(e.seq, e.xnode, 2));
      ASSERT_EQ(e.arg, field(e.seq, e.xnode, 3));
      ASSERT_EQ(e.stamp, 0u);
      ASSERT_GE(e.seq + 1, next[e.xnode]);  // each thread's events stay in order, none comes twice
      next[e.xnode] = e.seq + 2;
    }
  };
  int reads = 0;
  do {
    const auto recording = read(file->get());
    ASSERT_TRUE(recording);
    ASSERT_LE(recording->events.size() + recording->lost, kCapacity);
    check(*recording);
    ++reads;
  } while (left > 0);
  for (std::thread& thread : threads) thread.join();
  const auto recording = read(file->get());
  check(*recording);
  // Every event is either here, given up, or older than what is here.
  EXPECT_EQ(recording->events.size() + recording->lost, kCapacity);
  EXPECT_EQ(recording->overwritten, kThreads * kPerThread - kCapacity);
  EXPECT_GE(reads, 1);
}

TEST(Trace, TellsOfMissesAndHangsFromOutside) {
  auto file = make_memory_file("trace");
  EXPECT_EQ(alarms(file->get()).misses, 0u);  // there is no buffer yet
  auto writer = Writer::create(file->get(), 4);
  for (int i = 0; i < 9; ++i) (*writer)->write(XAUTO_EV_MISS, 1, 0, 0, 0, 12'000);
  (*writer)->write(XAUTO_EV_HANG, 1, 0, 0, 0, 50);
  (*writer)->write(XAUTO_EV_RUN, 1, 0, 0, 0);
  EXPECT_EQ(alarms(file->get()).misses, 9u);
  EXPECT_EQ(alarms(file->get()).hangs, 1u);
}

TEST(Trace, EmptyFileIsAnEmptyRecording) {
  auto file = make_memory_file("trace");
  EXPECT_TRUE(read(file->get())->events.empty());
}

TEST(Trace, RefusesDamagedHeaders) {
  auto file = make_memory_file("trace");
  ASSERT_TRUE(write_memory_file(file->get(), "short"));
  EXPECT_FALSE(read(file->get()));
  ASSERT_TRUE(write_memory_file(file->get(), std::string(1000, 'x')));
  EXPECT_FALSE(read(file->get()));
  // A capacity beyond the file's end must not be believed.
  ASSERT_TRUE(Writer::create(file->get(), 100));
  ASSERT_EQ(ftruncate(file->get(), sizeof(Header) + 10 * sizeof(Event)), 0);
  EXPECT_FALSE(read(file->get()));
  EXPECT_FALSE(Writer::create(file->get(), 0));
  EXPECT_FALSE(Writer::create(file->get(), kMaxEvents + 1));
}

/// An app is linked with a library of its own, which may be another one than the tool's.
TEST(Trace, OneOfAnotherVersionIsNamed) {
  auto file = make_memory_file("trace");
  ASSERT_TRUE(Writer::create(file->get(), 100));
  const std::uint32_t other = XAUTO_EVENT_VERSION + 1;
  ASSERT_EQ(pwrite(file->get(), &other, sizeof other, offsetof(Header, version)),
            static_cast<ssize_t>(sizeof other));
  const auto found = read(file->get());
  ASSERT_FALSE(found);
  EXPECT_NE(found.error().to_string().find("is of version " + std::to_string(other)),
            std::string::npos)
      << found.error().to_string();
  EXPECT_FALSE(Writer::attach(file->get()));
}

}  // namespace
}  // namespace xauto::trace
