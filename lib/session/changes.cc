// SPDX-License-Identifier: Apache-2.0
#include "session/changes.h"

#include <cstdint>
#include <utility>

#include <fmt/format.h>

#include "model/json_value.h"

namespace xauto::runtime {
namespace {

double in_ms(std::int64_t us) {
  return static_cast<double>(us) / 1000;
}

/// Null: there was none.
Json longest(std::int64_t us) {
  return us < 0 ? Json() : Json(us);
}

}  // namespace

bool nearer(std::int64_t us, std::int64_t worst_us, std::int64_t than_us,
            std::int64_t than_worst_us) {
  if (us < 0 || than_us < 0) return us > than_us;
  if (worst_us == 0 || than_worst_us == 0)
    return worst_us == than_worst_us ? us > than_us : worst_us > 0;
  return static_cast<long double>(us) * static_cast<long double>(than_worst_us) >
         static_cast<long double>(than_us) * static_cast<long double>(worst_us);
}

const SwitchReport* nearest(const RunReport& report) {
  const SwitchReport* nearest = nullptr;
  for (const SwitchReport& s : report.switches) {
    const std::int64_t worst_us = s.worst_case_us.value_or(0);
    if (worst_us > 0 && s.spanned_us >= 0 &&
        (nearest == nullptr ||
         nearer(s.spanned_us, worst_us, nearest->spanned_us, nearest->worst_case_us.value_or(0))))
      nearest = &s;
  }
  return nearest;
}

std::string words_of_nearest(const std::string& chain, std::int64_t us, std::int64_t worst_us,
                             const std::string& from, const std::string& to, const char* mark) {
  const std::string what = "result of '" + chain + "'";
  if (worst_us == 0)
    return fmt::format(
        "the longest {} that met a change took {:.2f} ms ('{}' to '{}'); nothing is "
        "claimed of it",
        what, in_ms(us), from, to);
  return fmt::format(
      "of what met a change the nearest to its worst case, a {}, took {:.2f} ms of {}{:.2f} ms "
      "('{}' to '{}')",
      what, in_ms(us), mark, in_ms(worst_us), from, to);
}

void add_changes(const RunReport& report, Json& into) {
  Json scenarios = Json::array();
  for (const ScenarioReport& s : report.scenarios) {
    scenarios.push_back({{"name", s.name}, {"table", s.table}, {"releases", s.releases}});
  }
  into["scenarios"] = std::move(scenarios);
  Json switches = Json::array();
  for (const SwitchReport& s : report.switches) {
    Json one = {{"release", s.release},
                {"from", s.from},
                {"to", s.to},
                {"table", s.table},
                {"why", s.why},
                {"held_us", s.held_us},
                {"spanned_us", longest(s.spanned_us)}};
    if (s.worst_case_us) one["worst_case_us"] = *s.worst_case_us;
    if (!s.chain.empty()) one["chain"] = s.chain;
    if (!s.detail.empty()) one["detail"] = s.detail;
    switches.push_back(std::move(one));
  }
  into["switches"] = std::move(switches);
  into["num_switches"] = report.num_switches;
}

}  // namespace xauto::runtime
