// SPDX-License-Identifier: Apache-2.0
// Who has had an XPU: what is written is read, once, or it is missed and counted; nothing is made up.
#include "coord/record.h"

#include <algorithm>
#include <atomic>
#include <thread>

#include <gtest/gtest.h>

#include "base/memory_file.h"

namespace xauto::coord {
namespace {

struct Memory {
  UniqueFd fd = sealed_memory("record", Record::kBytes).value();
  Record record = Record::map(fd.get(), true).value();
  Record shown = Record::map(read_only(fd.get()).value().get(), false).value();
};

TEST(Record, OfEachLeaseWhatItsWorkersHaveHad) {
  Memory m;
  m.record.slot(0).give(7);
  m.record.slot(5).give(7);
  m.record.slot(6).give(8);
  m.record.slot(0).add(100, 150, 40);
  m.record.slot(5).add(200, 230, 30);
  m.record.slot(6).add(300, 301, 1);
  EXPECT_EQ(m.shown.had(7).ns, 70);
  EXPECT_EQ(m.shown.had(7).times, 2U);
  EXPECT_EQ(m.shown.others_ns(7), 1);
  EXPECT_EQ(m.shown.others_ns(9), 71);
  m.record.slot(5).give(8);  // another worker's from now on
  EXPECT_EQ(m.shown.had(7).ns, 40);
  EXPECT_EQ(m.shown.had(8).ns, 1);
  m.record.slot(0).give(0);
  EXPECT_EQ(m.shown.others_ns(8), 0);
  EXPECT_EQ(m.shown.id(), m.record.id());
}

TEST(Record, IsNoOtherMemory) {
  const UniqueFd small = sealed_memory("record", 4096).value();
  EXPECT_FALSE(Record::map(small.get(), false));
  EXPECT_FALSE(Record::map(-1, false));
  const Memory m;
  EXPECT_FALSE(Record::map(read_only(m.fd.get()).value().get(), true)) << "by who may only read";
}

TEST(Record, WhoLooksSeesWhatEndedSinceAndCountsWhatWentBy) {
  Memory m;
  m.record.slot(3).give(1);
  m.record.slot(3).add(10, 20, 10);
  RecordReader reader;
  std::vector<RecordedTime> seen;
  reader.look(m.shown, seen);
  EXPECT_TRUE(seen.empty()) << "from before";
  for (std::int64_t t = 100; t < 110; ++t) m.record.slot(3).add(t, t + 1, 1);
  reader.look(m.shown, seen);
  ASSERT_EQ(seen.size(), 10U);
  EXPECT_EQ(seen[9].begin_ns, 109);
  EXPECT_EQ(reader.missed(), 0U);
  seen.clear();
  for (std::int64_t t = 200; t < 300; ++t) m.record.slot(3).add(t, t + 1, 1);
  reader.look(m.shown, seen);
  EXPECT_EQ(seen.size() + reader.missed(), 100U);
  EXPECT_EQ(seen.back().begin_ns, 299);
  seen.clear();
  m.record.slot(3).give(2);
  m.record.slot(3).add(400, 401, 1);
  reader.look(m.shown, seen);
  ASSERT_EQ(seen.size(), 1U);
  EXPECT_EQ(seen[0].lease, 2U);
}

TEST(Record, WhatAWorkerMayWriteIsNoTime) {
  Memory m;
  RecordReader reader;
  std::vector<RecordedTime> seen;
  reader.look(m.shown, seen);
  m.record.slot(0).give(1);
  m.record.slot(0).add(50, 40, -10);
  m.record.slot(0).add(-5, 40, 45);
  m.record.slot(0).add(INT64_MIN, INT64_MAX, 0);
  reader.look(m.shown, seen);
  EXPECT_TRUE(seen.empty());
  m.record.slot(0).times.store(UINT64_MAX);  // of a worker that lies
  reader.look(m.shown, seen);
  m.record.slot(0).times.store(3);
  reader.look(m.shown, seen);
  EXPECT_LE(seen.size(), 2 * RecordSlot::kKept);
}

/// A writer as fast as it can, beside one who looks: each time that is read was written, once, and all others are counted.
TEST(Record, OneWritesWhileAnotherLooks) {
  constexpr std::int64_t kTimes = 300'000;
  Memory m;
  RecordReader reader;
  std::vector<RecordedTime> seen;
  m.record.slot(0).give(1);
  reader.look(m.shown, seen);
  std::atomic<bool> over{false};
  std::thread writer([&] {
    for (std::int64_t n = 1; n <= kTimes; ++n) m.record.slot(0).add(n, 3 * n, 1);
    over.store(true);
  });
  for (bool last = false; !last;) {
    last = over.load();
    reader.look(m.shown, seen);
  }
  writer.join();
  std::int64_t before = 0;
  for (const RecordedTime& time : seen) {
    EXPECT_GT(time.begin_ns, before);
    EXPECT_EQ(time.end_ns, 3 * time.begin_ns) << "of two writes";
    before = time.begin_ns;
  }
  EXPECT_EQ(seen.size() + reader.missed(), static_cast<std::size_t>(kTimes));
}

}  // namespace
}  // namespace xauto::coord
