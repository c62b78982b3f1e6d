// SPDX-License-Identifier: Apache-2.0
// What comes to the part of the first host over TCP, from anybody who may connect. Byte 0 of each piece: who sends it, and how long
// after the one before; then 2 bytes of length, and that. Whatever comes: a start is agreed once, and nobody is known who did not say
// hello as one of the hosts.
#include <cstring>
#include <map>

#include "launch/meeting_table.h"

#include "json_property.h"

using namespace xauto;
using namespace xauto::launch;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  MeetingTable::Instant now{0, 1000};
  MeetingTable table({.own = {"front", "h", 37},
                      .hosts = {"front", "rear", "third"},
                      .fresh_run = 7,
                      .limit_ns = 1'000'000'000,
                      .most_apart_ns = 5'000'000},
                     now);
  (void)table.own(PartStage::kReady, now);
  std::map<int, FrameReader> frames;
  std::span bytes(reinterpret_cast<const std::byte*>(data), size);
  while (bytes.size() >= 3) {
    const auto first = std::to_integer<int>(bytes[0]);
    const std::size_t length =
        std::min<std::size_t>(bytes.size() - 3, std::to_integer<std::size_t>(bytes[1]) |
                                                    std::to_integer<std::size_t>(bytes[2]) << 8U);
    const int connection = first % 4;
    now.now_ns += (first / 4) * 10'000'000;
    now.tai_ns += (first / 4) * 10'000'000;
    const std::uint64_t run = table.run();
    const std::int64_t start = table.start_tai_ns();
    if (!frames.contains(connection)) (void)table.connected(connection, now);
    FrameReader& reader = frames[connection];
    reader.feed(bytes.subspan(3, length));
    bytes = bytes.subspan(3 + length);
    while (const auto message =
               reader.next(table.known(connection) ? kMostReportBytes : kMostFrameBytes))
      for (const auto& say : table.hear(connection, *message, now))
        fuzz::require(frame_of(say.what).size() <= kMostFrameBytes + 4,
                      "what we say fits into a frame");
    if (reader.bad()) {
      (void)table.gone(connection, now);
      frames.erase(connection);
    }
    (void)table.tick(now);
    (void)table.take_news();
    fuzz::require(run == 0 || table.run() == run, "a run is agreed once");
    fuzz::require(start == 0 || table.start_tai_ns() == start, "a start is agreed once");
    for (const auto& [host, text] : table.reports())
      fuzz::require(host == "rear" || host == "third", "only a host reports");
  }
  return 0;
}
