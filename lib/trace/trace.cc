// SPDX-License-Identifier: Apache-2.0
#include "trace/trace.h"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <ctime>

#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

namespace xauto::trace {
namespace {

std::uint64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000u +
         static_cast<std::uint64_t>(now.tv_nsec);
}

/// An event in the ring. Every word is atomic: writer and reader may meet in it.
///
/// The words are stored with release and loaded with acquire, so that a reader that gets any word
/// of a later lap also sees, in its second look at the stamp, that the slot was taken for it.
struct EventSlot {
  std::atomic<std::uint64_t> ts_ns, seq, what;
  std::atomic<std::uint32_t> arg, stamp;

  void put(const Event& e) {
    std::uint64_t packed = 0;
    std::memcpy(&packed, &e.xnode, sizeof packed);
    ts_ns.store(e.ts_ns, std::memory_order_release);
    seq.store(e.seq, std::memory_order_release);
    what.store(packed, std::memory_order_release);
    arg.store(e.arg, std::memory_order_release);
  }
  [[nodiscard]] Event get() const {
    Event e{};
    const std::uint64_t packed = what.load(std::memory_order_acquire);
    std::memcpy(&e.xnode, &packed, sizeof packed);
    e.ts_ns = ts_ns.load(std::memory_order_acquire);
    e.seq = seq.load(std::memory_order_acquire);
    e.arg = arg.load(std::memory_order_acquire);
    return e;
  }
};
static_assert(sizeof(EventSlot) == sizeof(Event) &&
              offsetof(EventSlot, what) == offsetof(Event, xnode) &&
              offsetof(Event, kind) == offsetof(Event, xnode) + 6 &&
              offsetof(EventSlot, arg) == offsetof(Event, arg) &&
              offsetof(EventSlot, stamp) == offsetof(Event, stamp));

EventSlot* slots_of(Header* header) {
  return reinterpret_cast<EventSlot*>(header + 1);
}

/// Of a slot that holds the event `index`. Laps are counted modulo 2^31, which nobody lives to see.
std::uint32_t stamp_of(std::uint64_t index, std::uint64_t capacity) {
  return static_cast<std::uint32_t>((index / capacity + 1) * 2);
}

/// Whoever wrote it may be of another version than who reads it: an app is linked with a library of its own.
Status check_header(const Header& header, std::uint64_t room) {
  if (header.magic == kMagic && header.version != XAUTO_EVENT_VERSION)
    return fail(ErrorCode::kInvalid,
                "trace buffer is of version " + std::to_string(header.version) + ", not " +
                    std::to_string(XAUTO_EVENT_VERSION),
                {}, "xauto and the app's libxauto have to be of one version");
  if (header.magic != kMagic || header.capacity == 0 || header.capacity > room)
    return fail(ErrorCode::kInvalid, "trace buffer has no valid header");
  return {};
}

}  // namespace

Result<std::unique_ptr<Writer>> Writer::create(int fd, std::uint64_t capacity) {
  if (capacity == 0 || capacity > kMaxEvents)
    return fail(ErrorCode::kInvalid, "trace capacity " + std::to_string(capacity) +
                                         " is not in 1.." + std::to_string(kMaxEvents));
  const std::size_t bytes = sizeof(Header) + capacity * sizeof(Event);
  if (ftruncate(fd, static_cast<off_t>(bytes)) != 0)
    return fail(ErrorCode::kIo, std::string("cannot size the trace buffer: ") + strerror(errno));
  void* memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map the trace buffer: ") + strerror(errno));
  auto* header = new (memory) Header;
  header->version = XAUTO_EVENT_VERSION;
  header->capacity = capacity;
  header->magic = kMagic;
  return std::unique_ptr<Writer>(new Writer(header, bytes));
}

Result<std::unique_ptr<Writer>> Writer::attach(int fd) {
  struct stat status {};
  if (fstat(fd, &status) != 0 || static_cast<std::size_t>(status.st_size) < sizeof(Header))
    return fail(ErrorCode::kInvalid, "trace buffer is cut short");
  const auto bytes = static_cast<std::size_t>(status.st_size);
  void* memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map the trace buffer: ") + strerror(errno));
  auto* header = static_cast<Header*>(memory);
  auto writer = std::unique_ptr<Writer>(new Writer(header, bytes));
  XAUTO_TRY(check_header(*header, (bytes - sizeof(Header)) / sizeof(Event)));
  return writer;
}

