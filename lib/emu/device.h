// SPDX-License-Identifier: Apache-2.0
// One emulated device; see machine.h for the rules.
#pragma once

#include <algorithm>
#include <deque>
#include <map>
#include <span>
#include <vector>

#include "emu/machine.h"
#include "emu/snapshot.h"

namespace xauto::emu {

class Device {
 public:
  Device(std::string name, bool preemptive, Nanos preempt_ns, int levels = 0)
      : preemptive_(preemptive), preempt_ns_(preempt_ns), levels_(levels) {
    stats_.name = std::move(name);
  }
  virtual ~Device() = default;

  void open(ContextId id) { contexts_[id] = {}; }
  void close(ContextId id) {
    leave(id);
    contexts_.erase(id);
  }
  [[nodiscard]] Progress progress(ContextId id, std::uint64_t tag) const {
    const Context& context = contexts_.at(id);
    if (context.tag != tag) return Progress::kUnknown;
    return context.busy ? Progress::kUnderWay : Progress::kDone;
  }
  Status submit(ContextId id, std::uint64_t tag, Nanos work_ns);
  Status suspend(ContextId id, std::uint64_t tag, Nanos now, std::vector<Event>& events);
  Status resume(ContextId id, std::uint64_t tag, Nanos now, std::vector<Event>& events);
  Status level(ContextId id, int level);

  [[nodiscard]] virtual Nanos next_event() const = 0;
  /// One step: up to the next event or `limit`, whichever is first.
  virtual void advance(Nanos limit, std::vector<Event>& events) = 0;

  [[nodiscard]] const DeviceStats& stats() const { return stats_; }

  /// Appends the device and its contexts.
  void save(Snapshot& snapshot) const;
  /// Into a device without contexts. An error leaves it unfit for use.
  Status restore(const DeviceRecord& record, std::span<const ContextRecord> contexts, Nanos now);

 protected:
  struct Context {
    bool busy = false, suspended = false;
    std::uint64_t tag = 0;  ///< of the job, or of the last one
    Nanos left_ns = 0;
    std::uint64_t block = 0;  ///< suspended: the preemption that took it off; 0: none
    int level = 0;
    [[nodiscard]] bool runnable() const { return busy && !suspended; }
  };
  struct Ack {
    ContextId context;
    std::uint64_t tag;
  };

  /// `id` has become runnable (work and enabled), or stops being so.
  virtual void join(ContextId id) = 0;
  virtual void leave(ContextId id) = 0;
  /// Takes `id` off the device if it is on it: true if that blocks the device for preempt_ns.
  virtual bool evict(ContextId id) = 0;
  /// Those that are runnable, in their order.
  [[nodiscard]] virtual std::vector<ContextId> order() const = 0;
  /// What the kind of device has beyond its contexts.
  virtual void save_more(DeviceRecord&) const {}
  virtual Status restore_more(const DeviceRecord&) { return {}; }

  void finish(ContextId id, Nanos time, std::vector<Event>& events) {
    Context& context = contexts_[id];
    context.busy = false;
    ++stats_.jobs;
    events.push_back({Event::Kind::kDone, id, context.tag, time});
  }

  /// Whoever is on the device has just been taken off it, at now_.
  void block(Nanos now) {
    // A second preemption within the first one's time waits for it.
    ++stats_.preemptions;
    stats_.overhead_ns += preempt_ns_;
    if (blocked_until_ <= now) ++block_;
    blocked_until_ = std::max(blocked_until_, now) + preempt_ns_;
  }

  const bool preemptive_;
  const Nanos preempt_ns_;
  const int levels_;  ///< 0: one
  Nanos now_ = 0;
  Nanos blocked_until_ = 0;  ///< a preemption is in progress, or several in a row
  std::uint64_t block_ = 0;  ///< its number
  std::vector<Ack> acks_;    ///< due at blocked_until_
  std::map<ContextId, Context> contexts_;
  DeviceStats stats_;
};

class TimeSliced final : public Device {
 public:
  TimeSliced(std::string name, bool preemptive, Nanos preempt_ns, Nanos slice_ns, Nanos switch_ns,
             int levels)
      : Device(std::move(name), preemptive, preempt_ns, levels),
        slice_ns_(slice_ns),
        switch_ns_(switch_ns) {}
  [[nodiscard]] Nanos next_event() const override;
  void advance(Nanos limit, std::vector<Event>& events) override;

 private:
  void join(ContextId id) override;
  void leave(ContextId id) override;
  bool evict(ContextId id) override;
  [[nodiscard]] std::vector<ContextId> order() const override {
    return {queue_.begin(), queue_.end()};
  }
  void save_more(DeviceRecord& record) const override;
  Status restore_more(const DeviceRecord& record) override;

  /// Behind those of its level.
  void enqueue(ContextId id);
  [[nodiscard]] bool takes_turns() const;

  const Nanos slice_ns_, switch_ns_;
  std::deque<ContextId> queue_;  ///< runnable, by level; the front is on the device
  bool on_device_ = false;       ///< the front has begun its slice
  Nanos slice_left_ = 0;
  Nanos switch_until_ = 0;
};

class Shared final : public Device {
 public:
  Shared(std::string name, bool preemptive, Nanos preempt_ns, std::int64_t cores)
      : Device(std::move(name), preemptive, preempt_ns), cores_(cores) {}
  [[nodiscard]] Nanos next_event() const override;
  void advance(Nanos limit, std::vector<Event>& events) override;

 private:
  void join(ContextId id) override { running_.push_back(id); }
  void leave(ContextId id) override { std::erase(running_, id); }
  bool evict(ContextId id) override {
    const bool there = std::find(running_.begin(), running_.end(), id) != running_.end();
    leave(id);
    return there && preempt_ns_ > 0;
  }
  [[nodiscard]] std::vector<ContextId> order() const override { return running_; }

  const std::int64_t cores_;
  std::vector<ContextId> running_;
};

}  // namespace xauto::emu
