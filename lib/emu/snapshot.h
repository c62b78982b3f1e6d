// SPDX-License-Identifier: Apache-2.0
// What of the emulated devices outlives the emulator, and its form as bytes. Not in it: who waits
// for what. Connections end with the process; whoever still waits asks again (client.cc).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include <xauto/result.h>

#include "emu/machine.h"
#include "model/platform.h"

namespace xauto::emu {

inline constexpr std::size_t kMaxDevices = kMaxXpus + 1;  ///< and the pool of all CPUs

struct DeviceRecord {
  std::uint64_t name = 0;  ///< a hash of it: the memory of another platform is not ours
  Nanos now = 0, blocked_until = 0, switch_until = 0, slice_left = 0;
  std::uint64_t block = 0;
  Nanos busy_ns = 0, overhead_ns = 0;
  std::uint64_t switches = 0, preemptions = 0, jobs = 0;
  std::uint32_t contexts = 0;   ///< how many of the records are its own
  std::uint32_t on_device = 0;  ///< the first of them has begun its slice
};

/// Those of one device lie together: first those that can run, in their order, then the others.
struct ContextRecord {
  ContextId id = 0;
  std::uint8_t busy = 0, suspended = 0;
  std::uint16_t level = 0;
  std::uint64_t tag = 0;  ///< of the job, or of the last one
  Nanos left = 0;         ///< in kUnits per ns of work
  std::uint64_t block = 0;
  std::uint64_t key = 0;  ///< the server's: what its owner shows to have it back
  std::int32_t pid = 0;   ///< the server's: the owner's process; 0: not known
  std::uint32_t zero = 0;
};
static_assert(sizeof(DeviceRecord) == 96 && std::is_trivially_copyable_v<DeviceRecord>);
static_assert(sizeof(ContextRecord) == 48 && std::is_trivially_copyable_v<ContextRecord>);

struct Snapshot {
  ContextId next_id = 1;
  Nanos script_begin =
      -1;  ///< when the first work came, from which the script counts; -1: none yet
  std::vector<DeviceRecord> devices;
  std::vector<ContextRecord> contexts;

  [[nodiscard]] std::size_t bytes() const;
  /// `out` has at least bytes().
  void encode(std::byte* out) const;
  /// Checks the form only: lengths and counts. What they mean is Machine::restore's business.
  [[nodiscard]] static Result<Snapshot> decode(std::span<const std::byte> data);
};
inline constexpr std::size_t kMaxSnapshotBytes =
    24 + kMaxDevices * sizeof(DeviceRecord) + kMaxContexts * sizeof(ContextRecord);

}  // namespace xauto::emu
