// SPDX-License-Identifier: Apache-2.0
// Time is in nanoseconds inside, so that ideal sharing among n XNodes is exact to n ns; results are
// rounded up to microseconds. The rules are those of the emulated devices (lib/emu/machine.h), and
// a test compares the two: XNodes that share an XPU progress at rate min(1, cores / XNodes); XNodes
// that take turns get a time slice each in order of arrival, and switching to another one while
// work is left costs switch_us.
#include "bench/synthetic/time_sharing.h"

#include <algorithm>
#include <deque>
#include <limits>

#include "base/index.h"

namespace xauto::bench {
namespace {

using solver::Decision, solver::kCannotRun, solver::Problem, solver::Simulation, solver::Slice,
    solver::Time;
using Nanos = std::int64_t;
constexpr Nanos kNoEventNs = std::numeric_limits<Nanos>::max();
constexpr Nanos kMicro = 1000;

Time micros_up(Nanos ns) {
  return (ns + kMicro - 1) / kMicro;
}

/// One time-shared resource: an XPU instance, or the pool of all CPUs.
class Resource {
 public:
  Resource(int xpu, std::int64_t cores, Nanos slice, Nanos switch_cost, bool preemptive,
           bool record, std::vector<Slice>& slices)
      : xpu_(xpu),
        cores_(cores),
        slice_(slice),
        switch_cost_(switch_cost),
        preemptive_(preemptive),
        record_(record),
        slices_(slices) {}

  [[nodiscard]] std::size_t load() const { return queue_.size(); }

  void add(int xnode, Nanos work) { queue_.push_back({xnode, work}); }

  [[nodiscard]] Nanos next_event() const {
    if (queue_.empty()) return kNoEventNs;
    if (slice_ == 0) {
      Nanos least = kNoEventNs;
      for (const Item& item : queue_) least = std::min(least, item.left);
      const auto sharers = static_cast<std::int64_t>(queue_.size());
      return now_ + (sharers <= cores_ ? least : (least * sharers + cores_ - 1) / cores_);
    }
    const Nanos begin = std::max(now_, switch_until_);
    return begin +
           (takes_turns() ? std::min(queue_.front().left, slice_left_) : queue_.front().left);
  }

  /// Moves to `until`, at most the next event; appends the XNodes that end there.
  void advance(Nanos until, std::vector<int>& ended) {
    if (!queue_.empty() && slice_ == 0)
      share(until, ended);
    else if (!queue_.empty())
      take_turns(until, ended);
    now_ = until;
  }

 private:
  struct Item {
    int xnode;
    Nanos left;
  };

  [[nodiscard]] bool takes_turns() const { return preemptive_ && queue_.size() > 1; }

  void share(Nanos until, std::vector<int>& ended) {
    const auto sharers = static_cast<std::int64_t>(queue_.size());
    const Nanos elapsed = until - now_;
    const Nanos progress = sharers <= cores_ ? elapsed : elapsed * cores_ / sharers;
    for (Item& item : queue_) {
      if (elapsed > 0) note(item.xnode, now_, until, false);
      item.left -= std::min(item.left, progress);
      if (item.left == 0) ended.push_back(item.xnode);
    }
    std::erase_if(queue_, [](const Item& item) { return item.left == 0; });
  }

  void take_turns(Nanos until, std::vector<int>& ended) {
    const Nanos begin = std::max(now_, switch_until_);
    if (until <= begin) return;
    Item& front = queue_.front();
    const Nanos ran = until - begin;
    const bool turns = takes_turns();
    note(front.xnode, begin, until, false);
    front.left -= ran;
    // Alone, an XNode's slice is renewed for free; a newcomer finds it wherever it happens to be.
    slice_left_ -= ran % slice_;
    if (slice_left_ <= 0) slice_left_ += slice_;
    if (front.left == 0) {
      ended.push_back(front.xnode);
      queue_.pop_front();
      slice_left_ = slice_;
    } else if (turns && slice_left_ == slice_) {
      queue_.push_back(front);
      queue_.pop_front();
      switch_until_ = until + switch_cost_;
      if (switch_cost_ > 0) note(queue_.front().xnode, until, switch_until_, true);
    }
  }

