// SPDX-License-Identifier: Apache-2.0
#include "emu/machine.h"

#include <algorithm>
#include <limits>

#include "emu/device.h"

namespace xauto::emu {
namespace {

constexpr Nanos kNever = std::numeric_limits<Nanos>::max();

/// Far enough from the end that sums of times do not overflow.
bool is_time(Nanos time) {
  return time >= 0 && time < kNever / 4;
}

/// FNV-1a: the same in every build.
std::uint64_t hash_of(const std::string& text) {
  std::uint64_t hash = 0xcbf29ce484222325;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  return hash;
}

}  // namespace

// ---- what both kinds of device share ------------------------------------------------------------

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
  if (!context.suspended) {
    context.suspended = true;
    if (context.busy && evict(id)) {
      block(now);
      context.block = block_;
    }
  }
  // Also when it is asked for again: not before it is true.
  if (context.block == block_ && blocked_until_ > now)
    acks_.push_back({id, tag});
  else
    events.push_back({Event::Kind::kSuspended, id, tag, now});
  return {};
}

Status Device::resume(ContextId id, std::uint64_t tag, Nanos now, std::vector<Event>& events) {
  Context& context = contexts_[id];
  if (context.suspended) {
    context.suspended = false;
    context.block = 0;
    if (context.busy) join(id);
  }
  events.push_back({Event::Kind::kResumed, id, tag, now});
  return {};
}

Status Device::level(ContextId id, int level) {
  if (level < 0 || level >= std::max(1, levels_))
    return fail(ErrorCode::kUnavailable, "has no level " + std::to_string(level), stats_.name);
  Context& context = contexts_[id];
  if (context.busy) return fail(ErrorCode::kInvalid, "the context has a job already", stats_.name);
  context.level = level;
  return {};
}

// ---- time-sliced: one context at a time ---------------------------------------------------------

void TimeSliced::enqueue(ContextId id) {
  const int level = contexts_.at(id).level;
  const auto before = std::find_if(queue_.begin(), queue_.end(), [&](ContextId other) {
    return contexts_.at(other).level < level;
  });
  queue_.insert(before, id);
}

void TimeSliced::join(ContextId id) {
  enqueue(id);
  if (!on_device_ || queue_.front() != id) return;
  on_device_ = false;
  block(now_);
}

bool TimeSliced::takes_turns() const {
  return preemptive_ && queue_.size() > 1 &&
         contexts_.at(queue_[0]).level == contexts_.at(queue_[1]).level;
}

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
  const bool sliced = takes_turns();
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
  const bool sliced = takes_turns();
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
    enqueue(id);
    on_device_ = false;
    switch_until_ = now_ + switch_ns_;
    ++stats_.switches;
    stats_.overhead_ns += switch_ns_;
  }
}

// ---- shared: everybody at once ------------------------------------------------------------------

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

// ---- what outlives the process ------------------------------------------------------------------

void Device::save(Snapshot& snapshot) const {
  DeviceRecord device{.name = hash_of(stats_.name),
                      .now = now_,
                      .blocked_until = blocked_until_,
                      .block = block_,
                      .busy_ns = stats_.busy_ns,
                      .overhead_ns = stats_.overhead_ns,
                      .switches = stats_.switches,
                      .preemptions = stats_.preemptions,
                      .jobs = stats_.jobs,
                      .contexts = static_cast<std::uint32_t>(contexts_.size())};
  save_more(device);
  snapshot.devices.push_back(device);
  const auto append = [&](ContextId id, const Context& context) {
    snapshot.contexts.push_back({.id = id,
                                 .busy = context.busy,
                                 .suspended = context.suspended,
                                 .level = static_cast<std::uint16_t>(context.level),
                                 .tag = context.tag,
                                 .left_ns = context.left_ns,
                                 .block = context.block});
  };
  for (const ContextId id : order()) append(id, contexts_.at(id));
  for (const auto& [id, context] : contexts_)
    if (!context.runnable()) append(id, context);
}

Status Device::restore(const DeviceRecord& record, std::span<const ContextRecord> contexts,
                       Nanos now) {
  const auto refuse = [&](const char* what) {
    return fail(ErrorCode::kInvalid, what, stats_.name);
  };
  if (record.name != hash_of(stats_.name)) return refuse("another device is here");
  if (record.now < 0 || record.now > now || !is_time(record.blocked_until) ||
      !is_time(record.busy_ns) || !is_time(record.overhead_ns))
    return refuse("a time of the device is impossible");
  now_ = record.now;
  blocked_until_ = record.blocked_until;
  block_ = record.block;
  stats_.busy_ns = record.busy_ns;
  stats_.overhead_ns = record.overhead_ns;
  stats_.switches = record.switches;
  stats_.preemptions = record.preemptions;
  stats_.jobs = record.jobs;
  bool runnable = true;
  int level = kMaxLevels;
  for (const ContextRecord& c : contexts) {
    if (c.busy > 1 || c.suspended > 1 || c.level >= std::max(1, levels_) || c.zero != 0)
      return refuse("a context's state is impossible");
    if (c.suspended != 0 ? !preemptive_ || c.block > record.block : c.block != 0)
      return refuse("a context cannot be suspended like that");
    if (c.busy != 0 ? c.left_ns <= 0 || c.left_ns > kMaxWorkNs : c.left_ns != 0)
      return refuse("a context's work is impossible");
    const Context context{c.busy != 0, c.suspended != 0, c.tag, c.left_ns, c.block, c.level};
    if (context.runnable() && (!runnable || c.level > level))
      return refuse("its contexts are out of order");
    runnable = context.runnable();
    level = context.level;
    contexts_[c.id] = context;
    if (runnable) join(c.id);
  }
  return restore_more(record);
}

