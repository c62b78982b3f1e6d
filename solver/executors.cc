// SPDX-License-Identifier: Apache-2.0
#include "solver/executors.h"

#include <algorithm>
#include <deque>
#include <queue>

#include "base/index.h"
#include "solver/random.h"

namespace xauto::solver {
namespace {

constexpr std::int64_t kNsPerUs = 1000;

class ExecutorPlay {
 public:
  explicit ExecutorPlay(const ImportedApp& imported)
      : app_(imported.app), seen_(imported.seen), end_(seen_.duration_us * kNsPerUs) {
    const std::size_t n = app_.xnodes.size();
    callbacks_.resize(n);
    hearers_.resize(n);
    for (const auto& [u, v] : app_.edges) hearers_[at(u)].push_back(v);
    for (std::size_t e = 0; e < seen_.executors.size(); ++e)
      for (const SeenGroup& group : seen_.executors[e].groups) {
        for (const int x : group.xnodes) {
          callbacks_[at(x)].executor = static_cast<int>(e);
          callbacks_[at(x)].group = group.reentrant ? -1 : static_cast<int>(group_busy_.size());
        }
        group_busy_.push_back(0);
      }
    executors_.resize(seen_.executors.size());
    for (std::size_t e = 0; e < executors_.size(); ++e)
      executors_[e].idle = std::max(1, seen_.executors[e].threads);
    cores_ = std::max(1, seen_.cores);
    heard_.resize(app_.sources.size());
    for (std::size_t x = 0; x < n; ++x)
      for (const int s : app_.xnodes[x].sources) {
        callbacks_[x].timer = app_.sources[at(s)].clock == 0;
        heard_[at(s)].push_back(static_cast<int>(x));
      }
  }

  ExecutedRun go() {
    run_.releases.resize(app_.sources.size());
    for (std::size_t s = 0; s < app_.sources.size(); ++s) release(static_cast<int>(s));
    while (!events_.empty() && events_.top().when <= end_ && !run_.gave_up) {
      now_ = events_.top().when;
      while (!events_.empty() && events_.top().when == now_) {
        const Event e = events_.top();
        events_.pop();
        take(e);
      }
      for (std::size_t e = 0; e < executors_.size(); ++e) dispatch(e);
    }
    for (std::size_t e = 0; e < executors_.size(); ++e)
      run_.busy.push_back(static_cast<double>(executors_[e].used) /
                          (static_cast<double>(end_) * std::max(1, seen_.executors[e].threads)));
    return std::move(run_);
  }

 private:
  enum class EventKind : std::uint8_t { kEnds, kReleases, kReady };
  struct Message {
    std::int64_t release = -1, from = -1;
    int source = -1;
  };
  struct Event {
    std::int64_t when = 0;
    EventKind kind = EventKind::kReady;
    int index = -1;  ///< XNode, or source
    Message message;
    std::uint64_t number = 0;  ///< among those of one instant
    bool operator>(const Event& o) const {
      return when != o.when ? when > o.when : kind != o.kind ? kind > o.kind : number > o.number;
    }
  };
  struct Callback {
    int executor = -1, group = -1;
    bool timer = false;
    std::deque<Message> queue;         ///< of a subscription
    std::deque<std::uint64_t> became;  ///< ready, in the order of all, each of the queue
    std::size_t ran = 0;
    bool sampled = false;    ///< by the last look, and not run since
    std::int64_t until = 0;  ///< of a timer: no release before it is called for
  };
  struct Executor {
    int idle = 1;
    std::int64_t used = 0;
  };

  void push(std::int64_t when, EventKind kind, int index, const Message& message) {
    events_.push({when, kind, index, message, next_++});
  }

  /// The next release of a source.
  void release(int s) {
    const SourceSpec& source = app_.sources[at(s)];
    auto& nominal = run_.releases[at(s)];
    const auto k = static_cast<std::int64_t>(nominal.size());
    const auto whole = static_cast<std::int64_t>(static_cast<__int128>(k) * source.period.num *
                                                 kNsPerUs / source.period.den);
    nominal.push_back(source.offset_us * kNsPerUs + whole);
    std::int64_t late = 0;
    if (source.clock != 0 && source.jitter_us > 0)
      late = static_cast<std::int64_t>(
          random_.below(static_cast<std::uint64_t>(source.jitter_us) + 1) * kNsPerUs);
    push(nominal.back() + late, EventKind::kReleases, s, {k, -1, s});
  }

  void take(const Event& e) {
    switch (e.kind) {
      case EventKind::kReleases:
        for (const int x : heard_[at(e.index)]) come(x, e.message);
        if (run_.releases[at(e.index)].size() < kMaxExecuted) release(e.index);
        break;
      case EventKind::kReady:
        ready(e.index, e.message);
        break;
      case EventKind::kEnds: {
        Callback& c = callbacks_[at(e.index)];
        if (c.group >= 0) group_busy_[at(c.group)] = 0;
        ++executors_[at(c.executor)].idle;
        --running_;
        break;
      }
    }
  }

