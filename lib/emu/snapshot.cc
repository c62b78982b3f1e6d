// SPDX-License-Identifier: Apache-2.0
#include "emu/snapshot.h"

#include <cstring>

namespace xauto::emu {
namespace {

struct Counts {
  std::uint32_t devices, contexts, next_id, zero;
  Nanos script_begin;
};
static_assert(sizeof(Counts) == 24);

}  // namespace

std::size_t Snapshot::bytes() const {
  return sizeof(Counts) + devices.size() * sizeof(DeviceRecord) +
         contexts.size() * sizeof(ContextRecord);
}

void Snapshot::encode(std::byte* out) const {
  const Counts counts{static_cast<std::uint32_t>(devices.size()),
                      static_cast<std::uint32_t>(contexts.size()), next_id, 0, script_begin};
  std::memcpy(out, &counts, sizeof counts);
  out += sizeof counts;
  if (!devices.empty()) std::memcpy(out, devices.data(), devices.size() * sizeof(DeviceRecord));
  out += devices.size() * sizeof(DeviceRecord);
  if (!contexts.empty()) std::memcpy(out, contexts.data(), contexts.size() * sizeof(ContextRecord));
}

Result<Snapshot> Snapshot::decode(std::span<const std::byte> data) {
  Counts counts{};
  if (data.size() < sizeof counts) return fail(ErrorCode::kInvalid, "it is cut short");
  std::memcpy(&counts, data.data(), sizeof counts);
  if (counts.devices > kMaxDevices || counts.contexts > kMaxContexts || counts.zero != 0)
    return fail(ErrorCode::kInvalid, "its counts are impossible");
  Snapshot snapshot;
  snapshot.next_id = counts.next_id;
  snapshot.script_begin = counts.script_begin;
  snapshot.devices.resize(counts.devices);
  snapshot.contexts.resize(counts.contexts);
  if (data.size() != snapshot.bytes()) return fail(ErrorCode::kInvalid, "its length is wrong");
  const std::byte* from = data.data() + sizeof counts;
  const std::size_t device_bytes = counts.devices * sizeof(DeviceRecord);
  if (counts.devices > 0) std::memcpy(snapshot.devices.data(), from, device_bytes);
  if (counts.contexts > 0)
    std::memcpy(snapshot.contexts.data(), from + device_bytes,
                counts.contexts * sizeof(ContextRecord));
  return snapshot;
}

}  // namespace xauto::emu
