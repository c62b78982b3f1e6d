// SPDX-License-Identifier: Apache-2.0
#include "trace/trace.h"

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

TEST(Trace, CountsWhatDidNotFit) {
  auto file = make_memory_file("trace");
  auto writer = Writer::create(file->get(), 10);
  for (std::uint64_t i = 0; i < 25; ++i) (*writer)->write(XAUTO_EV_RUN, i, 0, 0, 0);
  const auto recording = read(file->get());
  EXPECT_EQ(recording->events.size(), 10u);
  EXPECT_EQ(recording->lost, 15u);
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

}  // namespace
}  // namespace xauto::trace
