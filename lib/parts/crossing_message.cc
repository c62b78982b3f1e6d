// SPDX-License-Identifier: Apache-2.0
#include "parts/crossing_message.h"

#include <cstring>

namespace xauto::parts {
namespace {

constexpr std::uint32_t kMagic = 0x31524358;  // "XCR1"
constexpr std::uint32_t kPayload = 1, kUrgent = 2, kOff = 4, kSkipped = 8, kKnown = 15;

struct Fixed {
  std::uint32_t magic = kMagic, flags = 0;
  std::uint64_t run = 0, first = 0, number = 0;
  std::int64_t nominal_ns = 0;
  std::uint32_t num_origins = 0, zero = 0;
};
static_assert(sizeof(Fixed) == 48 && sizeof(Fixed) + 8 * detail::kMaxOrigins == kHeadBytes);

std::uint32_t flags_of(const CrossingHead& head) {
  return (head.payload ? kPayload : 0) | (head.urgent ? kUrgent : 0) |
         (head.reason == detail::kOffNs ? kOff : 0) |
         (head.reason == detail::kSkippedNs ? kSkipped : 0);
}

bool possible(const Fixed& fixed) {
  const bool payload = (fixed.flags & kPayload) != 0;
  const std::uint32_t reasons = fixed.flags & (kOff | kSkipped);
  if (fixed.magic != kMagic || fixed.zero != 0 || (fixed.flags & ~kKnown) != 0) return false;
  if (reasons == (kOff | kSkipped) || (payload && reasons != 0)) return false;
  return fixed.num_origins <= detail::kMaxOrigins && fixed.first <= fixed.number &&
         fixed.number - fixed.first < kMostAtOnce && fixed.number < UINT64_MAX / 2 &&
         (!payload || fixed.first == fixed.number) && fixed.nominal_ns >= 0;
}

}  // namespace

std::vector<std::byte> encode(const CrossingHead& head, std::span<const std::byte> payload) {
  Fixed fixed{.flags = flags_of(head),
              .run = head.run,
              .first = head.first,
              .number = head.number,
              .nominal_ns = head.nominal_ns};
  for (std::size_t s = 0; s < head.origins.size(); ++s)
    if (head.origins[s] != kNoOrigin) fixed.num_origins = static_cast<std::uint32_t>(s) + 1;
  const std::size_t origins = fixed.num_origins * sizeof(std::int64_t);
  std::vector<std::byte> bytes(sizeof fixed + origins + payload.size());
  std::memcpy(bytes.data(), &fixed, sizeof fixed);
  if (origins > 0) std::memcpy(bytes.data() + sizeof fixed, head.origins.data(), origins);
  if (!payload.empty())
    std::memcpy(bytes.data() + sizeof fixed + origins, payload.data(), payload.size());
  return bytes;
}

std::optional<CrossingMessage> decode(std::span<const std::byte> bytes) {
  Fixed fixed;
  if (bytes.size() < sizeof fixed) return std::nullopt;
  std::memcpy(&fixed, bytes.data(), sizeof fixed);
  const std::size_t origins = fixed.num_origins * sizeof(std::int64_t);
  if (!possible(fixed) || bytes.size() - sizeof fixed < origins) return std::nullopt;
  CrossingMessage message;
  CrossingHead& head = message.head;
  head.run = fixed.run;
  head.first = fixed.first;
  head.number = fixed.number;
  head.nominal_ns = fixed.nominal_ns;
  head.payload = (fixed.flags & kPayload) != 0;
  head.urgent = (fixed.flags & kUrgent) != 0;
  head.reason = (fixed.flags & kOff) != 0       ? detail::kOffNs
                : (fixed.flags & kSkipped) != 0 ? detail::kSkippedNs
                                                : 0;
  head.origins.fill(kNoOrigin);
  if (origins > 0) std::memcpy(head.origins.data(), bytes.data() + sizeof fixed, origins);
  const std::span<const std::byte> rest = bytes.subspan(sizeof fixed + origins);
  if (!head.payload && !rest.empty()) return std::nullopt;
  message.payload.assign(rest.begin(), rest.end());
  return message;
}

}  // namespace xauto::parts
