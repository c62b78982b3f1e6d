// SPDX-License-Identifier: Apache-2.0
#include "trace/trace.h"

#include <algorithm>
#include <cerrno>
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

Event* events_of(Header* header) {
  return reinterpret_cast<Event*>(header + 1);
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
  if (header->magic != kMagic || header->version != XAUTO_EVENT_VERSION ||
      header->capacity > (bytes - sizeof(Header)) / sizeof(Event))
    return fail(ErrorCode::kInvalid, "trace buffer has no valid header");
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
  if (index >= header_->capacity) return;
  events_of(header_)[index] = {static_cast<std::uint64_t>(ts_ns), seq, xnode, module, xpu, kind, arg, 0};
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
  if (header->magic != kMagic || header->version != XAUTO_EVENT_VERSION ||
      header->capacity > room) {
    munmap(memory, bytes);
    return fail(ErrorCode::kInvalid, "trace buffer has no valid header");
  }
  const std::uint64_t claimed = header->claimed.load(std::memory_order_acquire);
  const std::uint64_t count = std::min(claimed, header->capacity);
  recording.lost = claimed - count;
  recording.events.reserve(count);
  for (std::uint64_t i = 0; i < count; ++i) {
    const Event event = events_of(header)[i];
    if (event.kind == 0)
      ++recording.lost;
    else
      recording.events.push_back(event);
  }
  munmap(memory, bytes);
  std::stable_sort(recording.events.begin(), recording.events.end(),
                   [](const Event& a, const Event& b) { return a.ts_ns < b.ts_ns; });
  return recording;
}

}  // namespace xauto::trace
