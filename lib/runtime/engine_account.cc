// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 11: each release is accounted for once, as a latency or as lost; and what a
// run has to tell of it.
#include <algorithm>
#include <set>

#include <uapi/xauto/event.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "runtime/engine.h"
#include "runtime/notes.h"

namespace xauto::runtime {

void Engine::activate(int module) {
  Chain& chain = *chains_[static_cast<std::size_t>(module)];
  board_->module(module).in_flight.store(1);
  if (trace_)
    trace_->write(XAUTO_EV_ACTIVATE, chain.runtime->input().sequence(), XAUTO_EV_NONE,
                  static_cast<std::uint16_t>(module), XAUTO_EV_NONE);
  if (trace_ && !graph_.single_rate) trace_inputs(module, *chain.runtime);
  chain.nodes.front().worker->submit(0);
}

/// Numbers of releases mean nothing across sources of several rates: what an activation was made of
/// is told by origins.
void Engine::trace_inputs(int module, ModuleRuntime& runtime) {
  const std::vector<int>& inputs = graph_.modules[static_cast<std::size_t>(module)].inputs;
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    const Graph::Topic& topic = graph_.topics[static_cast<std::size_t>(inputs[i])];
    const auto from = static_cast<std::uint32_t>(std::max(topic.source, topic.module));
    trace_->write(XAUTO_EV_TAKE, static_cast<std::uint64_t>(runtime.origin_of(i)), XAUTO_EV_NONE,
                  static_cast<std::uint16_t>(module), XAUTO_EV_NONE,
                  topic.source >= 0 ? XAUTO_TAKE_SOURCE | from : from);
  }
}

void Engine::done(int module, std::int64_t origin_ns, std::uint64_t sequence) {
  board_->module(module).activations.fetch_add(1, std::memory_order_relaxed);
  board_->module(module).in_flight.store(0, std::memory_order_relaxed);
  const std::int64_t now = now_ns();  // one instant for all accounts: the trace and the table agree
  if (trace_)
    trace_->write_at(now, XAUTO_EV_DONE, sequence, XAUTO_EV_NONE,
                     static_cast<std::uint16_t>(module), XAUTO_EV_NONE);
  if (graph_.modules[static_cast<std::size_t>(module)].sink || routes_->end_at(module))
    through(module, sequence, origin_ns,
            modules_[static_cast<std::size_t>(module)]->origins().get(), now, false);
}

/// A sink module, or one where a chain ends, is through with release `sequence`; known here, or
/// told by its process.
void Engine::through(int module, std::uint64_t sequence, std::int64_t origin_ns,
                     const detail::Origins* origins, std::int64_t now, bool lost) {
  if (member_) {
    member_->tell(module, sequence, origin_ns, now, lost, origins);
    return;
  }
  if (!lost)
    if (const auto late_us = routes_->published(module, origin_ns, origins, now);
        late_us && (!graph_.single_rate || !session_.deployment.chains.empty()))
      missed(module, sequence, *late_us);
  if (!graph_.modules[static_cast<std::size_t>(module)].sink) return;
  if (!lost) {
    Latencies& latencies = *latencies_[static_cast<std::size_t>(module)];
    const std::lock_guard lock(latencies.mutex);
    latencies.us.add((now - origin_ns) / 1000);
  }
  account(module, sequence, now, lost);
}

void Engine::dropped(int module, std::uint64_t sequence, std::uint32_t reason) {
  ModuleLine& counts = board_->module(module);
  (reason == XAUTO_DROP_FAILED ? counts.failed : counts.dropped)
      .fetch_add(1, std::memory_order_relaxed);
  if (reason == XAUTO_DROP_FAILED || reason == XAUTO_DROP_HUNG || reason == XAUTO_DROP_DIED)
    counts.in_flight.store(0, std::memory_order_relaxed);
  if (trace_)
    trace_->write(XAUTO_EV_DROP, sequence, XAUTO_EV_NONE, static_cast<std::uint16_t>(module),
                  XAUTO_EV_NONE, reason);
  if (graph_.modules[static_cast<std::size_t>(module)].sink)
    through(module, sequence, 0, nullptr, now_ns(), true);
}

/// Into the trace, which so tells the tool.
void Engine::missed(int module, std::uint64_t sequence, std::int64_t latency_us) {
  if (!trace_) return;
  trace_->write(XAUTO_EV_MISS, sequence, XAUTO_EV_NONE, static_cast<std::uint16_t>(module),
                XAUTO_EV_NONE,
                static_cast<std::uint32_t>(std::clamp<std::int64_t>(latency_us, 0, UINT32_MAX)));
}