Writer::~Writer() {
  munmap(header_, bytes_);
}

void Writer::write(std::uint16_t kind, std::uint64_t seq, std::uint16_t xnode, std::uint16_t module,
                   std::uint16_t xpu, std::uint32_t arg) noexcept {
  write_at(now_ns(), kind, seq, xnode, module, xpu, arg);
}

void Writer::write_at(std::int64_t ts_ns, std::uint16_t kind, std::uint64_t seq,
                      std::uint16_t xnode, std::uint16_t module, std::uint16_t xpu,
                      std::uint32_t arg) noexcept {
  const std::uint64_t index = header_->claimed.fetch_add(1, std::memory_order_relaxed);
  EventSlot& slot = slots_of(header_)[index % header_->capacity];
  const std::uint32_t mine = stamp_of(index, header_->capacity);
  std::uint32_t there = slot.stamp.load(std::memory_order_relaxed);
  // Taken or ahead of us: a lap lies between two writers. Ours is given up; the reader counts it.
  if ((there & 1) == 0 && there < mine &&
      slot.stamp.compare_exchange_strong(there, mine + 1, std::memory_order_acquire,
                                         std::memory_order_relaxed)) {
    slot.put({static_cast<std::uint64_t>(ts_ns), seq, xnode, module, xpu, kind, arg, 0});
    slot.stamp.store(mine, std::memory_order_release);
  }
  if (kind == XAUTO_EV_MISS) header_->misses.fetch_add(1, std::memory_order_release);
  if (kind == XAUTO_EV_HANG) header_->hangs.fetch_add(1, std::memory_order_release);
}

Result<Recording> read(int fd) {
  struct stat status {};
  if (fstat(fd, &status) != 0)
    return fail(ErrorCode::kIo, std::string("cannot stat the trace buffer: ") + strerror(errno));
  Recording recording;
  const auto bytes = static_cast<std::size_t>(status.st_size);
  if (bytes == 0) return recording;  // the writer never got as far as creating it
  if (bytes < sizeof(Header)) return fail(ErrorCode::kInvalid, "trace buffer is cut short");
  void* memory = mmap(nullptr, bytes, PROT_READ, MAP_SHARED, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map the trace buffer: ") + strerror(errno));
  auto* header = static_cast<Header*>(memory);
  const std::uint64_t room = (bytes - sizeof(Header)) / sizeof(Event);
  if (const Status valid = check_header(*header, room); !valid) {
    munmap(memory, bytes);
    return tl::unexpected<Error>(valid.error());
  }
  const std::uint64_t capacity = header->capacity;
  const auto oldest = [&](std::uint64_t end) { return end > capacity ? end - capacity : 0; };
  const std::uint64_t end = header->claimed.load(std::memory_order_acquire);
  std::vector<std::uint64_t> indices;  // of the events
  const std::uint64_t first = oldest(end);
  recording.events.reserve(end - first);
  indices.reserve(end - first);
  for (std::uint64_t index = first; index < end; ++index) {
    const EventSlot& slot = slots_of(header)[index % capacity];
    const std::uint32_t wanted = stamp_of(index, capacity);
    if (slot.stamp.load(std::memory_order_acquire) != wanted) continue;
    const Event event = slot.get();
    if (slot.stamp.load(std::memory_order_relaxed) != wanted) continue;
    recording.events.push_back(event);
    indices.push_back(index);
  }
  // Writers have gone on meanwhile, over the oldest of what was read: there are holes up to here.
  recording.overwritten = std::min(oldest(header->claimed.load(std::memory_order_acquire)), end);
  const auto whole = std::lower_bound(indices.begin(), indices.end(), recording.overwritten);
  recording.events.erase(recording.events.begin(),
                         recording.events.begin() + (whole - indices.begin()));
  recording.lost = end - recording.overwritten - recording.events.size();
  munmap(memory, bytes);
  std::stable_sort(recording.events.begin(), recording.events.end(),
                   [](const Event& a, const Event& b) { return a.ts_ns < b.ts_ns; });
  return recording;
}

Alarms alarms(int fd) {
  std::uint64_t counts[2] = {};
  static_assert(offsetof(Header, hangs) == offsetof(Header, misses) + sizeof counts[0]);
  const ssize_t got = pread(fd, counts, sizeof counts, offsetof(Header, misses));
  if (got != static_cast<ssize_t>(sizeof counts)) return {};
  return {counts[0], counts[1]};
}

}  // namespace xauto::trace