void TimeSliced::save_more(DeviceRecord& record) const {
  record.switch_until = switch_until_;
  record.slice_left = slice_left_;
  record.on_device = on_device_ ? 1 : 0;
}

Status TimeSliced::restore_more(const DeviceRecord& record) {
  if (!is_time(record.switch_until) || record.on_device > 1 || record.slice_left < 0 ||
      record.slice_left > slice_ns_ ||
      (record.on_device != 0 && (queue_.empty() || record.slice_left == 0)))
    return fail(ErrorCode::kInvalid, "its time slice is impossible", stats_.name);
  switch_until_ = record.switch_until;
  slice_left_ = record.slice_left;
  on_device_ = record.on_device != 0;
  return {};
}

// ---- the machine --------------------------------------------------------------------------------

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
    // Without time slices who has the device keeps it, as long as nobody comes on a higher level.
    const Nanos slice = xpu.timeslice_us > 0 ? xpu.timeslice_us * kMicro : kMaxWorkNs;
    if (xpu.timeslice_us > 0 || !xpu.preemptive || xpu.levels > 0)
      machine.devices_.push_back(
          std::make_unique<TimeSliced>(xpu.id, xpu.preemptive, xpu.preempt_us * kMicro, slice,
                                       xpu.effective_switch_us() * kMicro, xpu.levels));
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
  thread_.check();
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
  thread_.check();
  advance(now, pending_);
  const auto found = device_of_.find(context);
  if (found == device_of_.end()) return;
  found->second->close(context);
  device_of_.erase(found);
}

Status Machine::submit(ContextId context, std::uint64_t tag, Nanos work_ns, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  if (work_ns <= 0 || work_ns > kMaxWorkNs)
    return fail(ErrorCode::kInvalid, std::to_string(work_ns) + " ns is no amount of work");
  advance(now, pending_);
  return device->submit(context, tag, work_ns);
}

Status Machine::suspend(ContextId context, std::uint64_t tag, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  return device->suspend(context, tag, now, pending_);
}

Status Machine::resume(ContextId context, std::uint64_t tag, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  return device->resume(context, tag, now, pending_);
}

Status Machine::level(ContextId context, int level, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  return device->level(context, level);
}

Result<Progress> Machine::progress(ContextId context, std::uint64_t tag) {
  XAUTO_ASSIGN(const Device* const device, device_of(context));
  return device->progress(context, tag);
}

void Machine::save(Snapshot& snapshot) const {
  snapshot.next_id = next_id_;
  snapshot.devices.clear();
  snapshot.contexts.clear();
  for (const auto& device : devices_) device->save(snapshot);
}

Result<Machine> Machine::restore(const Platform& platform, const Snapshot& snapshot, Nanos now) {
  XAUTO_ASSIGN(Machine machine, create(platform));
  if (snapshot.devices.size() != machine.devices_.size())
    return fail(ErrorCode::kInvalid, "another platform's devices are here");
  std::span<const ContextRecord> left(snapshot.contexts);
  for (std::size_t i = 0; i < machine.devices_.size(); ++i) {
    const DeviceRecord& record = snapshot.devices[i];
    if (record.contexts > left.size())
      return fail(ErrorCode::kInvalid, "contexts are missing", machine.devices_[i]->stats().name);
    const auto own = left.first(record.contexts);
    left = left.subspan(record.contexts);
    for (const ContextRecord& context : own)
      if (context.id == 0 || context.id >= snapshot.next_id ||
          !machine.device_of_.emplace(context.id, machine.devices_[i].get()).second)
        return fail(ErrorCode::kInvalid, "context " + std::to_string(context.id) + " cannot be",
                    machine.devices_[i]->stats().name);
    XAUTO_TRY(machine.devices_[i]->restore(record, own, now));
  }
  if (!left.empty()) return fail(ErrorCode::kInvalid, "contexts are on no device");
  machine.next_id_ = snapshot.next_id;
  return machine;
}

Nanos Machine::next_event() const {
  Nanos next = kNever;
  if (!pending_.empty()) next = pending_.front().time;
  for (const auto& device : devices_) next = std::min(next, device->next_event());
  return next;
}

void Machine::advance(Nanos now, std::vector<Event>& events) {
  thread_.check();
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
