// SPDX-License-Identifier: Apache-2.0
// The one event record's writer and reader: a flight recorder. The buffer is a ring of slots in a
// memfd, so that it keeps the newest events, and the parent reads it even if the writer was killed.
//
// A writer claims the next index by one fetch_add; slot = index % capacity. It then takes the slot
// by one compare-and-swap of its stamp, writes the event and gives the slot back, so it never
// waits:
//
//   stamp   lap * 2 + 1   a writer of this lap is in the slot (lap = index / capacity + 1)
//           lap * 2       the event of this lap is in it; 0: none yet
//
// A writer that finds its slot taken, or already ahead of it, was asleep for a whole lap or meets
// one that was: it gives its own event up and counts it. One that is killed inside a slot costs
// that slot. A reader takes an event only if the stamp was this lap's before and after its copy.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include <uapi/xauto/event.h>

#include <xauto/result.h>

namespace xauto::trace {

using Event = ::xauto_event;
static_assert(sizeof(Event) == 32);

inline constexpr std::uint32_t kMagic = 0x58545243;  // "XTRC"
inline constexpr std::uint64_t kMaxEvents = 64u << 20;

/// Start of the shared buffer; the slots follow it.
struct Header {
  std::uint32_t magic = 0;
  std::uint32_t version = 0;
  std::uint64_t capacity = 0;            ///< slots
  std::atomic<std::uint64_t> claimed{};  ///< indices handed out
  std::atomic<std::uint64_t> misses{};   ///< XAUTO_EV_MISS written
  std::atomic<std::uint64_t> hangs{};    ///< XAUTO_EV_HANG written
  std::uint64_t pad[3] = {};
};
static_assert(sizeof(Header) == 64);

/// Threads: `write` from any thread. Everything else: one thread.
class Writer {
 public:
  /// Maps and prefaults `fd`, sized to hold `capacity` events. Takes no ownership of `fd`.
  [[nodiscard]] static Result<std::unique_ptr<Writer>> create(int fd, std::uint64_t capacity);
  /// Maps the buffer that another process of the app has created in `fd`.
  [[nodiscard]] static Result<std::unique_ptr<Writer>> attach(int fd);
  ~Writer();
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  void write(std::uint16_t kind, std::uint64_t seq, std::uint16_t xnode, std::uint16_t module,
             std::uint16_t xpu, std::uint32_t arg = 0) noexcept;
  /// The same, of an instant that was read already: what is accounted for by it agrees with the
  /// trace.
  void write_at(std::int64_t ts_ns, std::uint16_t kind, std::uint64_t seq, std::uint16_t xnode,
                std::uint16_t module, std::uint16_t xpu, std::uint32_t arg = 0) noexcept;

 private:
  Writer(Header* header, std::size_t bytes) : header_(header), bytes_(bytes) {}
  Header* header_;
  std::size_t bytes_;
};

struct Recording {
  std::vector<Event> events;  ///< by time
  std::uint64_t lost = 0;     ///< within that time: never written, or given up
  /// Before that time: the ring has gone round. 0: `events` is all since the beginning.
  std::uint64_t overwritten = 0;
};

/// Reads the newest of what Writers have left in `fd`, whether or not they still write. Checks
/// every length; an event that was claimed but is not there (its writer was killed, or has not
/// ended yet) is counted as lost.
[[nodiscard]] Result<Recording> read(int fd);

/// How often something went wrong so far; a writer may be at work. Zeros: no buffer yet.
struct Alarms {
  std::uint64_t misses = 0, hangs = 0;
};
[[nodiscard]] Alarms alarms(int fd);

}  // namespace xauto::trace
