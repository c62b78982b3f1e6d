// SPDX-License-Identifier: Apache-2.0
// What crosses from host to host, as bytes: a message of a topic with its release, or that there is none of it.
//
//   Head │ origins, `num_origins` of 8 bytes │ payload
//
// Instants are nanoseconds after the run's start, which each part reads on its own clock. Parts are of one version for
// one kind of machine (the meeting asks), and of one program (nobody asks), so numbers lie as they do in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "model/message.h"

namespace xauto::parts {

struct CrossingHead {
  std::uint64_t run = 0;  ///< of the parts that have met; another one's is none of ours
  std::uint64_t first =
      0;  ///< it stands for releases first..number: without a payload none of them has a result
  std::uint64_t number = 0;
  std::int64_t nominal_ns = 0;  ///< of `number`, of the sender's component
  bool payload = false;
  bool urgent = false;
  /// Without a payload: 0, or why nothing was lost (detail::kOffNs, detail::kSkippedNs).
  std::int64_t reason = 0;
  detail::Origins origins{};  ///< by source, after the start; kNoOrigin: it is not in it
  bool operator==(const CrossingHead&) const = default;
};
inline constexpr std::int64_t kNoOrigin = INT64_MIN;
/// Releases that one message may stand for.
inline constexpr std::uint64_t kMostAtOnce = 1U << 20U;
/// What comes before the payload, at most.
inline constexpr std::size_t kHeadBytes = 48 + 8 * detail::kMaxOrigins;

[[nodiscard]] std::vector<std::byte> encode(const CrossingHead& head,
                                            std::span<const std::byte> payload);
struct CrossingMessage {
  CrossingHead head;
  std::vector<std::byte> payload;
};
/// Nullopt: it is no such message. Never throws but for memory; a payload is as long as what came.
[[nodiscard]] std::optional<CrossingMessage> decode(std::span<const std::byte> bytes);

}  // namespace xauto::parts
