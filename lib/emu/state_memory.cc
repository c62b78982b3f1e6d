// SPDX-License-Identifier: Apache-2.0
#include "emu/state_memory.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/memory_file.h"

namespace xauto::emu {
namespace {

constexpr std::uint64_t kMagic = 0x3265746174736d65;  ///< "emstate2"

tl::unexpected<Error> io_error(const char* what) {
  return fail(ErrorCode::kIo, std::string(what) + ": " + strerror(errno), "emulator's memory");
}

/// Against what is no death in the middle: somebody else's bytes.
std::uint64_t checksum(const std::byte* data, std::size_t bytes) {
  std::uint64_t sum = bytes;
  for (std::size_t i = 0; i < bytes; i += sizeof(std::uint64_t)) {
    std::uint64_t word = 0;
    std::memcpy(&word, data + i, std::min(sizeof word, bytes - i));
    sum = (sum ^ word) * 0x9e3779b97f4a7c15;
    sum ^= sum >> 32;
  }
  return sum;
}

}  // namespace

struct StateMemory::Layout {
  struct Copy {
    std::atomic<std::uint64_t> sequence;  ///< the higher one counts; 0: empty or being written
    std::uint64_t bytes;
    std::uint64_t checksum;
    alignas(64) std::byte data[kMaxSnapshotBytes];
  };
  std::uint64_t magic;  ///< 0: nobody has used it yet
  alignas(64) Copy copies[2];
};

Result<UniqueFd> StateMemory::make() {
  return sealed_memory("xauto-emulator", sizeof(Layout));
}

Result<StateMemory> StateMemory::map(UniqueFd fd) {
  struct stat status {};
  if (fstat(fd.get(), &status) != 0) return io_error("fstat");
  if (status.st_size != static_cast<off_t>(sizeof(Layout)))
    return fail(ErrorCode::kInvalid, "has another size", "emulator's memory");
  if ((fcntl(fd.get(), F_GET_SEALS) & F_SEAL_SHRINK) == 0)
    return fail(ErrorCode::kInvalid, "is not sealed", "emulator's memory");
  void* memory = mmap(nullptr, sizeof(Layout), PROT_READ | PROT_WRITE, MAP_SHARED, fd.get(), 0);
  if (memory == MAP_FAILED) return io_error("mmap");
  auto* layout = static_cast<Layout*>(memory);
  if (layout->magic == 0) layout->magic = kMagic;
  StateMemory state(std::move(fd), layout);
  if (layout->magic != kMagic)
    return fail(ErrorCode::kInvalid, "is of another version", "emulator's memory");
  return state;
}

StateMemory::StateMemory(StateMemory&& other) noexcept
    : fd_(std::move(other.fd_)), layout_(std::exchange(other.layout_, nullptr)) {}

StateMemory::~StateMemory() {
  if (layout_ != nullptr) munmap(layout_, sizeof(Layout));
}

Result<std::optional<Snapshot>> StateMemory::load() const {
  const Layout::Copy* newest = nullptr;
  std::uint64_t sequence = 0;
  for (const Layout::Copy& copy : layout_->copies)
    if (const std::uint64_t s = copy.sequence.load(std::memory_order_acquire); s > sequence) {
      newest = &copy;
      sequence = s;
    }
  if (newest == nullptr) return std::optional<Snapshot>();
  if (newest->bytes > kMaxSnapshotBytes ||
      newest->checksum != checksum(newest->data, newest->bytes))
    return fail(ErrorCode::kInvalid, "its checksum is wrong", "emulator's memory");
  XAUTO_ASSIGN(Snapshot snapshot, Snapshot::decode({newest->data, newest->bytes}));
  return std::optional<Snapshot>(std::move(snapshot));
}

void StateMemory::save(const Snapshot& snapshot) {
  thread_.check();
  Layout::Copy* copies = layout_->copies;
  const std::uint64_t a = copies[0].sequence.load(std::memory_order_relaxed),
                      b = copies[1].sequence.load(std::memory_order_relaxed);
  Layout::Copy& older = copies[a <= b ? 0 : 1];
  older.sequence.store(0, std::memory_order_relaxed);
  // Against the compiler; the CPU's order is the program's for who reads after the process's end.
  std::atomic_signal_fence(std::memory_order_seq_cst);
  older.bytes = snapshot.bytes();
  snapshot.encode(older.data);
  older.checksum = checksum(older.data, older.bytes);
  older.sequence.store(std::max(a, b) + 1, std::memory_order_release);
}

}  // namespace xauto::emu
