// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/what_if.h"

#include <algorithm>
#include <atomic>
#include <charconv>
#include <optional>
#include <set>

#include "base/clock.h"
#include "model/components.h"
#include "solver/threads.h"

namespace xauto::solver::keys {
namespace {

constexpr std::int64_t kMostPercent = 10'000;
constexpr double kLeastMoveS = 0.05,
                 kMostMoveS = 0.5;  // below, a search finds little; above, little more

Result<WhatIf> ask(const AppSpec& app, const Platform& platform, const Policy& begin,
                   std::string change, Options options) {
  options.hint = &begin;
  options.on_progress = nullptr;
  auto solved = solve(app, platform, options);
  if (!solved && options.keep != Keep::kPlacement) {  // where it was is no place any more
    options.hint = nullptr;
    solved = solve(app, platform, options);
  }
  if (!solved) return tl::unexpected<Error>(std::move(solved).error());
  Answer& answer = *solved;
  return WhatIf{std::move(change), answer.outcome, std::move(answer.overload.text),
                worst_cases(answer.policy)};
}

/// All WCETs on a type, rounded up.
void scale(AppSpec& app, const std::string& type, std::int64_t percent) {
  const auto to = [percent](std::int64_t us) {
    return std::max<std::int64_t>(1, (us * percent + 99) / 100);
  };
  for (XNodeSpec& xnode : app.xnodes) {
    if (const auto wcet = xnode.wcet_us.find(type); wcet != xnode.wcet_us.end())
      wcet->second = to(wcet->second);
    for (BesideSpec& beside : xnode.beside)
      if (beside.on == type) beside.wcet_us = to(beside.wcet_us);
  }
}

}  // namespace

Result<AppSpec> with_period(const AppSpec& app, int source, Period period) {
  AppSpec changed = app;
  XAUTO_ASSIGN(const Components parts, find_components(app));
  changed.sources[at(source)].period = period;
  for (const xauto::Component& c : parts.components)
    if (std::ranges::count(c.sources, source) > 0)
      for (const int other : c.sources) changed.sources[at(other)].period = period;
  XAUTO_TRY(validate(changed));
  return changed;
}

Result<WhatIf> assume(const AppSpec& app, const Platform& platform, const Policy& policy,
                      const std::string& text, const Options& options) {
  const auto refuse = [&](const char* what) {
    return fail(ErrorCode::kInvalid, what, "'" + text + "'", "SOURCE=HZ, TYPE=PERCENT% or +TYPE");
  };
  if (text.starts_with('+')) {
    const std::string type = text.substr(1);
    const std::vector<int> there = platform.instances_of(type);
    if (there.empty()) return refuse("the platform has no XPU of this type");
    Platform larger = platform;
    Xpu more = platform.xpus[static_cast<std::size_t>(there.front())];
    for (std::size_t n = there.size(); larger.find(more.id) >= 0; ++n)
      more.id = type + std::to_string(n);
    larger.xpus.push_back(more);
    return ask(app, larger, policy, "one more " + type, options);
  }
  const std::size_t equals = text.rfind('=');
  if (equals == std::string::npos || equals == 0) return refuse("is no change that is known");
  const std::string name = text.substr(0, equals);
  std::string value = text.substr(equals + 1);
  AppSpec changed = app;
  if (value.ends_with('%')) {
    value.pop_back();
    std::int64_t percent = 0;
    const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), percent);
    if (error != std::errc() || end != value.data() + value.size() || percent < 1 ||
        percent > kMostPercent)
      return refuse("is no percentage from 1 to 10000");
    if (platform.instances_of(name).empty()) return refuse("the platform has no XPU of this type");
    scale(changed, name, percent);
    return ask(changed, platform, policy, name + " at " + value + " % of its WCETs", options);
  }
  const auto source = std::ranges::find(changed.sources, name, &SourceSpec::name);
  if (source == changed.sources.end()) return refuse("the app has no source of this name");
  const auto period = Period::of_rate(value);
  if (!period) return tl::unexpected<Error>(period.error());
  if (source->period == *period) return refuse("it has this rate");
  if (source->offset_us * period->den >= period->num)
    return refuse("the source's offset is not below that period");
  XAUTO_ASSIGN(changed,
               with_period(app, static_cast<int>(source - changed.sources.begin()), *period));
  return ask(changed, platform, policy, name + " at " + value + " Hz", options);
}

Result<Moves> moves(const AppSpec& app, const Platform& platform, const Policy& policy,
                    const std::vector<int>& xnodes, const Options& options) {
  std::vector<int> served(platform.xpus.size(), 0);
  for (const Placement& p : policy.placements) ++served[static_cast<std::size_t>(p.xpu)];
  std::vector<std::pair<int, int>> elsewhere;  // XNode, XPU
  for (const int i : xnodes) {
    const XNodeSpec& xnode = app.xnodes[static_cast<std::size_t>(i)];
    std::set<std::string> idle;  // types
    for (int x = 0; x < static_cast<int>(platform.xpus.size()); ++x) {
      const Xpu& xpu = platform.xpus[static_cast<std::size_t>(x)];
      if (x == policy.placements[static_cast<std::size_t>(i)].xpu || !xnode.wcet_on(xpu.type))
        continue;
      if (served[static_cast<std::size_t>(x)] == 0 && !idle.insert(xpu.type).second) continue;
      elsewhere.emplace_back(i, x);
    }
  }
  Moves made;
  const std::size_t threads =
      static_cast<std::size_t>(std::clamp(options.threads, 1, kMostThreads));
  Options keep = options;
  keep.keep = Keep::kPlacement;
  keep.threads = 1;  // of each: they are searched beside each other
  keep.time_limit_s = made.each_s =
      std::clamp(options.time_limit_s * static_cast<double>(threads) /
                     static_cast<double>(std::max<std::size_t>(1, elsewhere.size())),
                 kLeastMoveS, kMostMoveS);
  const std::int64_t start_ns = now_ns();
  std::vector<std::optional<Result<WhatIf>>> answers(elsewhere.size());
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t k; (k = next.fetch_add(1)) < elsewhere.size();) {
      if (static_cast<double>(now_ns() - start_ns) >= options.time_limit_s * 1e9 ||
          (options.stop != nullptr && options.stop->load()))
        return;
      const auto& [i, x] = elsewhere[k];
      Policy moved = policy;
      moved.placements[static_cast<std::size_t>(i)].xpu = x;
      answers[k] = ask(app, platform, moved,
                       app.xnodes[static_cast<std::size_t>(i)].name + " on " +
                           platform.xpus[static_cast<std::size_t>(x)].id,
                       keep);
    }
  };
  Threads pool;
  for (std::size_t t = 1; t < threads && pool.start(work);) ++t;
  work();
  pool.join();
  for (std::optional<Result<WhatIf>>& answer : answers) {
    if (!answer)
      ++made.untried;
    else if (*answer)
      made.tried.push_back(std::move(**answer));
  }
  return made;
}

}  // namespace xauto::solver::keys
