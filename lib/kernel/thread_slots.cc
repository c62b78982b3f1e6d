// SPDX-License-Identifier: Apache-2.0
#include "kernel/thread_slots.h"

#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>

#include <sys/stat.h>
#include <unistd.h>

#include "base/clock.h"
#include "kernel/pid_namespace.h"

namespace xauto::kernel {
namespace {

/// In a slot's tid: it is taken, and its thread has not entered yet.
constexpr std::uint32_t kTaken = 0xffffffffu;

/// bpf/maps.bpf.h's struct thread_entry: slot, when entered.
using Entry = std::array<std::uint64_t, 2>;

/// The key of a thread of this process. Its id is that of its PID namespace, so the namespace belongs
/// to it: in a container the same number is somebody else's, too.
Result<std::uint64_t> key_of(std::uint32_t tid) {
  const std::optional<ino_t> space = own_pid_namespace();
  if (!space)
    return fail(ErrorCode::kUnavailable,
                std::string("/proc/thread-self/ns/pid: ") + strerror(errno), {}, "mount /proc");
  return std::uint64_t{*space} << 32 | tid;
}

}  // namespace

Result<ThreadSlots> ThreadSlots::attach(UniqueFd slots_fd, UniqueFd threads_fd) {
  ThreadSlots slots;
  XAUTO_TRY(check_shape(slots_fd.get(), "slots", sizeof(xauto_bpf_slot), 1));
  XAUTO_TRY(check_shape(threads_fd.get(), "threads", sizeof(Entry), 1, sizeof(std::uint64_t)));
  XAUTO_ASSIGN(slots.map_, MappedMap::map(slots_fd.get(), sizeof(xauto_bpf_slot), true));
  slots.threads_ = std::move(threads_fd);
  return slots;
}

ThreadSlots ThreadSlots::unobserved() {
  return {};
}

ThreadSlot ThreadSlots::take(std::uint32_t xpu) {
  ThreadSlot slot;
  for (std::uint32_t i = 0; i < map_.size() && slot.slot_ == nullptr; ++i) {
    xauto_bpf_slot* candidate = map_.as<xauto_bpf_slot>() + i;
    std::uint32_t nobody = 0;  // several processes take from one map
    if (std::atomic_ref(candidate->tid).compare_exchange_strong(nobody, kTaken))
      slot.slot_ = candidate;
  }
  if (slot.slot_ == nullptr) {
    own_.push_back(std::make_unique<xauto_bpf_slot>());
    slot.slot_ = own_.back().get();
  }
  std::atomic_ref(slot.slot_->job).store(0, std::memory_order_relaxed);
  slot.slot_->xpu = xpu;
  return slot;
}

int ThreadSlots::index(const ThreadSlot& slot) const {
  const auto* first = map_.as<xauto_bpf_slot>();
  const bool inside = map_ && slot.slot_ >= first && slot.slot_ < first + map_.size();
  return inside ? static_cast<int>(slot.slot_ - first) : -1;
}

Status ThreadSlots::enter(const ThreadSlot& slot) const {
  const auto tid = static_cast<std::uint32_t>(gettid());
  std::atomic_ref(slot.slot_->tid).store(tid, std::memory_order_release);
  const int at = index(slot);
  if (at < 0) return {};
  XAUTO_ASSIGN(const std::uint64_t key, key_of(tid));
  const Entry entry{static_cast<std::uint64_t>(at), static_cast<std::uint64_t>(now_ns())};
  XAUTO_TRY(set_element(threads_.get(), &key, entry.data()));
  // A wake-up, so that the scheduler places it as what it is now. A yield is not enough: on the
  // wrong CPU, with nobody else there, the kernel would let it go on.
  const timespec moment{0, 1'000'000};
  nanosleep(&moment, nullptr);
  return {};
}

void ThreadSlots::leave(const ThreadSlot& slot) const {
  const std::uint32_t tid = slot.tid();
  if (tid != 0 && tid != kTaken && index(slot) >= 0)
    if (const auto key = key_of(tid)) remove_element(threads_.get(), &*key);
  std::atomic_ref(slot.slot_->tid).store(0, std::memory_order_release);
}

}  // namespace xauto::kernel