  void note(int xnode, Nanos begin, Nanos end, bool switching) {
    if (!record_) return;
    const Time b = begin / kMicro, e = micros_up(end);
    if (!slices_.empty()) {
      Slice& last = slices_.back();
      if (last.xnode == xnode && last.xpu == xpu_ && last.switching == switching && last.end >= b) {
        last.end = e;
        return;
      }
    }
    if (e > b) slices_.push_back({xnode, xpu_, b, e, switching});
  }

  const int xpu_;
  const std::int64_t cores_;
  const Nanos slice_, switch_cost_;
  const bool preemptive_, record_;
  std::vector<Slice>& slices_;
  std::deque<Item> queue_;
  Nanos now_ = 0, slice_left_ = slice_, switch_until_ = 0;
};

/// The type on which `xnode` is fastest; among equals the first in the platform's order.
int fastest_type(const Problem& p, int xnode) {
  int best = -1;
  for (int t = 0; t < p.num_types; ++t)
    if (p.wcet(xnode, t) != kCannotRun && (best < 0 || p.wcet(xnode, t) < p.wcet(xnode, best)))
      best = t;
  return best;
}

}  // namespace

Simulation share_time(const Problem& p, const Platform& platform, Sharing sharing,
                      const Decision& decision, const SharingOptions& options) {
  Simulation result;
  std::vector<Resource> resources;
  std::vector<int> resource_of(at(p.num_xpus), -1);  ///< [xpu]
  const bool ros2 = sharing == Sharing::kRos2;
  int pool = -1;
  for (int m = 0; m < p.num_xpus; ++m) {
    const Xpu& xpu = platform.xpus[at(m)];
    const bool cpu = xpu.type == "cpu";
    if (cpu && ros2) {
      if (pool < 0) {
        pool = static_cast<int>(resources.size());
        resources.emplace_back(m,
                               static_cast<std::int64_t>(p.type_xpus[at(p.xpu_type[at(m)])].size()),
                               0, 0, true, options.slices, result.slices);
      }
      resource_of[at(m)] = pool;
      continue;
    }
    // Not preemptive: nothing switches, each XNode runs to its end; a slice only makes it take
    // turns.
    const Nanos slice = options.ideal && xpu.preemptive ? 0
                        : !xpu.preemptive ? std::max<Nanos>(1, xpu.timeslice_us * kMicro)
                                          : xpu.timeslice_us * kMicro;
    resource_of[at(m)] = static_cast<int>(resources.size());
    resources.emplace_back(m, 1, slice, options.ideal ? 0 : xpu.effective_switch_us() * kMicro,
                           xpu.preemptive, options.slices, result.slices);
  }

  const std::size_t n = at(p.num_xnodes);
  std::vector<int> waits_for(n);
  result.xpu.assign(n, -1);
  result.start.assign(n, 0);
  result.finish.assign(n, 0);
  const auto begin = [&](int i, Nanos now) {
    int xpu = ros2 ? -1 : decision.xpu[at(i)];
    if (ros2)  // the instance of the fastest type with the fewest XNodes now
      for (const int m : p.type_xpus[at(fastest_type(p, i))])
        if (xpu < 0 ||
            resources[at(resource_of[at(m)])].load() < resources[at(resource_of[at(xpu)])].load())
          xpu = m;
    result.xpu[at(i)] = xpu;
    result.start[at(i)] = micros_up(now);
    resources[at(resource_of[at(xpu)])].add(i, p.wcet_on(i, xpu) * kMicro);
  };
  for (std::size_t i = 0; i < n; ++i) waits_for[i] = static_cast<int>(p.pred[i].size());
  for (int i = 0; i < p.num_xnodes; ++i)
    if (waits_for[at(i)] == 0) begin(i, 0);
  for (;;) {
    Nanos next = kNoEventNs;
    for (const Resource& resource : resources) next = std::min(next, resource.next_event());
    if (next == kNoEventNs) break;
    std::vector<int> ended;
    for (Resource& resource : resources) resource.advance(next, ended);
    std::sort(ended.begin(), ended.end());
    for (const int i : ended) result.finish[at(i)] = micros_up(next);
    // What becomes ready at one instant arrives in the order of the app.
    std::vector<int> ready;
    for (const int i : ended)
      for (const int s : p.succ[at(i)])
        if (--waits_for[at(s)] == 0) ready.push_back(s);
    std::sort(ready.begin(), ready.end());
    for (const int i : ready) begin(i, next);
  }
  for (const Time finish : result.finish) result.makespan = std::max(result.makespan, finish);
  return result;
}

}  // namespace xauto::bench
