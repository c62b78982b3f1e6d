// SPDX-License-Identifier: Apache-2.0
#include "engine/hang_watch.h"

#include <algorithm>

#include <signal.h>
#include <uapi/xauto/event.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "session/notes.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kSilenceNs = 3'000'000'000;  ///< of a watchdog, beyond the hang limit

}  // namespace

Result<std::unique_ptr<HangWatch>> HangWatch::make(const Context& context, const Wiring& wiring,
                                                   RunRole& role,
                                                   const std::vector<std::vector<Limits>>& limits) {
  std::unique_ptr<HangWatch> made(new HangWatch(context, wiring, role));
  XAUTO_TRY(made->start(limits));
  return made;
}

/// Looks often enough to notice a hang within a quarter of the shortest limit.
Status HangWatch::start(const std::vector<std::vector<Limits>>& limits) {
  std::int64_t shortest = 0;
  bool others = false, claims = false, certified = false;
  for (const std::vector<Limits>& of_table : limits)
    for (std::size_t n = 0; n < of_table.size(); ++n) {
      const std::int64_t ns = of_table[n].hang_ns;
      const auto module = static_cast<std::size_t>(context_.graph.nodes[n].module);
      certified = certified || (of_table[n].wcet_ns > 0 && context_.hosts(module));
      // By tables a job's time decides which one is next, and that is told elsewhere.
      claims =
          claims || (of_table[n].wcet_ns > 0 && context_.hosts(module) && !context_.session.tables);
      if (ns <= 0) continue;
      if (context_.hosts(module)) {
        shortest = shortest == 0 ? ns : std::min(shortest, ns);
      } else if (of_table[n].on_hang == OnHang::kRestart) {
        others = role_.look_after(context_.plan.process_of[module],
                                  std::min(ns, INT64_MAX - kSilenceNs) + kSilenceNs) ||
                 others;
      }
    }
  const bool tells = context_.session.tables && !role_.leads();
  if (shortest == 0 && !others && !tells && !certified) return {};
  if (certified) {
    std::vector<pid_t> on_cores;
    for (const auto& worker : wiring_.workers())
      if (worker->on_core()) on_cores.push_back(worker->times().thread_id());
    threads_ = std::make_unique<ThreadWatch>(std::move(on_cores));
    foreign_ =
        std::make_unique<ForeignWatch>(context_.session, context_.board, role_.leads(), [this] {
          const auto& workers = wiring_.workers();
          const auto shares =
              std::ranges::find_if(workers, [](const auto& worker) { return worker->shares(); });
          if (shares == workers.end()) return ForeignWatch::Neighbours();
          auto told = (*shares)->neighbours();
          return ForeignWatch::Neighbours{std::move(told.processes), std::move(told.not_kept_off)};
        });
  }
  const std::int64_t period =
      shortest == 0 ? kLookNs : std::clamp<std::int64_t>(shortest / 4, 1'000'000, kLookNs);
  XAUTO_ASSIGN(const std::shared_ptr<Alarm> alarm, Alarm::make());
  if (tells)
    for (const auto& worker : wiring_.workers()) worker->times().ask(alarm);
  XAUTO_ASSIGN(
      watchdog_,
      Watchdog::start(alarm, period, [this, tells, claims](std::int64_t now, std::int64_t late_ns) {
        if (threads_) threads_->woke(late_ns);
        look_at_jobs(now, tells, claims);
        look_at_threads(now);
        role_.looked(now);
      }));
  return {};
}

void HangWatch::look_at_jobs(std::int64_t now_ns, bool tells, bool claims) {
  for (const auto& worker : wiring_.workers()) {
    JobTimes& times = worker->times();
    if (const auto job = times.find_hung(now_ns)) hung(*worker, *job);
    if (tells) times.tell_time(now_ns);
    if (claims) times.tell_past_wcet(now_ns);
    if (claims) worker->tell_stuck_call(now_ns);
  }
}

void HangWatch::stop() {
  thread_.check();
  const bool looked = watchdog_ != nullptr;
  watchdog_.reset();
  if (looked && threads_) threads_->finish();
}

/// The watchdog of short limits comes more often.
void HangWatch::look_at_threads(std::int64_t now_ns) {
  if (!threads_ || now_ns - looked_ns_ < kLookNs) return;
  looked_ns_ = now_ns;
  for (const auto& worker : wiring_.workers()) worker->tell_moved();
  threads_->look(now_ns);
  foreign_->look(now_ns);
}

void HangWatch::report(RunReport& into) const {
  thread_.check();
  if (!threads_) return;
  for (TakenReport& one : threads_->taken()) into.account.taken.push_back(std::move(one));
  add_note(into.account.not_watched, threads_->not_watched());
  if (foreign_->is_blind())
    add_note(into.account.not_watched,
             "other runs are admitted to its cores, and nobody tells their jobs from strangers");
}

const std::string& HangWatch::note() const {
  thread_.check();
  return note_;
}

void HangWatch::hung(const Worker& worker, const JobTimes::Hung& job) {
  const std::string text = "XNode '" + job.placed->name + "' on " + worker.xpu_name() +
                           " ran past its hang limit of " +
                           std::to_string(job.placed->limits.hang_ns / 1'000'000) +
                           " ms in activation " + std::to_string(job.sequence);
  const bool first = job.placed->line->hangs.load(std::memory_order_relaxed) == 1;
  if (first) add_note(note_, text);
  if (context_.trace != nullptr)
    context_.trace->write(XAUTO_EV_HANG, job.sequence,
                          static_cast<std::uint16_t>(job.placed->xnode),
                          static_cast<std::uint16_t>(worker.module()),
                          static_cast<std::uint16_t>(worker.options().xpu),
                          static_cast<std::uint32_t>(std::min<std::int64_t>(
                              UINT32_MAX, job.placed->limits.hang_ns / 1'000'000)));
  switch (job.placed->limits.on_hang) {
    case OnHang::kLog:
      if (first) log::warn("{} (further ones are only counted)", text);
      break;
    case OnHang::kDrop:
      if (wiring_.module(static_cast<std::size_t>(worker.module()))->abandon(job.sequence) && first)
        log::warn("{}: given up (further ones are only counted)", text);
      break;
    case OnHang::kRestart:
      log::error("{}: its process is killed", text);
      (void)kill(getpid(), SIGKILL);
      break;
  }
}

}  // namespace xauto::runtime
