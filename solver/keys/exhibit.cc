// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/exhibit.h"

#include <algorithm>
#include <functional>
#include <limits>

#include "solver/keys/windows.h"

namespace xauto::solver::keys {
namespace {

constexpr Tick kNever = std::numeric_limits<Tick>::max();
/// Hyperperiods until it has to repeat: this many, and more where they are short, since latencies
/// of several periods need as many to fill the pipeline: so many of the longest. Chosen, not tuned.
constexpr std::int64_t kLeastRounds = 8, kMostRounds = 48, kRoundsOfSlowest = 40;
/// Rounds in a row, each later than the one before, after which it will not repeat. Chosen.
constexpr int kMostGrowing = 4;
/// Jobs that are simulated at most, but for the least rounds.
constexpr std::int64_t kMostSimulated = 1'000'000;
/// Waits of a job that are counted, in 16 bits. The certificate does not believe this schedule.
constexpr std::size_t kMostWaits = 32'000;

std::size_t ix(std::int64_t i) {
  return static_cast<std::size_t>(i);
}

}  // namespace

void Exhibitor::push(Tick time, std::int64_t code) {
  events_.push_back({time, code});
  std::push_heap(events_.begin(), events_.end(), std::greater<>());
}

void Exhibitor::prepare(int domain, const Rule& rule) {
  const Domain& d = p_.domains[at(domain)];
  if (domain_ != domain) {
    domain_ = domain;
    hyper_ = d.hyper;
    jobs_ = d.jobs;
    base_ = p_.slot[at(d.xnodes.front())];
    Tick slowest = 0;
    for (const int c : d.components) slowest = std::max(slowest, p_.components[at(c)].period);
    rounds_ = std::min(kLeastRounds - 2 + kRoundsOfSlowest * slowest / hyper_, kMostRounds);
    rounds_ = std::min(rounds_, std::max(kLeastRounds, kMostSimulated / jobs_));
    known_.resize(ix(jobs_));
    for (const int i : d.xnodes) {
      const Component& c = p_.components[at(p_.component_of[at(i)])];
      for (int n = 0; n < c.jobs; ++n)
        known_[at(p_.slot[at(i)] + n - base_)] = {c.phase % hyper_ + n * c.period, i, n};
    }
    const std::size_t jobs = std::max(left_.size(), ix(jobs_ * rounds_));
    left_.resize(jobs);
    start_.resize(jobs);
    finish_.resize(jobs);
    waits_.resize(jobs);
    first_waits_.resize(ix(jobs_));
    next_.resize(at(p_.num_xnodes));
    xpus_.resize(at(p_.num_xpus));
    module_base_.assign(p_.modules.size(), -1);
    std::int64_t total = 0;
    for (std::size_t m = 0; m < p_.modules.size(); ++m) {
      const Component& c = p_.components[at(p_.modules[m].component)];
      if (c.domain != domain) continue;
      module_base_[m] = total;
      total += c.jobs * rounds_;
    }
    in_module_.resize(std::max(in_module_.size(), ix(total)));
  }
  events_.clear();
  done_.assign(ix(rounds_), 0);
  equal_ = 0;
  used_.clear();
  for (Xpu& x : xpus_) {
    x.ready.clear();
    x.running.job = -1;
    x.end = kNever;
    x.interrupted = 0;
  }
  growth_ = 0;
  grew_ = 0;
  prepared_ = 0;
  useless_ = false;
  for (const int i : d.xnodes) {
    const auto first = rule.hold.begin() + p_.slot[at(i)];
    const bool timer = p_.root[at(i)] != 0 || std::any_of(first, first + p_.jobs[at(i)],
                                                          [](Tick hold) { return hold > 0; });
    const auto waits = static_cast<std::int16_t>(
        std::min<std::size_t>(p_.pred[at(i)].size() + (timer ? 1 : 0), kMostWaits));
    std::fill_n(first_waits_.begin() + p_.slot[at(i)] - base_, p_.jobs[at(i)], waits);
    next_[at(i)] = timer ? 0 : -1;
    const int m = rule.xpu[at(i)];
    if (std::find(used_.begin(), used_.end(), m) == used_.end()) used_.push_back(m);
  }
  for (const int i : d.xnodes)
    if (next_[at(i)] == 0) static_cast<void>(release(rule, i));
}

/// Rounds are made ready as they are reached: most runs end after three.
void Exhibitor::prepare_rounds(const Rule& rule, std::int64_t up_to) {
  const Domain& d = p_.domains[at(domain_)];
  for (; prepared_ <= up_to; ++prepared_) {
    std::copy(first_waits_.begin(), first_waits_.end(), waits_.begin() + prepared_ * jobs_);
    std::fill_n(start_.begin() + prepared_ * jobs_, jobs_, Tick{-1});
    for (const int i : d.xnodes) {
      const std::int64_t per_round = p_.jobs[at(i)];
      const std::int64_t first = prepared_ * jobs_ + p_.slot[at(i)] - base_;
      std::fill_n(left_.begin() + first, per_round, rule.work[at(i)]);
      if (p_.entry[at(i)] == 0) continue;
      const std::int64_t in_flight = p_.modules[at(p_.module_of[at(i)])].in_flight;
      for (std::int64_t n = 0; n < per_round; ++n)
        if (prepared_ * per_round + n >= in_flight) ++waits_[ix(first + n)];
    }
    for (std::size_t m = 0; m < p_.modules.size(); ++m) {
      if (module_base_[m] < 0) continue;
      const std::int64_t per_round = p_.components[at(p_.modules[m].component)].jobs;
      std::fill_n(in_module_.begin() + module_base_[m] + prepared_ * per_round, per_round,
                  static_cast<std::int64_t>(p_.modules[m].xnodes.size()));
    }
  }
}

/// Its next timer event, if there is one more within the rounds.
bool Exhibitor::release(const Rule& rule, int xnode) {
  const std::int64_t per_round = p_.jobs[at(xnode)];
  const std::int64_t n = next_[at(xnode)]++;
  if (n >= per_round * rounds_) return false;
  if (n / per_round >= prepared_) prepare_rounds(rule, n / per_round);
  const std::int64_t slot = p_.slot[at(xnode)] + n % per_round;
  const std::int64_t job = job_of(n / per_round, slot - base_);
  const Tick ready =
      std::max(p_.root[at(xnode)] != 0 ? p_.root_ready[at(xnode)] : 0, rule.hold[ix(slot)]);
  push(nominal(job) + ready, 4 * job + 2);
  return true;
}

void Exhibitor::one_less(const Rule& rule, std::int64_t job, Tick now) {
  const std::size_t k = place(job);
  if (--waits_[k] > 0) return;
  const int i = known(job).xnode;
  if (rule.window[at(i)] != kNoTick) {
    start_[k] = now;
    push(seen(job, now + rule.window[at(i)]), 4 * job + 1);
    return;
  }
  const int m = rule.xpu[at(i)];
  Xpu& x = xpus_[at(m)];
  const Tick key = nominal(job) + rule.key[at(base_) + ix(in_round(job))];
  x.ready.push_back({key, job});
  std::push_heap(x.ready.begin(), x.ready.end(), std::greater<>());
  dirty_.push_back(m);
}

void Exhibitor::done(const Rule& rule, std::int64_t job, Tick now) {
  const int i = known(job).xnode, n = known(job).number;
  const std::int64_t round = round_of(job);
  finish_[place(job)] = now;
  if (!rule.limit.empty() && now - nominal(job) > rule.limit[at(i)]) useless_ = true;
  ++done_[ix(round)];
  const std::int64_t per_round = p_.jobs[at(i)];
  for (const EdgeEnd& link : p_.succ[at(i)]) {
    const std::int64_t next = job_of(round, p_.slot[at(link.xnode)] - base_ + n);
    const Tick passes = p_.transfer(link, rule.xpu[at(i)], rule.xpu[at(link.xnode)]);
    if (passes == 0)
      one_less(rule, next, now);
    else
      push(now + passes, 4 * next);
  }
  const int module = p_.module_of[at(i)];
  if (module < 0) return;
  const Module& mod = p_.modules[at(module)];
  const std::int64_t activation = round * per_round + n;
  if (--in_module_[ix(module_base_[at(module)] + activation)] > 0) return;
  const std::int64_t admitted = activation + std::min(mod.in_flight, kMostTicks);
  if (admitted >= per_round * rounds_) return;
  if (admitted / per_round >= prepared_) prepare_rounds(rule, admitted / per_round);
  const Tick lost = lost_in(mod.in_flight * p_.period_of(i), p_.domains[at(domain_)].ppm);
  for (const int e : mod.entries) {
    const std::int64_t next =
        job_of(admitted / per_round, p_.slot[at(e)] - base_ + admitted % per_round);
    if (lost == 0)
      one_less(rule, next, now);
    else
      push(now + lost, 4 * next);
  }
}

Tick Exhibitor::seen(std::int64_t job, Tick end) const {
  if (p_.scale == 1) return end;
  const Tick release = nominal(job);
  return release + p_.up_to_us(end - release);
}

void Exhibitor::dispatch(const Rule& rule, int xpu, Tick now) {
  Xpu& x = xpus_[at(xpu)];
  if (x.ready.empty()) return;
  if (x.running.job >= 0) {
    if (!(x.running > x.ready.front()) || x.interrupted + 1 >= p_.levels[at(xpu)]) return;
    if (rule.polite[at(known(x.ready.front().job).xnode)] != 0) return;
    left_[place(x.running.job)] = x.end - now;
    ++x.interrupted;
    const Ready before = x.running;
    std::pop_heap(x.ready.begin(), x.ready.end(), std::greater<>());
    x.running = x.ready.back();
    x.ready.back() = before;
    std::push_heap(x.ready.begin(), x.ready.end(), std::greater<>());
  } else {
    std::pop_heap(x.ready.begin(), x.ready.end(), std::greater<>());
    x.running = x.ready.back();
    x.ready.pop_back();
  }
  const std::size_t k = place(x.running.job);
  Tick& start = start_[k];
  if (start >= 0) {
    --x.interrupted;
  } else {
    start = now;
    // Who is interrupted has the larger key: it may be running when this one starts.
    if (x.interrupted > 0) left_[k] += rule.cost[at(xpu)];
  }
  x.end = now + left_[k];
}

/// Jobs of several rounds meet where latencies are longer than a hyperperiod: so many rounds in a
/// row have to be equal.
bool Exhibitor::repeats(std::int64_t round) {
  if (round < 1) return false;
  const std::size_t here = ix(round * jobs_), there = ix((round - 1) * jobs_);
  Tick longest = 0;
  for (std::size_t k = 0; k < ix(jobs_); ++k) {
    if (finish_[here + k] - hyper_ != finish_[there + k] ||
        start_[here + k] - hyper_ != start_[there + k]) {
      equal_ = 0;
      return false;
    }
    longest = std::max(longest, finish_[here + k] - round * hyper_);
  }
  return ++equal_ * hyper_ >= longest;
}

/// Later and later from round to round, and no less so: it will not repeat.
bool Exhibitor::piles_up(std::int64_t round) {
  if (round + 1 < kLeastRounds) return false;
  const std::size_t here = ix(round * jobs_), there = ix((round - 1) * jobs_);
  const double before = growth_;
  growth_ = 0;
  for (std::size_t k = 0; k < ix(jobs_); ++k)
    growth_ += static_cast<double>(finish_[here + k] - finish_[there + k] - hyper_) /
               static_cast<double>(hyper_);
  grew_ = growth_ > 0 && growth_ >= before ? grew_ + 1 : 0;
  return grew_ > kMostGrowing;
}

bool Exhibitor::run(int domain, const Rule& rule, Schedule& schedule, const Until& until) {
  prepare(domain, rule);
  std::int64_t steps = 0, round = 0;
  while (round < rounds_) {
    Tick now = events_.empty() ? kNever : events_.front().time;
    for (const int m : used_) now = std::min(now, xpus_[at(m)].end);
    if (now == kNever) return false;
    if (useless_ || ((++steps & 0x3fff) == 0 && until.over())) return false;
    dirty_.clear();
    for (const int m : used_) {
      Xpu& x = xpus_[at(m)];
      if (x.end != now) continue;
      const std::int64_t job = x.running.job;
      x.running.job = -1;
      x.end = kNever;
      dirty_.push_back(m);
      const int i = known(job).xnode;
      const Tick told = seen(job, now + rule.delay[at(i)]);
      if (told == now)
        done(rule, job, now);
      else
        push(told, 4 * job + 1);
    }
    while (!events_.empty() && events_.front().time == now) {
      std::pop_heap(events_.begin(), events_.end(), std::greater<>());
      const std::int64_t code = events_.back().code;
      events_.pop_back();
      const std::int64_t job = code / 4;
      if (code % 4 == 1) {
        done(rule, job, now);
      } else {
        one_less(rule, job, now);
        if (code % 4 == 2) static_cast<void>(release(rule, known(job).xnode));
      }
    }
    for (const int m : dirty_) dispatch(rule, m, now);
    while (round < rounds_ && done_[ix(round)] == jobs_) {
      if (!repeats(round)) {
        if (piles_up(round++)) return false;
        continue;
      }
      for (std::int64_t k = 0; k < jobs_; ++k) {
        const std::int64_t job = job_of(round, k);
        schedule.start[ix(base_ + k)] = start_[place(job)] - nominal(job);
        schedule.finish[ix(base_ + k)] = finish_[place(job)] - nominal(job);
      }
      return true;
    }
  }
  return false;
}

}  // namespace xauto::solver::keys
