// SPDX-License-Identifier: Apache-2.0
// The one event record's writer and reader. The writer is wait-free: one fetch_add and one store of
// 32 bytes into memory that was touched beforehand; what does not fit is dropped and counted, and
// every report says so. The buffer is a memfd, so that the parent reads it even if the writer was
// killed.
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

/// Start of the shared buffer; the events follow it.
struct Header {
  std::uint32_t magic = 0;
  std::uint32_t version = 0;
  std::uint64_t capacity = 0;  ///< events
  std::atomic<std::uint64_t>
      claimed{};  ///< events asked for; above `capacity`: that many were lost
  std::uint64_t pad[5] = {};
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
  std::uint64_t lost = 0;
};

/// Reads what a Writer left in `fd`, whether or not it is still alive. Checks every length; a
/// record that was claimed but not written (its writer was killed) is counted as lost.
[[nodiscard]] Result<Recording> read(int fd);

}  // namespace xauto::trace
