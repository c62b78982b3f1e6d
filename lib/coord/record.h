// SPDX-License-Identifier: Apache-2.0
// Who has had an XPU that several runs share, and when: for people. Memory of its own, of the machine's service, that
// outlives coordinators; who is trusted writes there of its own jobs, the coordinator of the others', and who looks can
// only read it. Nothing is decided by it.
//
// A slot of it is a worker's slot (shm_layout.h). [W] the worker of the slot, or where its run is not trusted the
// coordinator; [C] the coordinator.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "coord/arbiter.h"

namespace xauto::coord {

/// A job has had the XPU from here to there, CLOCK_MONOTONIC; others may have had it in between.
struct RecordedTime {
  std::uint32_t lease = 0;
  std::int64_t begin_ns = 0, end_ns = 0;
};

struct alignas(64) RecordSlot {
  static constexpr std::size_t kKept = 32;  ///< of the times the last ones
  struct Time {
    std::atomic<std::int64_t> begin_ns{}, end_ns{};
  };
  std::atomic<std::uint32_t> lease{};   ///< [C] whose worker has the slot; 0: nobody's
  std::atomic<std::uint64_t> had_ns{};  ///< [W] of all that is over since, without what others had
  std::atomic<std::uint64_t> times{};   ///< [W] so many are over; the n-th is `kept`[n % kKept]
  Time kept[kKept];

  /// [W]
  void add(std::int64_t begin_ns, std::int64_t end_ns, std::int64_t had);
  /// [C] Another worker, or with 0 none, has the slot.
  void give(std::uint32_t to);
};

/// The memory of one XPU, mapped. Threads: any; who writes, see above.
class Record {
 public:
  static constexpr std::size_t kBytes = kMaxSlots * sizeof(RecordSlot);

  Record() = default;
  /// kInvalid: it is no such memory.
  [[nodiscard]] static Result<Record> map(int fd, bool writable);
  Record(Record&& other) noexcept : slots_(std::exchange(other.slots_, nullptr)), id_(other.id_) {}
  Record& operator=(Record&& other) noexcept {
    std::swap(slots_, other.slots_);
    std::swap(id_, other.id_);
    return *this;
  }
  ~Record();

  explicit operator bool() const { return slots_ != nullptr; }
  /// Two of one memory have the same.
  [[nodiscard]] std::uint64_t id() const { return id_; }
  [[nodiscard]] RecordSlot& slot(int index) const { return slots_[index]; }

  struct Had {
    std::int64_t ns = 0;
    std::uint64_t times = 0;
  };
  /// Of the workers of this lease that are there. What one has just ended may be missing.
  [[nodiscard]] Had had(std::uint32_t lease) const;
  /// Of all workers but those of this lease.
  [[nodiscard]] std::int64_t others_ns(std::uint32_t lease) const;

 private:
  RecordSlot* slots_ = nullptr;
  std::uint64_t id_ = 0;
};

/// Follows one record from the first look on. Threads: one.
class RecordReader {
 public:
  /// What has ended since the last look is appended; the first look finds nothing.
  void look(const Record& record, std::vector<RecordedTime>& out);
  /// So many went by between two looks, and are not known.
  [[nodiscard]] std::uint64_t missed() const { return missed_; }

 private:
  struct Seen {
    std::uint32_t lease = 0;
    std::uint64_t times = 0;
  };
  std::vector<Seen> seen_;
  std::uint64_t missed_ = 0;
};

}  // namespace xauto::coord
