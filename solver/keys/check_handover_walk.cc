// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/check_handover_walk.h"

namespace xauto::solver::keys::checking::tables {

Walk::Walk(const Both& both, int clock, Ticks hyperperiod)
    : both_(both),
      hyperperiod_(hyperperiod),
      drift_{both.p.app.clocks[at(clock)].ppm},
      asks_q_(drift_.ppm > 0 ||
              std::ranges::any_of(both.p.platform.xpus, [](const Xpu& x) { return x.levels > 0; })),
      lags_(both.p.wcet.size()) {
  for (std::size_t c = 0; c < both.p.components.size(); ++c) {
    if (both.p.components[c].clock != clock) continue;
    components_.push_back(static_cast<int>(c));
    step_ = std::max(step_, both.p.components[c].period);
    for (const int i : both.p.components[c].xnodes)
      for (const bool of_q : {false, true})
        for (const Window& window : both.of(of_q).windows[at(i)]) {
          deepest_ = std::max(deepest_, window.d);
          if (of_q) deepest_of_q_ = std::max(deepest_of_q_, window.d);
        }
  }
  blur_ = drift_.late(deepest_) - drift_.soon(deepest_);
  deepest_of_q_ += 2 * (drift_.late(deepest_of_q_) - deepest_of_q_);
  lines_.resize(both.p.platform.xpus.size());
  jobs_of_.resize(both.p.wcet.size());
  first_kept_.resize(both.p.wcet.size());
  first_of_q_.resize(both.p.components.size());
}

bool Walk::run(Ticks change, Ticks low, Ticks high, std::size_t most) {
  most_ = std::min(most, kMaxJobsOfAWalk);
  begin(change, low, high);
  std::vector<int> batch;
  while (true) {
    if (!know_fresh()) return false;
    // What is released before a key may have a smaller one.
    if (heap_.empty() || jobs_[at(heap_.top().second)].late >= generated_) {
      if (!generate(generated_ + 1)) return false;
      continue;
    }
    const Ticks key = heap_.top().first;
    if (key > span_end()) return true;
    if (key > change_ + kMostHyperperiods * hyperperiod_ + 4 * deepest_) return false;
    // Of equal keys: A of all of them first, so that nothing depends on their order.
    batch.clear();
    while (!heap_.empty() && heap_.top().first == key) {
      batch.push_back(heap_.top().second);
      heap_.pop();
    }
    for (const int x : batch)
      if (!asks_q_ && !know(x)) return false;
    for (const int x : batch)
      if (!generate(jobs_[at(x)].late + 1)) return false;
    if (!know_fresh()) return false;
    for (const int x : batch) {
      WalkedJob& job = jobs_[at(x)];
      find_end(job);
      note_end(x);
      const bool late = asks_q_ ? !job.clean
                                : !job.of_q || job.ended > job.key ||
                                      job.ready > job.release + both_.q.window(job.xnode, job.n).a;
      if (late) last_ = std::max({last_, job.key, job.ready, job.ended});
    }
    for (const int x : batch) release_waiting(jobs_[at(x)]);
  }
}

Ticks Walk::end(int xnode, std::int64_t n) const {
  const WalkedJob* job = find(xnode, n);
  if (job != nullptr && job->ended < kUnknown) return job->ended;
  return release(xnode, n) + drift_.late(window(xnode, n).d);
}

void Walk::begin(Ticks change, Ticks low, Ticks high) {
  change_ = generated_ = change;
  low_ = low;
  high_ = high;
  last_ = -kUnknown;
  all_work_ = 0;
  jobs_.clear();
  fresh_.clear();
  heap_ = {};
  for (std::size_t m = 0; m < lines_.size(); ++m) {
    const Xpu& xpu = both_.p.platform.xpus[m];
    lines_[m] = {};
    lines_[m].blocks = !xpu.preemptive || xpu.levels > 0;
    lines_[m].cost = xpu.preemptive ? xpu.preempt_us * both_.p.scale : 0;
  }
  for (const int c : components_) {
    const Component& home = both_.p.components[at(c)];
    const std::int64_t first = ceil_div(change - home.phi, home.period);
    first_of_q_[at(c)] = first;
    for (const int i : home.xnodes) {
      jobs_of_[at(i)].clear();
      // Keys do not fall from one activation to the next.
      std::int64_t n = first;
      const auto key_late = [&](std::int64_t k) {
        return release(i, k) + drift_.late(both_.p.window(i, k).d);
      };
      while (key_late(n - 1) >= high) --n;
      first_kept_[at(i)] = n;
      for (; n < first; ++n) {
        add(i, n);
        last_ = std::max(last_, jobs_.back().key);
      }
      auto& without = lines_[at(both_.p.policy.placements[at(i)].xpu)].without_change;
      for (n = first_kept_[at(i)]; release(i, n) < change + hyperperiod_; ++n)
        if (const Ticks d = both_.p.window(i, n).d; release(i, n) + d <= change + hyperperiod_)
          without.emplace_back(release(i, n) + drift_.soon(d), key_late(n),
                               drift_.shortest(both_.p.wcet[at(i)]));
    }
  }
  for (Line& line : lines_) std::sort(line.without_change.begin(), line.without_change.end());
  for (std::size_t k = 0; k < jobs_.size(); ++k) {
    Line& line = lines_[at(jobs_[k].xpu)];
    line.of_p.push_back(static_cast<int>(k));
    ++line.of_p_left;
  }
  ready_to_walk(0);
}

void Walk::add(int xnode, std::int64_t n) {
  const bool q = of_q(xnode, n);
  const World& w = both_.of(q);
  const Window& window = w.window(xnode, n);
  WalkedJob job;
  job.xnode = xnode;
  job.xpu = w.policy.placements[at(xnode)].xpu;
  job.n = n;
  job.of_q = q;
  job.release = release(xnode, n);
  job.key = job.release + window.d;
  job.soon = job.release + drift_.soon(window.d);
  job.late = job.release + drift_.late(window.d);
  job.starts = job.release + drift_.soon(window.e);
  // As long as A is not known it may preempt.
  job.work = work_of(job, lines_[at(job.xpu)].cost);
  all_work_ += job.work;
  jobs_of_[at(xnode)].push_back(static_cast<int>(jobs_.size()));
  jobs_.push_back(job);
}

bool Walk::generate(Ticks until) {
  if (until <= generated_) return true;
  until = std::max(until, generated_ + step_);
  const std::size_t old = jobs_.size();
  for (const int c : components_) {
    const Component& home = both_.p.components[at(c)];
    for (std::int64_t n = ceil_div(generated_ - home.phi, home.period);
         home.phi + n * home.period < until; ++n) {
      if (jobs_.size() > most_ || all_work_ > kMaxWork) return false;
      for (const int i : home.xnodes) add(i, n);
    }
  }
  generated_ = until;
  ready_to_walk(old);
  return true;
}

void Walk::ready_to_walk(std::size_t old) {
  std::vector<std::size_t> sizes;
  for (const Line& line : lines_) sizes.push_back(line.all.size());
  for (std::size_t k = old; k < jobs_.size(); ++k) {
    WalkedJob& job = jobs_[k];
    lines_[at(job.xpu)].all.emplace_back(job.soon, static_cast<int>(k));
    for_each_before(job, [&](const WalkedJob& before) { job.waits += before.ended == kUnknown; });
    if (job.waits == 0) walk_next(static_cast<int>(k));
  }
  for (std::size_t m = 0; m < lines_.size(); ++m) {
    auto& all = lines_[m].all;
    const auto middle = all.begin() + static_cast<std::ptrdiff_t>(sizes[m]);
    std::sort(middle, all.end());
    std::inplace_merge(all.begin(), middle, all.end());
  }
}

bool Walk::know_fresh() {
  while (!fresh_.empty()) {
    const int x = fresh_.back();
    fresh_.pop_back();
    if (!know(x)) return false;
  }
  return true;
}

bool Walk::know(int x) {
  const Ticks ready = by_when_ready(jobs_[at(x)]);
  if (!generate(ready)) return false;  // who may have started before
  WalkedJob& job = jobs_[at(x)];
  job.ready = ready;
  job.on_time = asks_q_ && is_on_time(job);
  charge(job);
  insert(x);
  return true;
}

const WalkedJob* Walk::find(int xnode, std::int64_t n) const {
  const auto& own = jobs_of_[at(xnode)];
  const std::int64_t k = n - first_kept_[at(xnode)];
  if (k < 0 || k >= static_cast<std::int64_t>(own.size())) return nullptr;
  return &jobs_[at(own[static_cast<std::size_t>(k)])];
}

void Walk::release_waiting(const WalkedJob& job) {
  const World& w = both_.p;
  const auto one = [&](int i, std::int64_t n) {
    const WalkedJob* after = find(i, n);
    if (after == nullptr) return;  // not generated yet
    const auto k = static_cast<std::size_t>(after - jobs_.data());
    if (--jobs_[k].waits == 0) walk_next(static_cast<int>(k));
  };
  for (const int v : w.after[at(job.xnode)]) one(v, job.n);
  one(job.xnode, job.n + 1);
  const int m = w.module_of[at(job.xnode)];
  for (const int i : w.module_xnodes[at(m)])
    if (w.entry[at(i)]) one(i, job.n + w.in_flight[at(m)]);
}

bool Walk::waits_for(const WalkedJob& job, const WalkedJob& other) {
  if (both_.p.component_of[at(job.xnode)] != both_.p.component_of[at(other.xnode)]) return false;
  auto& lags = lags_[at(other.xnode)];
  if (lags.empty()) lags = both_.p.lags_after(other.xnode);
  return job.n - other.n >= lags[at(job.xnode)];
}

Ticks Walk::by_when_ready(const WalkedJob& x) const {
  const World& w = both_.of(x.of_q);
  const Component& home = w.home(x.xnode);
  Ticks ready = x.release;
  for (const int s : w.app.xnodes[at(x.xnode)].sources) {
    const SourceSpec& source = w.app.sources[at(s)];
    ready = std::max(ready, x.release - home.phi + source.offset_us * w.scale +
                                drift_.longest(source.jitter_us * w.scale));
  }
  const auto& holds = w.policy.placements[at(x.xnode)].hold_us;
  if (!holds.empty()) {
    const auto size = static_cast<std::int64_t>(holds.size());
    const auto j = static_cast<std::size_t>((x.n % size + size) % size);
    ready = std::max(ready, x.release + drift_.longest(holds[j] * w.scale));
  }
  for (const auto& [u, transfer] : w.before[at(x.xnode)])
    ready = std::max(ready, end(u, x.n) + drift_.longest(transfer));
  const int m = w.module_of[at(x.xnode)];
  if (w.entry[at(x.xnode)])
    for (const int i : w.module_xnodes[at(m)])
      ready = std::max(ready, end(i, x.n - w.in_flight[at(m)]));
  const WalkedJob* previous = find(x.xnode, x.n - 1);
  if (previous == nullptr) {  // it has ended by its key, which is at most t'
    const World& before = both_.of(of_q(x.xnode, x.n - 1));
    return std::max(ready,
                    release(x.xnode, x.n - 1) + drift_.longest(before.window(x.xnode, x.n - 1).a));
  }
  return std::max(ready, leaves_it(x, *previous));
}

Ticks Walk::leaves_it(const WalkedJob& x, const WalkedJob& previous) {
  const bool larger_key = previous.of_q != x.of_q && previous.late > x.soon;
  return previous.xpu != x.xpu || larger_key ? std::max(previous.ready, previous.ended)
                                             : previous.ready;
}

bool Walk::is_on_time(const WalkedJob& x) const {
  if (!x.of_q) return false;
  const World& w = both_.q;
  const Ticks by = opens(x);
  const auto fits = [&](int i, std::int64_t n, Ticks transfer) {
    const WalkedJob* before = find(i, n);
    return (before != nullptr && before->clean) || end(i, n) + drift_.longest(transfer) <= by;
  };
  for (const auto& [u, transfer] : w.before[at(x.xnode)])
    if (!fits(u, x.n, transfer)) return false;
  const int m = w.module_of[at(x.xnode)];
  if (w.entry[at(x.xnode)])
    for (const int i : w.module_xnodes[at(m)])
      if (!fits(i, x.n - w.in_flight[at(m)], 0)) return false;
  const WalkedJob* previous = find(x.xnode, x.n - 1);
  return previous == nullptr || previous->on_time || leaves_it(x, *previous) <= by;
}

void Walk::charge(WalkedJob& x) {
  const Ticks cost = lines_[at(x.xpu)].cost;
  if (cost == 0) return;
  bool pays = false;
  for_each_started(x, x.ready, [&](const WalkedJob& other) {
    pays = other.xnode != x.xnode && !(asks_q_ && waits_for(x, other));
    return !pays;
  });
  if (!pays) x.work = work_of(x, 0);
}

void Walk::insert(int x) {
  Line& line = lines_[at(jobs_[at(x)].xpu)];
  const auto place = std::ranges::upper_bound(line.known, jobs_[at(x)].ready, {},
                                              [&](int y) { return jobs_[at(y)].ready; });
  const auto k = static_cast<std::size_t>(place - line.known.begin());
  line.known.insert(place, x);
  line.pending.push_back(x);
  set_latest(line, k);
}

void Walk::note_end(int x) {
  Line& line = lines_[at(jobs_[at(x)].xpu)];
  const auto found = std::find(line.known.rbegin(), line.known.rend(), x);
  set_latest(line, static_cast<std::size_t>(line.known.rend() - found) - 1);
  std::erase(line.pending, x);
  if (const WalkedJob& job = jobs_[at(x)]; !job.of_q) {
    --line.of_p_left;
    line.of_p_ended = std::max(line.of_p_ended, job.ended);
  }
  while (line.low < line.all.size() && jobs_[at(line.all[line.low].second)].ended < kUnknown)
    ++line.low;
}

void Walk::set_latest(Line& line, std::size_t from) {
  line.latest.resize(line.known.size());
  for (std::size_t k = from; k < line.known.size(); ++k) {
    const Ticks ended = jobs_[at(line.known[k])].ended;
    line.latest[k] =
        std::max(k > 0 ? line.latest[k - 1] : -kUnknown, ended < kUnknown ? ended : -kUnknown);
  }
}

void Walk::find_blockers(const WalkedJob& x) {
  blockers_.clear();
  if (!lines_[at(x.xpu)].blocks) return;
  for_each_started(x, std::max(x.ready, high_), [&](const WalkedJob& other) {
    // What x waits for has a smaller key, or A(x) is at least its F, which counts V(s) too.
    if (!asks_q_ || !waits_for(x, other)) blockers_.push_back({&other, other.work});
    return true;
  });
}

void Walk::count(const WalkedJob& of_v) {
  for (Blocker& b : blockers_) {
    if (waits_for(*b.job, of_v)) b.left -= of_v.work;
    if (b.job == &of_v) b.left = 0;
  }
}

Ticks Walk::blocked(Ticks s) const {
  Ticks longest = 0;
  for (const Blocker& b : blockers_)
    if (b.job->starts < s) longest = std::max(longest, b.left);
  return longest;
}

Ticks Walk::blocked_at_high(const WalkedJob& x) const {
  Ticks longest = 0;
  for (const Blocker& b : blockers_)
    if (b.job->starts < high_ && b.job->soon > x.late) longest = std::max(longest, b.left);
  return longest;
}

bool Walk::meets_p(const WalkedJob& x, Ticks s, Ticks least_key) const {
  const Line& line = lines_[at(x.xpu)];
  if (!line.blocks && line.cost == 0) return false;
  if (line.of_p_left == 0 && line.of_p_ended <= s) return false;
  return std::ranges::any_of(line.of_p, [&](int k) {
    const WalkedJob& job = jobs_[at(k)];
    return job.ended > s && ((line.blocks && job.late > x.soon && job.starts < s) ||
                             (line.cost > 0 && job.late > least_key));
  });
}

void Walk::find_end(WalkedJob& x) {
  const Line& line = lines_[at(x.xpu)];
  find_blockers(x);
  Ticks sum = 0, worst = 0;
  bool clean = x.on_time, certain = true;  // certain: all of V(s) are known, of q, and on time
  for (std::size_t k = line.low; k < line.all.size() && line.all[k].first <= x.late; ++k) {
    const WalkedJob& y = jobs_[at(line.all[k].second)];
    if (y.ready < kUnknown) continue;
    sum += y.work;
    count(y);
    certain = false;
  }
  const auto is_before = [&](int y) { return jobs_[at(y)].soon <= x.late; };
  auto pending = std::ranges::count_if(line.pending, is_before);  // of V, not in V(s)
  Ticks least_key = kUnknown, open = kUnknown;                    // of V(s)
  bool first = true;
  const auto end = [&](Ticks by) {
    x.clean = clean;
    x.ended = clean ? std::min(by, x.late) : by;
  };
  std::size_t k = line.known.size();
  for (; k > 0; --k) {
    const WalkedJob& y = jobs_[at(line.known[k - 1])];
    if (y.ready <= low_) break;
    if (y.soon > x.late) continue;
    const Ticks s = y.ready;
    sum += y.work;
    count(y);
    pending -= y.ended == kUnknown;
    if (clean) {
      certain &= y.on_time;
      least_key = std::min(least_key, y.soon);
      if (y.of_q) open = std::min(open, opens(y));
    }
    if (s > x.ready) continue;
    // Of several with this A, the last one has counted all.
    const Ticks by = s + sum + blocked(s);
    worst = first ? by : std::max(worst, by);
    first = false;
    clean = clean && (by <= x.soon || (certain && !meets_p(x, s, least_key)));
    if (s < high_ || pending > 0) continue;
    const Ticks ended = k == 1 ? -kUnknown : line.latest[k - 2];
    if (ended <= s && (!clean || by <= x.soon || ended <= open)) return end(worst);
  }
  for (; k > 0; --k) {
    const WalkedJob& y = jobs_[at(line.known[k - 1])];
    if (!is_before(line.known[k - 1])) continue;
    sum += y.work;
    count(y);
  }
  Ticks begun = high_, work = 0, ended = -kUnknown;
  for (const auto& [soon, late, wcet] : line.without_change) {
    if (soon > x.late) break;  // it is not in V
    work += wcet;
    ended = std::max(ended, late);
    begun = std::min(begun, ended - work);
  }
  const Ticks by = begun + sum + blocked_at_high(x);
  clean = clean && by <= x.soon;
  end(first ? by : std::max(worst, by));
}

}  // namespace xauto::solver::keys::checking::tables
