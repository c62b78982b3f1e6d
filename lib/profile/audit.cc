// SPDX-License-Identifier: Apache-2.0
#include "profile/audit.h"

#include <algorithm>
#include <cmath>

#include "base/clock.h"

namespace xauto::runtime {

double chance_of_heads(std::size_t heads, std::size_t throws) {
  // The terms by logarithms: 2^-throws is no double for many.
  const auto n = static_cast<double>(throws);
  double chance = 0;
  for (std::size_t k = heads; k <= throws; ++k) {
    const auto j = static_cast<double>(k);
    chance += std::exp(std::lgamma(n + 1) - std::lgamma(j + 1) - std::lgamma(n - j + 1) -
                       n * std::log(2.0));
  }
  return std::min(chance, 1.0);
}

OtherXpu judge(const std::vector<BusyPair>& pairs, std::int64_t exec_ns, std::size_t questions) {
  OtherXpu other;
  if (pairs.empty()) return other;
  std::int64_t busy = 0, idle = 0;
  std::size_t more = 0, differ = 0;
  for (const BusyPair& pair : pairs) {
    busy += pair.busy_ns;
    idle += pair.idle_ns;
    more += pair.busy_ns > pair.idle_ns ? 1 : 0;
    differ += pair.busy_ns != pair.idle_ns ? 1 : 0;
  }
  const auto count = static_cast<std::int64_t>(pairs.size());
  other.busy_us = busy / count / 1000;
  other.idle_us = idle / count / 1000;
  other.used = (busy - idle) / count * 100 >= exec_ns * kLeastSharePct && differ > 0 &&
               chance_of_heads(more, differ) * static_cast<double>(questions) <= kFalseAlarm;
  return other;
}

std::size_t repetitions_needed(std::size_t questions) {
  std::size_t needed = 1;
  while (chance_of_heads(needed, needed) * static_cast<double>(questions) > kFalseAlarm) ++needed;
  return needed;
}

Audit::Audit(const Platform& platform, const std::vector<Presence>& presence,
             const std::string& machine_root, const std::vector<int>& cores)
    : num_xpus_(platform.xpus.size()),
      emulator_(xpu::busy_on_emulator(platform, presence)),
      drivers_(xpu::busy_by_drivers(platform, machine_root, cores)) {}

std::vector<int> Audit::others(int xpu, bool emulated) {
  thread_.check();
  emulated_ = emulated;
  std::vector<int> known;
  for (int x = 0; x < static_cast<int>(num_xpus_); ++x)
    if (x != xpu && meter().looks_back_ns(x)) known.push_back(x);
  return known;
}

Result<Audit::Readings> Audit::read() {
  Readings readings;
  for (const int x : others(xpu_, emulated_)) {
    XAUTO_ASSIGN(const std::int64_t busy_ns, meter().busy_ns(x));
    readings[x] = {busy_ns, now_ns()};
  }
  return readings;
}

Status Audit::begin(int xpu, bool emulated) {
  thread_.check();
  xpu_ = xpu;
  emulated_ = emulated;
  // Whoever looks back must see a time without the XNode first.
  std::int64_t quiet_ns = 0;
  for (const int x : others(xpu, emulated))
    quiet_ns = std::max(quiet_ns, *meter().looks_back_ns(x));
  sleep_until_ns(now_ns() + quiet_ns);
  XAUTO_ASSIGN(before_, read());
  begun_ns_ = now_ns();
  return {};
}

Result<std::map<int, BusyPair>> Audit::end() {
  thread_.check();
  XAUTO_ASSIGN(const Readings after, read());
  const std::int64_t exec_ns = now_ns() - begun_ns_;
  // One that looks back knows of the exec with its next sample.
  const bool any_looks_back = std::any_of(before_.begin(), before_.end(), [&](const auto& one) {
    return *meter().looks_back_ns(one.first) > 0;
  });
  sleep_until_ns(now_ns() + (any_looks_back ? std::max(exec_ns, xpu::kLoadPeriodNs) : exec_ns));
  XAUTO_ASSIGN(const Readings later, read());
  std::map<int, BusyPair> pairs;
  for (const auto& [x, before] : before_) {
    if (*meter().looks_back_ns(x) > 0) {
      pairs[x] = {later.at(x).busy_ns, before.busy_ns};
      continue;
    }
    // Both times are as long as they are, for each XPU: the second one counts as long as the first.
    const auto during = static_cast<double>(after.at(x).at_ns - before.at_ns);
    const auto without = static_cast<double>(later.at(x).at_ns - after.at(x).at_ns);
    const auto idle = static_cast<double>(later.at(x).busy_ns - after.at(x).busy_ns);
    pairs[x] = {after.at(x).busy_ns - before.busy_ns,
                static_cast<std::int64_t>(idle * during / std::max(without, 1.0))};
  }
  return pairs;
}

}  // namespace xauto::runtime
