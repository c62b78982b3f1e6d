// SPDX-License-Identifier: Apache-2.0
#include "runtime/watch.h"

#include <algorithm>
#include <climits>
#include <string>

#include "base/clock.h"
#include "base/futex.h"
#include "base/rt.h"
#include "base/thread.h"

namespace xauto::runtime {

Limits Limits::of(const Deployment& deployment, const std::string& module, const std::string& xnode,
                  std::int64_t wcet_us) {
  const ModuleDeployment said = deployment.of(module);
  // In double: a percentage of the longest possible time does not fit otherwise.
  const auto share = [&](std::int64_t pct) {
    constexpr double kMax = 9e18;
    return static_cast<std::int64_t>(
        std::min(kMax, static_cast<double>(wcet_us) * static_cast<double>(pct) * 10));
  };
  Limits limits;
  if (const auto own = deployment.budgets_us.find(xnode); own != deployment.budgets_us.end())
    limits.budget_ns = own->second * 1000;
  else if (said.budget_pct)
    limits.budget_ns = share(*said.budget_pct);
  if (said.hang_us)
    limits.hang_ns = *said.hang_us * 1000;
  else if (said.hang_pct)
    limits.hang_ns = share(*said.hang_pct);
  limits.on_hang = said.on_hang.value_or(OnHang::kLog);
  return limits;
}

void Stopwatch::begin(std::int64_t now_ns, std::uint64_t sequence) {
  since_.store(now_ns);
  sequence_.store(sequence);
  away_ns_.store(0);
  job_.fetch_add(1);
}

std::int64_t Stopwatch::end(std::int64_t now_ns) {
  const std::int64_t took_ns = took(now_ns);
  job_.fetch_add(1);
  return took_ns;
}

void Stopwatch::back(std::int64_t now_ns) {
  const std::int64_t since = away_since_.exchange(0);
  if (since != 0) away_ns_.fetch_add(now_ns - std::max(since, since_.load()));
}

std::int64_t Stopwatch::took(std::int64_t now_ns) const {
  const std::int64_t since = since_.load();
  const std::int64_t away_since = away_since_.load();
  const std::int64_t end = away_since == 0 ? now_ns : std::max(since, away_since);
  return std::max<std::int64_t>(0, end - since - away_ns_.load());
}

std::optional<Stopwatch::Look> Stopwatch::look(std::int64_t now_ns) const {
  const std::uint64_t job = job_.load();
  if (job % 2 == 0) return std::nullopt;
  const Look seen{job, sequence_.load(), took(now_ns)};
  if (job_.load() != job) return std::nullopt;  // it has just ended
  return seen;
}

Result<std::unique_ptr<Watchdog>> Watchdog::start(std::int64_t period_ns,
                                                  std::function<void(std::int64_t)> look) {
  std::unique_ptr<Watchdog> dog(new Watchdog);
  XAUTO_ASSIGN(dog->thread_, start_thread([&quit = dog->quit_, period_ns, look = std::move(look)] {
                 rt::set_thread_name("xauto/watch");
                 while (quit.load() == 0) {
                   futex_wait_local(quit, 0, period_ns);
                   if (quit.load() == 0) look(now_ns());
                 }
               }));
  return dog;
}

void Watchdog::stop() {
  quit_.store(1);
  futex_wake_local(quit_, INT_MAX);
  if (thread_.joinable()) thread_.join();
}

}  // namespace xauto::runtime
