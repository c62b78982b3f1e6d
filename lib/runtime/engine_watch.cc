// SPDX-License-Identifier: Apache-2.0
// Jobs past their hang limits, and processes that do not look after themselves. See watch.h.
#include <algorithm>

#include <signal.h>
#include <uapi/xauto/event.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "runtime/engine.h"
#include "runtime/notes.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kSilenceNs = 3'000'000'000;  ///< of a watchdog, beyond the hang limit

}  // namespace

/// Looks often enough to notice a hang within a quarter of the shortest limit.
void Engine::start_watchdog() {
  std::int64_t shortest = 0;
  for (std::size_t n = 0; n < limits_.size(); ++n) {
    const std::int64_t ns = limits_[n].hang_ns;
    const auto module = static_cast<std::size_t>(graph_.nodes[n].module);
    if (ns <= 0) continue;
    if (hosted(module)) {
      shortest = shortest == 0 ? ns : std::min(shortest, ns);
    } else if (hub_ && limits_[n].on_hang == OnHang::kRestart) {
      std::int64_t& silence = silence_ns_[plan_.process_of[module]];
      silence = std::max(silence, std::min(ns, INT64_MAX - kSilenceNs) + kSilenceNs);
    }
  }
  if (shortest == 0 && silence_ns_.empty()) return;
  const std::int64_t period =
      shortest == 0 ? 50'000'000 : std::clamp<std::int64_t>(shortest / 4, 1'000'000, 50'000'000);
  watchdog_ = std::make_unique<Watchdog>(period, [this](std::int64_t now) {
    for (const auto& worker : workers_)
      if (const auto job = worker->find_hung(now)) hung(*worker, *job);
    if (member_) board_->process(session_.process).watched_ns.store(now);
    watch_members(now);
  });
}

/// In the hub: a process that has stopped as a whole cannot tell that it hangs.
void Engine::watch_members(std::int64_t now) {
  for (const auto& [process, silence] : silence_ns_) {
    std::atomic<std::int64_t>& watched = board_->process(process).watched_ns;
    const std::int64_t last = watched.load();
    if (last == 0 || now - last <= silence) continue;
    watched.store(0);  // of this one; the next starts anew
    log::error("process {} has not looked after itself for {} ms: it is killed", process,
               (now - last) / 1'000'000);
    hub_->kill(process);
  }
}

void Engine::hung(const Worker& worker, const Worker::Hung& job) {
  const std::string text = "XNode '" + job.placed->name + "' on " + worker.options().xpu_id.name +
                           " ran past its hang limit of " +
                           std::to_string(job.placed->limits.hang_ns / 1'000'000) +
                           " ms in activation " + std::to_string(job.sequence);
  const bool first = job.placed->line->hangs.load(std::memory_order_relaxed) == 1;
  if (first) {
    const std::lock_guard lock(hung_mutex_);
    add_note(hung_note_, text);
  }
  if (trace_)
    trace_->write(XAUTO_EV_HANG, job.sequence, static_cast<std::uint16_t>(job.placed->xnode),
                  static_cast<std::uint16_t>(job.module),
                  static_cast<std::uint16_t>(worker.options().xpu),
                  static_cast<std::uint32_t>(
                      std::min<std::int64_t>(UINT32_MAX, job.placed->limits.hang_ns / 1'000'000)));
  switch (job.placed->limits.on_hang) {
    case OnHang::kLog:
      if (first) log::warn("{} (further ones are only counted)", text);
      break;
    case OnHang::kDrop:
      if (modules_[static_cast<std::size_t>(job.module)]->abandon(job.sequence) && first)
        log::warn("{}: given up (further ones are only counted)", text);
      break;
    case OnHang::kRestart:
      log::error("{}: its process is killed", text);
      (void)kill(getpid(), SIGKILL);
      break;
  }
}

}  // namespace xauto::runtime
