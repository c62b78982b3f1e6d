// SPDX-License-Identifier: Apache-2.0
#include "coord/record.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>

#include <sys/mman.h>
#include <sys/stat.h>

namespace xauto::coord {

// One thread writes a slot: no read-modify-write is needed.
void RecordSlot::add(std::int64_t begin_ns, std::int64_t end_ns, std::int64_t had) {
  const std::uint64_t n = times.load(std::memory_order_relaxed);
  std::atomic_thread_fence(
      std::memory_order_release);  // who sees what is written now sees `times`, too
  Time& time = kept[n % kKept];
  time.begin_ns.store(begin_ns, std::memory_order_relaxed);
  time.end_ns.store(end_ns, std::memory_order_relaxed);
  had_ns.store(had_ns.load(std::memory_order_relaxed) + static_cast<std::uint64_t>(had),
               std::memory_order_relaxed);
  times.store(n + 1, std::memory_order_release);
}

void RecordSlot::give(std::uint32_t to) {
  lease.store(0, std::memory_order_release);  // what is written now is of nobody
  times.store(0, std::memory_order_relaxed);
  had_ns.store(0, std::memory_order_relaxed);
  lease.store(to, std::memory_order_release);
}

Result<Record> Record::map(int fd, bool writable) {
  struct stat status {};
  if (fstat(fd, &status) != 0 || static_cast<std::size_t>(status.st_size) != kBytes)
    return fail(ErrorCode::kInvalid, "is not the record of an XPU", "memory");
  void* memory = mmap(nullptr, kBytes, writable ? PROT_READ | PROT_WRITE : PROT_READ,
                      MAP_SHARED | MAP_POPULATE, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map the record: ") + strerror(errno));
  Record record;
  record.slots_ = static_cast<RecordSlot*>(memory);
  record.id_ = status.st_ino;
  return record;
}

Record::~Record() {
  if (slots_ != nullptr) munmap(slots_, kBytes);
}

Record::Had Record::had(std::uint32_t lease) const {
  Had sum;
  for (int i = 0; i < kMaxSlots; ++i) {
    const RecordSlot& slot = slots_[i];
    if (slot.lease.load(std::memory_order_acquire) != lease) continue;
    sum.times += slot.times.load(std::memory_order_acquire);
    sum.ns += static_cast<std::int64_t>(slot.had_ns.load(std::memory_order_relaxed));
  }
  return sum;
}

std::int64_t Record::others_ns(std::uint32_t lease) const {
  std::int64_t sum = 0;
  for (int i = 0; i < kMaxSlots; ++i) {
    const std::uint32_t whose = slots_[i].lease.load(std::memory_order_relaxed);
    if (whose != 0 && whose != lease)
      sum += static_cast<std::int64_t>(slots_[i].had_ns.load(std::memory_order_relaxed));
  }
  return sum;
}

void RecordReader::look(const Record& record, std::vector<RecordedTime>& out) {
  const bool first = seen_.empty();
  seen_.resize(kMaxSlots);
  for (int i = 0; i < kMaxSlots; ++i) {
    const RecordSlot& slot = record.slot(i);
    Seen& seen = seen_[static_cast<std::size_t>(i)];
    const std::uint32_t lease = slot.lease.load(std::memory_order_acquire);
    const std::uint64_t times = slot.times.load(std::memory_order_acquire);
    if (lease != seen.lease || times < seen.times) seen = {lease, first ? times : 0};
    if (lease == 0) continue;
    std::uint64_t from = seen.times;
    if (times - from > RecordSlot::kKept) from = times - RecordSlot::kKept;
    const std::size_t begin = out.size();
    for (std::uint64_t n = from; n < times; ++n) {
      const RecordSlot::Time& time = slot.kept[n % RecordSlot::kKept];
      out.push_back({lease, time.begin_ns.load(std::memory_order_relaxed),
                     time.end_ns.load(std::memory_order_relaxed)});
    }
    // What was written meanwhile is over the oldest of them; of another worker all is void.
    std::atomic_thread_fence(std::memory_order_acquire);
    const std::uint64_t now = slot.times.load(std::memory_order_relaxed);
    const bool same = slot.lease.load(std::memory_order_relaxed) == lease && now >= times;
    const std::uint64_t oldest = !same                         ? times
                                 : now + 1 > RecordSlot::kKept ? now + 1 - RecordSlot::kKept
                                                               : 0;
    if (oldest > from) {
      const auto lost = static_cast<std::ptrdiff_t>(std::min(oldest, times) - from);
      out.erase(out.begin() + static_cast<std::ptrdiff_t>(begin),
                out.begin() + static_cast<std::ptrdiff_t>(begin) + lost);
      from = std::min(oldest, times);
    }
    missed_ += from - seen.times;
    seen.times = times;
  }
  // A worker may have written anything.
  std::erase_if(out, [](const RecordedTime& time) {
    return time.begin_ns <= 0 || time.end_ns < time.begin_ns;
  });
}

}  // namespace xauto::coord
