// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/alone.h"

#include <algorithm>
#include <functional>
#include <utility>

namespace xauto::solver::keys {
namespace {

class Server {
 public:
  struct Left {
    Tick due, work, slack;
    int xnode;
    auto operator<=>(const Left&) const = default;  // NOLINT(modernize-use-nullptr)
  };

  /// [begin, end) of each busy interval that has ended goes there.
  explicit Server(std::vector<std::pair<Tick, Tick>>* busy, Tick now = 0)
      : now_(now), busy_(busy) {}

  /// Until then, or until nothing is left. False: `late()` ends too late.
  bool serve(Tick until) {
    while (now_ < until && !left_.empty()) {
      Left& job = left_.front();
      const Tick slice = std::min(job.work, until - now_);
      now_ += slice;
      job.work -= slice;
      if (now_ + job.work + job.slack > job.due) {
        late_ = job.xnode;
        return false;
      }
      if (job.work > 0) break;
      std::pop_heap(left_.begin(), left_.end(), std::greater<>());
      left_.pop_back();
      if (left_.empty() && busy_ != nullptr && now_ > began_) busy_->emplace_back(began_, now_);
    }
    return true;
  }
  void arrives(Tick at_time, const LaidJob& job) {
    now_ = at_time;
    if (left_.empty()) began_ = at_time;
    left_.push_back({at_time - job.arrival + job.due, job.work, job.slack, job.xnode});
    std::push_heap(left_.begin(), left_.end(), std::greater<>());
  }
  void wait(Tick until) { now_ = until; }

  [[nodiscard]] bool idle() const { return left_.empty(); }
  [[nodiscard]] Tick now() const { return now_; }
  [[nodiscard]] int late() const { return late_; }
  /// What is left, with times after `origin`.
  [[nodiscard]] std::vector<Left> state(Tick origin) const {
    std::vector<Left> state = left_;
    for (Left& l : state) l.due -= origin;
    std::sort(state.begin(), state.end(), std::greater<>());
    return state;
  }

