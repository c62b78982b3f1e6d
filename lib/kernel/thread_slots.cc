// SPDX-License-Identifier: Apache-2.0
#include "kernel/thread_slots.h"

#include <sched.h>
#include <unistd.h>

namespace xauto::kernel {

Result<ThreadSlots> ThreadSlots::attach(int slots_fd, int threads_fd) {
  ThreadSlots slots;
  XAUTO_TRY(check_shape(slots_fd, "slots", sizeof(xauto_bpf_slot), 1));
  XAUTO_TRY(check_shape(threads_fd, "threads", sizeof(std::uint32_t), 1));
  XAUTO_ASSIGN(slots.map_, MappedMap::map(slots_fd, sizeof(xauto_bpf_slot), true));
  slots.threads_fd_ = threads_fd;
  return slots;
}

ThreadSlots ThreadSlots::unobserved(std::uint32_t count) {
  ThreadSlots slots;
  slots.own_.reserve(count);
  return slots;
}

Slot ThreadSlots::take(std::uint32_t xpu) {
  Slot slot;
  if (map_ && next_ < map_.size()) {
    slot.slot_ = map_.as<xauto_bpf_slot>() + next_++;
  } else {
    own_.push_back(std::make_unique<xauto_bpf_slot>());
    slot.slot_ = own_.back().get();
  }
  slot.slot_->xpu = xpu;
  return slot;
}

int ThreadSlots::index(const Slot& slot) const {
  const auto* first = map_.as<xauto_bpf_slot>();
  const bool inside = map_ && slot.slot_ >= first && slot.slot_ < first + map_.size();
  return inside ? static_cast<int>(slot.slot_ - first) : -1;
}

Status ThreadSlots::enter(const Slot& slot) const {
  const auto tid = static_cast<std::uint32_t>(gettid());
  std::atomic_ref(slot.slot_->tid).store(tid, std::memory_order_release);
  const int at = index(slot);
  if (at < 0) return {};
  XAUTO_TRY(set_element(threads_fd_, &tid, &at));
  sched_yield();  // so that the scheduler meets it once as what it is now
  return {};
}

void ThreadSlots::leave(const Slot& slot) const {
  const std::uint32_t tid = slot.tid();
  if (tid != 0 && index(slot) >= 0) remove_element(threads_fd_, &tid);
  std::atomic_ref(slot.slot_->tid).store(0, std::memory_order_release);
}

}  // namespace xauto::kernel