void Engine::skip(int module, std::uint64_t sequence) {
  const Chain& chain = *chains_[static_cast<std::size_t>(module)];
  for (std::size_t i = 0; i < chain.nodes.size(); ++i) chain.nodes[i].worker->skip(i, sequence);
}

/// A sink module settles its releases in order and each once; what it left out was lost with its
/// process, what comes twice was told by a process that died meanwhile.
void Engine::account(int module, std::uint64_t sequence, std::int64_t now, bool lost) {
  if (!graph_.single_rate) return;
  std::uint32_t complete = 0;
  {
    const std::lock_guard lock(releases_mutex_);
    std::uint64_t& next = sink_next_[static_cast<std::size_t>(module)];
    for (; next <= sequence && next < open_base_ + open_.size(); ++next) {
      Open& open = open_[next - open_base_];
      open.last_ns = std::max(open.last_ns, now);
      open.lost |= lost || next < sequence;
      if (--open.sinks_left > 0) continue;
      const std::int64_t latency_us = (open.last_ns - open.origin_ns) / 1000;
      releases_.push_back({next, open.origin_ns, open.lost ? -1 : latency_us});
      if (releases_.size() > kKeptReleases) releases_.pop_front();
      ++num_releases_;
      FlowLine& whole = board_->flow(0);
      if (open.lost) {
        ++lost_releases_;
        whole.lost.fetch_add(1, std::memory_order_relaxed);
      } else {
        release_latencies_us_.add(latency_us);
        whole.add(latency_us);
      }
      if (session_.app.deadline_us && (open.lost || latency_us > *session_.app.deadline_us)) {
        deadline_misses_.fetch_add(1, std::memory_order_relaxed);
        whole.late.fetch_add(1, std::memory_order_relaxed);
        missed(module, next, latency_us);
      }
      ++complete;
    }
    for (; !open_.empty() && open_.front().sinks_left == 0; ++open_base_) open_.pop_front();
  }
  if (complete == 0) return;
  in_flight_.fetch_sub(complete);
  futex_wake_local(in_flight_, 1);
}

/// What this process has to tell, apart from counts.
void Engine::tell_notes(RunReport& result) {
  add_note(result.note, note_);
  if (interop_) {
    interop_->stop();
    for (const std::string& note : interop_->notes()) add_note(result.note, note);
  }
  add_note(result.note, threads_->note());
  std::set<std::string> lost;
  for (const auto& worker : workers_) {
    add_note(result.note, worker->first_failure());
    if (worker->lost_coordinator()) lost.insert(worker->options().xpu_id.name);
  }
  result.lost_coordinators.assign(lost.begin(), lost.end());
  const std::lock_guard lock(hung_mutex_);
  add_note(result.note, hung_note_);
}

RunReport Engine::report() {
  RunReport result;
  tell_notes(result);
  {
    const std::lock_guard lock(releases_mutex_);
    result.releases.assign(releases_.begin(), releases_.end());
    result.num_releases = num_releases_;
    result.lost_releases = lost_releases_;
    result.overlapping_releases = overlapping_releases_;
    result.latencies_us = release_latencies_us_;
  }
  std::sort(result.releases.begin(), result.releases.end(),
            [](const Release& a, const Release& b) { return a.sequence < b.sequence; });
  std::vector<std::uint64_t> lost;  // [module]
  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    const ModuleLine& counts = board_->module(static_cast<int>(m));
    ModuleReport module{graph_.modules[m].name, graph_.modules[m].sink, counts.activations,
                        counts.failed,          counts.dropped,         {}};
    const std::lock_guard lock(latencies_[m]->mutex);
    module.latencies_us = latencies_[m]->us;
    result.modules.push_back(std::move(module));
    lost.push_back(counts.failed + counts.dropped);
  }
  result.routes = routes_->report(lost);
  for (std::size_t n = 0; n < graph_.nodes.size(); ++n) {
    if (!limits_[n].any()) continue;
    const XNodeLine& line = board_->xnode(n);
    result.xnodes.push_back({graph_.nodes[n].name, limits_[n].budget_ns / 1000,
                             limits_[n].hang_ns / 1000, line.jobs, line.overruns, line.hangs,
                             line.longest_ns / 1000});
  }
  result.deadline_misses = deadline_misses_.load();
  result.unkept = unkept_;
  result.several_rates = !graph_.single_rate;
  result.recording_error = recording_error_;
  return result;
}

}  // namespace xauto::runtime