 private:
  std::vector<Left> left_;  ///< a heap, the earliest due on top
  Tick now_, began_ = 0;
  int late_ = -1;
  std::vector<std::pair<Tick, Tick>>* busy_;
};

constexpr int kMostHyperperiods = 64;

}  // namespace

bool fits_alone(std::vector<LaidJob>& jobs, Tick hyper, Misfit* misfit, BusyIntervals* busy) {
  const auto refuse = [&](Misfit::Kind kind, int xnode = -1) {
    if (misfit != nullptr) *misfit = {kind, xnode};
    return false;
  };
  std::sort(jobs.begin(), jobs.end(),
            [](const LaidJob& a, const LaidJob& b) { return a.arrival < b.arrival; });
  __int128 work = 0;
  for (const LaidJob& j : jobs) work += j.work;
  if (work > hyper) return refuse(Misfit::Kind::kOverload);
  std::vector<std::pair<Tick, Tick>> ended;
  Server server(busy != nullptr ? &ended : nullptr);
  std::vector<Server::Left> before;
  // Work that is left over is the same after two hyperperiods if deadlines are met, but for what
  // windows longer than one carry over. Intervals are of one round more: then they are the same each time.
  int last = kMostHyperperiods;
  for (int round = 0; round < kMostHyperperiods && round <= last; ++round) {
    const Tick start = round * hyper;
    ended.clear();
    for (const LaidJob& job : jobs) {
      if (!server.serve(start + job.arrival)) return refuse(Misfit::Kind::kLate, server.late());
      server.arrives(start + job.arrival, job);
    }
    if (!server.serve(start + hyper)) return refuse(Misfit::Kind::kLate, server.late());
    if (round >= last) break;
    std::vector<Server::Left> state = server.state(start + hyper);
    if (round > 0 && state == before) last = busy != nullptr ? round + 1 : round;
    before = std::move(state);
  }
  if (last == kMostHyperperiods) return refuse(Misfit::Kind::kPilesUp);
  if (busy == nullptr) return true;
  busy->clear();
  for (const auto& [begin, end] : ended) {
    const Tick turn = floor_div(begin, hyper) * hyper;
    busy->emplace(begin - turn, end - turn);
  }
  return true;
}

FittingAlone::FittingAlone(Tick hyper, const Jobs& jobs) : hyper_(hyper), jobs_(jobs.size()) {
  for (const auto& [number, job] : jobs) {
    jobs_[at(number)] = job;
    order_.emplace(job.arrival, number);
  }
  (void)whole(busy_);
}

bool FittingAlone::whole(BusyIntervals& busy) const {
  std::vector<LaidJob> jobs;
  jobs.reserve(order_.size());
  for (const auto& [arrival, number] : order_) jobs.push_back(jobs_[at(number)]);
  return fits_alone(jobs, hyper_, nullptr, &busy);
}

void FittingAlone::put(const Jobs& jobs) {
  for (const auto& [number, job] : jobs) {
    LaidJob& is = jobs_[at(number)];
    if (is.arrival != job.arrival) {
      order_.erase({is.arrival, number});
      order_.emplace(job.arrival, number);
    }
    is = job;
  }
}

bool FittingAlone::change(const Jobs& jobs) {
  were_.clear();
  gone_.clear();
  come_.clear();
  std::vector<Tick> instants;
  for (const auto& [number, job] : jobs) {
    were_.emplace_back(number, jobs_[at(number)]);
    instants.push_back(jobs_[at(number)].arrival);
    instants.push_back(job.arrival);
  }
  put(jobs);
  std::sort(instants.begin(), instants.end());
  std::vector<Span> spans;
  bool fits = true, apart = !busy_.empty();
  for (const Tick instant : instants) {
    if (!apart ||
        (!spans.empty() && (instant < spans.back().to || instant >= spans.front().from + hyper_)))
      continue;
    Span span;
    fits = around(instant, span);
    if (!fits) break;
    spans.push_back(std::move(span));
    apart = spans.back().to <= spans.front().from + hyper_;
  }
  if (fits && apart) replace(spans);
  if (fits && !apart) {
    fits = whole(come_);
    if (fits) gone_ = std::exchange(busy_, come_);
  }
  if (!fits) put(were_);
  return fits;
}

void FittingAlone::undo() {
  put(were_);
  for (const auto& [begin, end] : come_) busy_.erase(begin);
  busy_.insert(gone_.begin(), gone_.end());
}

/// From where the XPU was idle, until it is idle again, and was so before.
bool FittingAlone::around(Tick instant, Span& span) const {
  span.from = begin_of_busy(instant);
  Server server(&span.busy, span.from);
  Tick turn = span.from < 0 ? -hyper_ : 0;
  for (auto next = order_.lower_bound({span.from - turn, -1});; ++next) {
    if (next == order_.end()) {
      next = order_.begin();
      turn += hyper_;
    }
    const Tick arrival = turn + next->first;
    if (!server.serve(arrival)) return false;
    if (server.idle()) {
      // Of what is idle now, that which was, too.
      while (server.now() < arrival && end_of_busy(server.now()) > server.now())
        server.wait(std::min(arrival, end_of_busy(server.now())));
      const bool was_idle = end_of_busy(server.now()) == server.now();
      if (was_idle && (server.now() > instant || server.now() < arrival)) break;
    }
    // It may go all around: then `to` says so.
    if (arrival > span.from + hyper_) break;
    server.arrives(arrival, jobs_[at(next->second)]);
  }
  span.to = server.idle() ? server.now() : span.from + hyper_ + 1;
  return true;
}

/// It, or the beginning of the busy interval that it is in.
Tick FittingAlone::begin_of_busy(Tick instant) const {
  const auto next = busy_.upper_bound(instant);
  if (next != busy_.begin() && std::prev(next)->second > instant) return std::prev(next)->first;
  const auto& [begin, end] = *busy_.rbegin();
  return end - hyper_ > instant ? begin - hyper_ : instant;
}

/// It, or the end of the busy interval that it is in.
Tick FittingAlone::end_of_busy(Tick instant) const {
  const Tick turn = floor_div(instant, hyper_) * hyper_, in = instant - turn;
  const auto next = busy_.upper_bound(in);
  if (next != busy_.begin() && std::prev(next)->second > in) return turn + std::prev(next)->second;
  return turn + std::max(in, busy_.rbegin()->second - hyper_);
}

void FittingAlone::replace(const std::vector<Span>& spans) {
  const auto take = [&](Tick from, Tick to) {
    const auto first = busy_.lower_bound(from), last = busy_.lower_bound(to);
    gone_.insert(first, last);
    busy_.erase(first, last);
  };
  for (const Span& span : spans) {
    take(std::max(Tick{0}, span.from), std::min(span.to, hyper_));
    if (span.from < 0) take(span.from + hyper_, hyper_);
    if (span.to > hyper_) take(0, span.to - hyper_);
  }
  for (const Span& span : spans)
    for (const auto& [begin, end] : span.busy) {
      const Tick turn = floor_div(begin, hyper_) * hyper_;
      come_.emplace(begin - turn, end - turn);
    }
  busy_.insert(come_.begin(), come_.end());
}

}  // namespace xauto::solver::keys
