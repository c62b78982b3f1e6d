// SPDX-License-Identifier: Apache-2.0
#include "emu/machine.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "emu/device.h"
#include "emu/script_play.h"

namespace xauto::emu {
namespace {

constexpr Nanos kNever = std::numeric_limits<Nanos>::max();
using Wide = __int128;

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
  context.left = work_ns * kUnits;
  if (!context.suspended) join(id);
  return {};
}

Status Device::suspend(ContextId id, std::uint64_t tag, Nanos now, std::vector<Event>& events) {
  if (!preemptive_) return fail(ErrorCode::kUnavailable, "is not preemptive", stats_.name);
  Context& context = contexts_[id];
  if (stopped() && !context.suspended && is_on(id)) {
    stuck_.push_back({id, tag, now + kStuckNs});
    return {};
  }
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
  std::erase_if(stuck_, [&](const Stuck& waits) {
    if (waits.context != id) return false;
    events.push_back({Event::Kind::kStuck, id, waits.tag, now});
    return true;
  });
  if (context.suspended) {
    context.suspended = false;
    context.block = 0;
    if (context.busy) join(id);
  }
  events.push_back({Event::Kind::kResumed, id, tag, now});
  return {};
}

Nanos Device::next_event() const {
  return std::min(stuck_.empty() ? kNever : stuck_.front().until, next_of_work());
}

void Device::advance(Nanos limit, std::vector<Event>& events) {
  advance_work(stuck_.empty() ? limit : std::min(limit, stuck_.front().until), events);
  while (!stuck_.empty() && stuck_.front().until <= now_) {
    events.push_back(
        {Event::Kind::kStuck, stuck_.front().context, stuck_.front().tag, stuck_.front().until});
    stuck_.pop_front();
  }
}

void Device::tune(Nanos rate, Nanos cores, std::vector<Event>& events) {
  rate_ = rate;
  cores_ = cores;
  if (stopped()) return;
  // It goes on: what was asked for meanwhile is done now.
  for (const Stuck& waits : std::exchange(stuck_, {})) {
    if (!contexts_.contains(waits.context))
      events.push_back({Event::Kind::kStuck, waits.context, waits.tag, now_});
    else
      (void)suspend(waits.context, waits.tag, now_, events);  // it is preemptive
  }
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

Nanos TimeSliced::next_of_work() const {
  if (!acks_.empty()) return blocked_until_;
  if (queue_.empty() || stopped()) return kNever;
  const Nanos start = std::max({now_, blocked_until_, switch_until_});
  const Nanos left = time_for(contexts_.at(queue_.front()).left);
  const bool sliced = takes_turns();
  const Nanos slice = on_device_ ? slice_left_ : slice_ns_;
  return start + (sliced ? std::min(left, slice) : left);
}

void TimeSliced::advance_work(Nanos limit, std::vector<Event>& events) {
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
  if (queue_.empty() || stopped()) {
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
  const Nanos left = time_for(context.left);
  const Nanos step = std::min(limit - now_, sliced ? std::min(left, slice_left_) : left);
  now_ += step;
  // What is left of the nanosecond in which a job ends is nobody's.
  context.left -= std::min(context.left, step * rate_);
  stats_.busy_ns += step;
  slice_left_ -= step % slice_ns_;
  if (slice_left_ <= 0) slice_left_ += slice_ns_;
  if (context.left == 0) {
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

Nanos Shared::next_of_work() const {
  if (!acks_.empty()) return blocked_until_;
  if (running_.empty() || stopped()) return kNever;
  Nanos least = kNever;
  for (const ContextId id : running_) least = std::min(least, contexts_.at(id).left);
  least = time_for(least);
  const auto sharers = static_cast<std::int64_t>(running_.size());
  const Nanos start = std::max(now_, blocked_until_);
  if (sharers <= cores_) return start + least;
  // Rounded up: at that time the work is done for sure.
  const Wide shared = (static_cast<Wide>(least) * sharers + cores_ - 1) / cores_;
  return start + static_cast<Nanos>(std::min<Wide>(shared, kNever / 2));
}

void Shared::advance_work(Nanos limit, std::vector<Event>& events) {
  if (blocked_until_ > now_) {
    now_ = std::min(limit, blocked_until_);
    if (now_ < blocked_until_) return;
  }
  if (!acks_.empty() && now_ >= blocked_until_) {
    for (const Ack& ack : acks_)
      events.push_back({Event::Kind::kSuspended, ack.context, ack.tag, blocked_until_});
    acks_.clear();
  }
  if (running_.empty() || stopped()) {
    now_ = limit;
    return;
  }
  const Nanos until = std::min(limit, next_of_work());
  const auto sharers = static_cast<std::int64_t>(running_.size());
  const Nanos elapsed = until - now_;
  const Nanos share = sharers <= cores_
                          ? elapsed
                          : static_cast<Nanos>(static_cast<Wide>(elapsed) * cores_ / sharers);
  now_ = until;
  std::vector<ContextId> done;
  for (const ContextId id : running_) {
    Context& context = contexts_[id];
    context.left -= std::min(context.left, share * rate_);
    stats_.busy_ns += share;
    if (context.left == 0) done.push_back(id);
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
                                 .left = context.left,
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
    if (c.busy != 0 ? c.left <= 0 || c.left > kMaxWorkNs * kUnits : c.left != 0)
      return refuse("a context's work is impossible");
    const Context context{c.busy != 0, c.suspended != 0, c.tag, c.left, c.block, c.level};
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

Result<Machine> Machine::create(const Platform& platform, const EmulationScript& script) {
  XAUTO_TRY(validate(platform));
  if (script != EmulationScript{}) XAUTO_TRY(validate(script, platform));
  Machine machine;
  machine.script_ = std::make_unique<ScriptPlay>(script);
  std::vector<std::string> cpus;
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
    machine.parts_.push_back({xpu.type, {xpu.id}});
    if (xpu.type == "cpu") cpus.push_back(xpu.id);
  }
  if (!cpus.empty() && platform.find("cpu") < 0) {
    const auto cores = static_cast<Nanos>(cpus.size());
    machine.devices_.push_back(std::make_unique<Shared>("cpu", true, 0, cores));
    machine.parts_.push_back({"cpu", std::move(cpus), 100, 0, cores});
  }
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
  tune(pending_);
}

Status Machine::submit(ContextId context, std::uint64_t tag, Nanos work_ns, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  if (work_ns <= 0 || work_ns > kMaxWorkNs)
    return fail(ErrorCode::kInvalid, std::to_string(work_ns) + " ns is no amount of work");
  advance(now, pending_);
  XAUTO_TRY(device->submit(context, tag, work_ns));
  if (script_begin_ < 0) {
    script_begin_ = now;
    take_steps(pending_);
  }
  tune(pending_);
  return {};
}

Status Machine::suspend(ContextId context, std::uint64_t tag, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  const Status done = device->suspend(context, tag, now, pending_);
  tune(pending_);
  return done;
}

Status Machine::resume(ContextId context, std::uint64_t tag, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  const Status done = device->resume(context, tag, now, pending_);
  tune(pending_);
  return done;
}

Status Machine::level(ContextId context, int level, Nanos now) {
  thread_.check();
  XAUTO_ASSIGN(Device * device, device_of(context));
  advance(now, pending_);
  return device->level(context, level);
}

Result<Nanos> Machine::busy(const std::string& name, Nanos now) {
  thread_.check();
  advance(now, pending_);
  for (const auto& device : devices_)
    if (device->stats().name == name) return device->stats().busy_ns;
  return fail(ErrorCode::kNotFound, "there is no emulated XPU '" + name + "'");
}

Result<Progress> Machine::progress(ContextId context, std::uint64_t tag) {
  XAUTO_ASSIGN(const Device* const device, device_of(context));
  return device->progress(context, tag);
}

void Machine::save(Snapshot& snapshot) const {
  snapshot.next_id = next_id_;
  snapshot.script_begin = script_begin_;
  snapshot.devices.clear();
  snapshot.contexts.clear();
  for (const auto& device : devices_) device->save(snapshot);
}

Result<Machine> Machine::restore(const Platform& platform, const Snapshot& snapshot, Nanos now,
                                 const EmulationScript& script) {
  XAUTO_ASSIGN(Machine machine, create(platform, script));
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
    if (record.now != snapshot.devices.front().now)
      return fail(ErrorCode::kInvalid, "is at another time than others",
                  machine.devices_[i]->stats().name);
    XAUTO_TRY(machine.devices_[i]->restore(record, own, now));
    machine.time_ = record.now;
  }
  if (!left.empty()) return fail(ErrorCode::kInvalid, "contexts are on no device");
  machine.next_id_ = snapshot.next_id;
  if (snapshot.script_begin < -1 || snapshot.script_begin > machine.time_)
    return fail(ErrorCode::kInvalid, "its script began at an impossible time");
  machine.script_begin_ = snapshot.script_begin;
  machine.take_steps(machine.pending_);
  machine.tune(machine.pending_, false);
  machine.pending_.clear();  // nothing has changed
  return machine;
}

Nanos Machine::next_event() const {
  Nanos next = next_change();
  if (!pending_.empty()) next = pending_.front().time;
  for (const auto& device : devices_) next = std::min(next, device->next_event());
  return next;
}

void Machine::advance(Nanos now, std::vector<Event>& events) {
  thread_.check();
  // `events` may be pending_ itself: calls collect there what happened on the way.
  std::vector<Event> happened;
  if (&events != &pending_) happened.swap(pending_);
  for (;;) {
    Nanos next = next_change();
    for (const auto& device : devices_) next = std::min(next, device->next_event());
    if (next > now) break;
    time_ = std::max(time_, next);
    for (const auto& device : devices_)
      while (device->next_event() <= next) device->advance(next, happened);
    if (script_->empty()) continue;
    take_steps(happened);
    tune(happened);
  }
  // What is left of the interval brings no event.
  time_ = std::max(time_, now);
  for (const auto& device : devices_) device->advance(now, happened);
  std::stable_sort(happened.begin(), happened.end(),
                   [](const Event& a, const Event& b) { return a.time < b.time; });
  events.insert(events.end(), happened.begin(), happened.end());
}

Nanos Machine::next_change() const {
  if (script_begin_ < 0) return kNever;
  const Nanos next = script_->next_change(time_ - script_begin_);
  return next == kNever ? kNever : script_begin_ + next;
}

/// Those of the script that are due.
void Machine::take_steps(std::vector<Event>& events) {
  if (script_->empty() || script_begin_ < 0) return;
  const std::size_t steps = script_->steps_at(time_ - script_begin_);
  if (steps == steps_) return;
  steps_ = steps;
  events.push_back({Event::Kind::kScript, 0, steps, time_});
  const ScriptPlay::State& state = script_->after(steps);
  const auto said = [](const auto& percents, const std::string& type, Nanos otherwise) {
    const auto found = percents.find(type);
    return found == percents.end() ? otherwise : found->second;
  };
  for (ScriptedDevice& part : parts_) {
    part.speed_pct = said(state.speed_pct, part.type, 100);
    part.contention_pct = said(state.contention_pct, part.type, 0);
    part.cores = std::count_if(part.xpus.begin(), part.xpus.end(),
                               [&](const std::string& id) { return !state.stopped.contains(id); });
  }
}

/// To what the script says and who is busy now. `advance`: the devices were as they are until now; not
/// so those of a machine that is being restored, which nobody has told yet that they are stopped.
void Machine::tune(std::vector<Event>& events, bool advance) {
  if (script_->empty()) return;
  // Only what stops or goes on changes who is busy meanwhile: again until nothing does.
  for (bool changed = true; changed;) {
    changed = false;
    Nanos busy = 0;
    for (std::size_t d = 0; d < devices_.size(); ++d)
      if (parts_[d].contention_pct > 0) busy += std::min(parts_[d].cores, devices_[d]->load());
    for (std::size_t d = 0; d < devices_.size(); ++d) {
      const ScriptedDevice& part = parts_[d];
      const Nanos others = part.contention_pct > 0 ? std::max<Nanos>(0, busy - 1) : 0;
      const Nanos rate =
          std::max<Nanos>(1, kUnits * part.speed_pct / (100 + part.contention_pct * others));
      if (devices_[d]->is_tuned(rate, part.cores)) continue;
      if (advance) devices_[d]->advance(time_, events);
      devices_[d]->tune(rate, part.cores, events);
      changed = true;
    }
  }
}

std::vector<DeviceStats> Machine::stats() const {
  std::vector<DeviceStats> all;
  for (const auto& device : devices_) all.push_back(device->stats());
  return all;
}

}  // namespace xauto::emu
