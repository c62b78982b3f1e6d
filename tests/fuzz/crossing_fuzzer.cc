// SPDX-License-Identifier: Apache-2.0
// What comes from another host over DDS, which anybody on the network may send. Whatever comes: what is decoded is encoded to
// the same bytes, no release is handed on twice or out of order, none that came after its X, and nothing is stored without end.
#include <cstring>
#include <map>

#include "json_property.h"
#include "parts/crossing_message.h"
#include "parts/crossing_reader.h"

namespace {

using namespace xauto;
using namespace xauto::parts;

void check_message(std::span<const std::byte> bytes) {
  const auto message = decode(bytes);
  if (!message) return;
  const auto again = decode(encode(message->head, message->payload));
  fuzz::require(again && again->head == message->head && again->payload == message->payload,
                "what is decoded can be sent on");
  fuzz::require(message->payload.size() <= bytes.size(), "a payload is part of what came");
}

/// Each 4 bytes: which message comes, and how much later.
void check_reader(std::span<const std::byte> bytes) {
  const CrossingReader::Rule rule{.releases = {.period = {1000, 3}, .offset_ns = 500},
                                  .key_us = {300, 400, 310},
                                  .x_us = 100,
                                  .urgent_by_us = 50};
  CrossingReader reader(rule, 3);
  std::uint64_t next = 3;
  std::int64_t now = 0;
  std::map<std::uint64_t, std::int64_t> came;  // when: of what was in time
  const auto deliver = [&](const detail::Envelope& envelope) {
    const std::uint64_t number = envelope.sequence;
    fuzz::require(number == next++, "each release once, in order");
    if (envelope.message == nullptr) return;
    fuzz::require(came.contains(number) && came[number] <= rule.by_ns(number, envelope.urgent),
                  "what is handed on was there by its X");
  };
  for (; bytes.size() >= 4; bytes = bytes.subspan(4)) {
    const auto byte = [&](std::size_t i) { return std::to_integer<std::uint64_t>(bytes[i]); };
    now += static_cast<std::int64_t>(byte(0) * byte(0) * 20);
    const std::uint64_t number =
        byte(1) < 250 ? next + byte(1) % 80 - std::min<std::uint64_t>(next, 5) : byte(1) << 56U;
    const bool tombstone = byte(2) % 4 == 0;
    detail::Envelope envelope{tombstone ? nullptr : std::make_shared<const int>(1), 0, number};
    envelope.urgent = byte(2) % 5 == 0;
    const std::int64_t nominal = byte(3) == 0    ? 7
                                 : byte(1) < 250 ? rule.releases.due_ns(number)
                                                 : 0;
    if (reader.arrive(tombstone ? number - std::min(number, byte(3)) : number, envelope, nominal,
                      now))
      came.emplace(number, now);
    if (byte(2) % 3 != 0) reader.pass(now, deliver);
  }
  reader.end(rule.releases.due_ns(next));
  const auto& count = reader.count();
  fuzz::require(count.lost + count.none <= count.expected && count.late <= count.lost,
                "counts fit");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::span bytes(reinterpret_cast<const std::byte*>(data), size);
  check_message(bytes);
  check_reader(bytes);
  return 0;
}
