// SPDX-License-Identifier: Apache-2.0
#include "emu/machine.h"

#include <limits>

#include "emu/device.h"

namespace xauto::emu {
namespace {

constexpr Nanos kNever = std::numeric_limits<Nanos>::max();

}  // namespace

// ---- what both kinds of device share
// ---------------------------------------------------------------

Status Device::submit(ContextId id, std::uint64_t tag, Nanos work_ns) {
  Context& context = contexts_[id];
  if (context.busy) return fail(ErrorCode::kInvalid, "the context has a job already", stats_.name);
  context.busy = true;
  context.tag = tag;
  context.left_ns = work_ns;
  if (!context.suspended) join(id);
  return {};
}

Status Device::suspend(ContextId id, std::uint64_t tag, Nanos now, std::vector<Event>& events) {
  if (!preemptive_) return fail(ErrorCode::kUnavailable, "is not preemptive", stats_.name);
  Context& context = contexts_[id];
  bool blocks = false;
  if (!context.suspended) {
    context.suspended = true;
    if (context.busy) blocks = evict(id);
  }
  if (!blocks) {
    events.push_back({Event::Kind::kSuspended, id, tag, now});
    return {};
  }
  // A second preemption within the first one's time waits for it.
  ++stats_.preemptions;
  stats_.overhead_ns += preempt_ns_;
  blocked_until_ = std::max(blocked_until_, now) + preempt_ns_;
  acks_.push_back({id, tag});
  return {};
}

Status Device::resume(ContextId id, std::uint64_t tag, Nanos now, std::vector<Event>& events) {
  Context& context = contexts_[id];
  if (context.suspended) {
    context.suspended = false;
    if (context.busy) join(id);
  }
  events.push_back({Event::Kind::kResumed, id, tag, now});
  return {};
}

// ---- time-sliced: one context at a time
// ------------------------------------------------------------

void TimeSliced::leave(ContextId id) {
  if (!queue_.empty() && queue_.front() == id) on_device_ = false;
  std::erase(queue_, id);
}

bool TimeSliced::evict(ContextId id) {
  const bool front = !queue_.empty() && queue_.front() == id && on_device_;
  leave(id);
  return front && preempt_ns_ > 0;
}

Nanos TimeSliced::next_event() const {
  if (!acks_.empty()) return blocked_until_;
  if (queue_.empty()) return kNever;
  const Nanos start = std::max({now_, blocked_until_, switch_until_});
  const Nanos left = contexts_.at(queue_.front()).left_ns;
  const bool sliced = preemptive_ && queue_.size() > 1;
  const Nanos slice = on_device_ ? slice_left_ : slice_ns_;
  return start + (sliced ? std::min(left, slice) : left);
}

void TimeSliced::advance(Nanos limit, std::vector<Event>& events) {
  if (blocked_until_ > now_) {
    now_ = std::min(limit, blocked_until_);
    if (now_ < blocked_until_) return;
  }
  if (!acks_.empty() && now_ >= blocked_until_) {
    for (const Ack& ack : acks_)
      events.push_back({Event::Kind::kSuspended, ack.context, ack.tag, blocked_until_});
    acks_.clear();
  }
  if (switch_until_ > now_) {
    now_ = std::min(limit, switch_until_);
    if (now_ < switch_until_) return;
  }
  if (queue_.empty()) {
    now_ = limit;
    return;
  }
  const ContextId id = queue_.front();
  Context& context = contexts_[id];
  if (!on_device_) {
    on_device_ = true;
    slice_left_ = slice_ns_;
  }
  // Alone, a context's slice is renewed for free; a newcomer finds it wherever it happens to be.
  const bool sliced = preemptive_ && queue_.size() > 1;
  const Nanos step =
      std::min(limit - now_, sliced ? std::min(context.left_ns, slice_left_) : context.left_ns);
  now_ += step;
  context.left_ns -= step;
  stats_.busy_ns += step;
  slice_left_ -= step % slice_ns_;
  if (slice_left_ <= 0) slice_left_ += slice_ns_;
  if (context.left_ns == 0) {
    queue_.pop_front();
    on_device_ = false;
    finish(id, now_, events);
  } else if (sliced && step > 0 && slice_left_ == slice_ns_) {
    queue_.pop_front();
    queue_.push_back(id);
    on_device_ = false;
    switch_until_ = now_ + switch_ns_;
    ++stats_.switches;
    stats_.overhead_ns += switch_ns_;
  }
}

// ---- shared: everybody at once
// ---------------------------------------------------------------------

Nanos Shared::next_event() const {
  if (!acks_.empty()) return blocked_until_;
  if (running_.empty()) return kNever;
  Nanos least = kNever;
  for (const ContextId id : running_) least = std::min(least, contexts_.at(id).left_ns);
  const auto sharers = static_cast<std::int64_t>(running_.size());
  const Nanos start = std::max(now_, blocked_until_);
  // Rounded up: at that time the work is done for sure.
  return start + (sharers <= cores_ ? least : (least * sharers + cores_ - 1) / cores_);
}

void Shared::advance(Nanos limit, std::vector<Event>& events) {
  if (blocked_until_ > now_) {
    now_ = std::min(limit, blocked_until_);
    if (now_ < blocked_until_) return;
  }
  if (!acks_.empty() && now_ >= blocked_until_) {
    for (const Ack& ack : acks_)
      events.push_back({Event::Kind::kSuspended, ack.context, ack.tag, blocked_until_});
    acks_.clear();
  }
  if (running_.empty()) {
    now_ = limit;
    return;
  }
  const Nanos until = std::min(limit, next_event());
  const auto sharers = static_cast<std::int64_t>(running_.size());
  const Nanos elapsed = until - now_;
  const Nanos progress = sharers <= cores_ ? elapsed : elapsed * cores_ / sharers;
  now_ = until;
  std::vector<ContextId> done;
  for (const ContextId id : running_) {
    Context& context = contexts_[id];
    const Nanos step = std::min(context.left_ns, progress);
    context.left_ns -= step;
    stats_.busy_ns += step;
    if (context.left_ns == 0) done.push_back(id);
  }
  for (const ContextId id : done) {
    leave(id);
    finish(id, now_, events);
  }
}

// ---- the machine
// -----------------------------------------------------------------------------------

Machine::Machine() = default;
Machine::Machine(Machine&&) noexcept = default;
Machine& Machine::operator=(Machine&&) noexcept = default;
Machine::~Machine() = default;

Result<Machine> Machine::create(const Platform& platform) {
  XAUTO_TRY(validate(platform));
  Machine machine;
  std::int64_t cpus = 0;
  for (const Xpu& xpu : platform.xpus) {
    constexpr Nanos kMicro = 1000;
    if (xpu.timeslice_us > 0 || !xpu.preemptive)
      machine.devices_.push_back(std::make_unique<TimeSliced>(
          xpu.id, xpu.preemptive, xpu.preempt_us * kMicro,
          std::max<Nanos>(1, xpu.timeslice_us * kMicro), xpu.effective_switch_us() * kMicro));
    else
      machine.devices_.push_back(
          std::make_unique<Shared>(xpu.id, xpu.preemptive, xpu.preempt_us * kMicro, 1));
    cpus += xpu.type == "cpu" ? 1 : 0;
  }
  if (cpus > 0 && platform.find("cpu") < 0)
    machine.devices_.push_back(std::make_unique<Shared>("cpu", true, 0, cpus));
  return machine;
}

Result<Device*> Machine::device_of(ContextId context) {
  const auto found = device_of_.find(context);
  if (found == device_of_.end())
    return fail(ErrorCode::kInvalid, "there is no context " + std::to_string(context));
  return found->second;
}

Result<ContextId> Machine::open(const std::string& name, Nanos now) {
  if (device_of_.size() >= kMaxContexts)
    return fail(ErrorCode::kUnavailable,
                std::to_string(kMaxContexts) + " contexts are open already");
  advance(now, pending_);
  for (const auto& device : devices_)
    if (device->stats().name == name) {
      const ContextId id = next_id_++;
      device->open(id);
      device_of_[id] = device.get();
      return id;
    }
  return fail(ErrorCode::kNotFound, "there is no emulated XPU '" + name + "'");
}

void Machine::close(ContextId context, Nanos now) {
  advance(now, pending_);
  const auto found = device_of_.find(context);
  if (found == device_of_.end()) return;
  found->second->close(context);
  device_of_.erase(found);
}

Status Machine::submit(ContextId context, std::uint64_t tag, Nanos work_ns, Nanos now) {
  XAUTO_ASSIGN(Device * device, device_of(context));
  if (work_ns <= 0 || work_ns > kMaxWorkNs)
    return fail(ErrorCode::kInvalid, std::to_string(work_ns) + " ns is no amount of work");
  advance(now, pending_);
  return device->submit(context, tag, work_ns);
}

Status Machine::suspend(ContextId context, std::uint64_t tag, Nanos now) {
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  return device->suspend(context, tag, now, pending_);
}

Status Machine::resume(ContextId context, std::uint64_t tag, Nanos now) {
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  return device->resume(context, tag, now, pending_);
}

Nanos Machine::next_event() const {
  Nanos next = kNever;
  if (!pending_.empty()) next = pending_.front().time;
  for (const auto& device : devices_) next = std::min(next, device->next_event());
  return next;
}

void Machine::advance(Nanos now, std::vector<Event>& events) {
  // `events` may be pending_ itself: calls collect there what happened on the way.
  std::vector<Event> happened;
  if (&events != &pending_) happened.swap(pending_);
  for (const auto& device : devices_) {
    while (device->next_event() <= now) device->advance(now, happened);
    // What is left of the interval brings no event.
    device->advance(now, happened);
  }
  std::stable_sort(happened.begin(), happened.end(),
                   [](const Event& a, const Event& b) { return a.time < b.time; });
  events.insert(events.end(), happened.begin(), happened.end());
}

std::vector<DeviceStats> Machine::stats() const {
  std::vector<DeviceStats> all;
  for (const auto& device : devices_) all.push_back(device->stats());
  return all;
}

}  // namespace xauto::emu
