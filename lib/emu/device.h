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
  Device(std::string name, bool preemptive, Nanos preempt_ns, int levels, Nanos cores)
      : preemptive_(preemptive), preempt_ns_(preempt_ns), levels_(levels), cores_(cores) {
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

  [[nodiscard]] Nanos next_event() const;
  /// One step: up to the next event or `limit`, whichever is first.
  void advance(Nanos limit, std::vector<Event>& events);

  /// From now on, up to which it has been brought: work progresses by `rate` units in a nanosecond,
  /// on so many cores; 0: it is stopped.
  void tune(Nanos rate, Nanos cores, std::vector<Event>& events);
  [[nodiscard]] bool is_tuned(Nanos rate, Nanos cores) const {
    return rate == rate_ && cores == cores_;
  }
  /// How many contexts have work that may run at once, however many cores there are.
  [[nodiscard]] virtual Nanos load() const = 0;

  [[nodiscard]] const DeviceStats& stats() const { return stats_; }

  /// Appends the device and its contexts.
  void save(Snapshot& snapshot) const;
  /// Into a device without contexts. An error leaves it unfit for use.
  Status restore(const DeviceRecord& record, std::span<const ContextRecord> contexts, Nanos now);

 protected:
  struct Context {
    bool busy = false, suspended = false;
    std::uint64_t tag = 0;    ///< of the job, or of the last one
    Nanos left = 0;           ///< in units
    std::uint64_t block = 0;  ///< suspended: the preemption that took it off; 0: none
    int level = 0;
    [[nodiscard]] bool runnable() const { return busy && !suspended; }
  };
  struct Ack {
    ContextId context;
    std::uint64_t tag;
  };
  struct Stuck {
    ContextId context;
    std::uint64_t tag;
    Nanos until;  ///< then it is refused
  };

  [[nodiscard]] virtual Nanos next_of_work() const = 0;
  virtual void advance_work(Nanos limit, std::vector<Event>& events) = 0;
  /// Whether work of `id` has begun to progress and has not been taken off.
  [[nodiscard]] virtual bool is_on(ContextId id) const = 0;

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

  [[nodiscard]] bool stopped() const { return cores_ == 0; }
  /// Nanoseconds at this rate until so much work is done.
  [[nodiscard]] Nanos time_for(Nanos units) const { return (units + rate_ - 1) / rate_; }

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
  std::deque<Stuck> stuck_;  ///< only on one that is stopped; by time
  Nanos rate_ = kUnits;
  Nanos cores_ = 1;
  std::map<ContextId, Context> contexts_;
  DeviceStats stats_;
};

class TimeSliced final : public Device {
 public:
  TimeSliced(std::string name, bool preemptive, Nanos preempt_ns, Nanos slice_ns, Nanos switch_ns,
             int levels)
      : Device(std::move(name), preemptive, preempt_ns, levels, 1),
        slice_ns_(slice_ns),
        switch_ns_(switch_ns) {}
  [[nodiscard]] Nanos load() const override { return queue_.empty() ? 0 : 1; }

 private:
  [[nodiscard]] Nanos next_of_work() const override;
  void advance_work(Nanos limit, std::vector<Event>& events) override;
  [[nodiscard]] bool is_on(ContextId id) const override {
    return on_device_ && queue_.front() == id;
  }
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
      : Device(std::move(name), preemptive, preempt_ns, 0, cores) {}
  [[nodiscard]] Nanos load() const override { return static_cast<Nanos>(running_.size()); }

 private:
  [[nodiscard]] Nanos next_of_work() const override;
  void advance_work(Nanos limit, std::vector<Event>& events) override;
  [[nodiscard]] bool is_on(ContextId id) const override {
    return std::find(running_.begin(), running_.end(), id) != running_.end();
  }
  void join(ContextId id) override { running_.push_back(id); }
  void leave(ContextId id) override { std::erase(running_, id); }
  bool evict(ContextId id) override {
    const bool there = is_on(id);
    leave(id);
    return there && preempt_ns_ > 0;
  }
  [[nodiscard]] std::vector<ContextId> order() const override { return running_; }

  std::vector<ContextId> running_;
};

}  // namespace xauto::emu