  /// A message, or a timer's instant, is on its way to the executor.
  void come(int x, const Message& message) {
    push(now_ + seen_.xnodes[at(x)].delay_us * kNsPerUs, EventKind::kReady, x, message);
  }

  void ready(int x, const Message& message) {
    Callback& c = callbacks_[at(x)];
    if (c.executor < 0) return;
    if (c.timer && (!c.queue.empty() || message.release < c.until)) {
      ++run_.skipped;
      return;
    }
    if (static_cast<std::int64_t>(c.queue.size()) >= seen_.xnodes[at(x)].depth) {
      c.queue.pop_front();
      c.became.pop_front();
      ++run_.lost;
    }
    c.queue.push_back(message);
    c.became.push_back(next_++);
  }

  [[nodiscard]] bool may_run(const Callback& c) const {
    return !c.queue.empty() && (c.group < 0 || group_busy_[at(c.group)] == 0);
  }

  /// Whether a thread looks at `a` before `b`.
  [[nodiscard]] bool before(std::size_t executor, int a, int b) const {
    const ExecutorKind kind = seen_.executors[executor].kind;
    const Callback &first = callbacks_[at(a)], &second = callbacks_[at(b)];
    if (kind == ExecutorKind::kEvents) return first.became.front() < second.became.front();
    if (first.timer != second.timer)
      return first.timer == (kind != ExecutorKind::kStaticSingleThreaded);
    return a < b;
  }

  /// The callback that a thread takes next; -1: it waits.
  int next_of(std::size_t e) {
    int best = -1;
    const auto find = [&](bool sampled) {
      for (const SeenGroup& group : seen_.executors[e].groups)
        for (const int x : group.xnodes) {
          const Callback& c = callbacks_[at(x)];
          if ((!sampled || c.sampled) && may_run(c) && (best < 0 || before(e, x, best))) best = x;
        }
    };
    find(seen_.executors[e].kind != ExecutorKind::kEvents);
    if (best >= 0) return best;
    for (const SeenGroup& group : seen_.executors[e].groups)  // it looks again
      for (const int x : group.xnodes) callbacks_[at(x)].sampled = may_run(callbacks_[at(x)]);
    find(true);
    return best;
  }

  void dispatch(std::size_t e) {
    while (executors_[e].idle > 0 && running_ < cores_ && !run_.gave_up) {
      const int x = next_of(e);
      if (x < 0) return;
      start(e, x);
    }
  }

  void start(std::size_t e, int x) {
    Callback& c = callbacks_[at(x)];
    RanJob job{x, now_};
    const Message message = c.queue.front();
    c.queue.pop_front();
    c.became.pop_front();
    c.sampled = false;
    job.from = message.from;
    job.source = message.source;
    job.release = message.release;
    if (c.timer) {  // what is due by now is called for at once
      const auto& nominal = run_.releases[at(job.source)];
      while (static_cast<std::size_t>(job.release) + 1 < nominal.size() &&
             nominal[static_cast<std::size_t>(job.release) + 1] <= now_)
        ++job.release;
      c.until = job.release + 1;
    }
    const std::vector<std::int64_t>& times = seen_.xnodes[at(x)].times_us;
    const std::int64_t took =
        (times.empty() ? app_.xnodes[at(x)].wcet_us.begin()->second : times[c.ran % times.size()]) *
        kNsPerUs;
    ++c.ran;
    job.end_ns = now_ + took;
    executors_[e].used += std::min(job.end_ns, end_) - now_;
    --executors_[e].idle;
    ++running_;
    if (c.group >= 0) group_busy_[at(c.group)] = 1;
    push(job.end_ns, EventKind::kEnds, x, Message());
    const std::int64_t sent = std::max(now_, job.end_ns - seen_.xnodes[at(x)].lead_us * kNsPerUs);
    for (const int v : hearers_[at(x)])
      push(sent + seen_.xnodes[at(v)].delay_us * kNsPerUs, EventKind::kReady, v,
           {-1, static_cast<std::int64_t>(run_.jobs.size()), -1});
    run_.jobs.push_back(job);
    run_.gave_up = run_.jobs.size() >= kMaxExecuted;
  }

  const AppSpec& app_;
  const Seen& seen_;
  std::int64_t now_ = 0, end_;
  int cores_ = 1, running_ = 0;
  std::uint64_t next_ = 0;
  Random random_{1};
  ExecutedRun run_;
  std::vector<Callback> callbacks_;
  std::vector<Executor> executors_;
  std::vector<char> group_busy_;
  std::vector<std::vector<int>> hearers_, heard_;  ///< [xnode], [source]
  std::priority_queue<Event, std::vector<Event>, std::greater<>> events_;
};

}  // namespace

ExecutedRun play_executors(const ImportedApp& imported) {
  return ExecutorPlay(imported).go();
}

}  // namespace xauto::solver
