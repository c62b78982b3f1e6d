// SPDX-License-Identifier: Apache-2.0
#include "emu/script_play.h"

#include <algorithm>
#include <limits>

namespace xauto::emu {

ScriptPlay::ScriptPlay(const EmulationScript& script) : repeat_(script.repeat_us * 1000) {
  State state;
  states_.push_back(state);
  for (const EmulationStep& step : script.steps) {
    for (const auto& [type, pct] : step.speed_pct) state.speed_pct[type] = pct;
    for (const auto& [type, pct] : step.contention_pct) state.contention_pct[type] = pct;
    for (const std::string& id : step.stop) state.stopped.insert(id);
    for (const std::string& id : step.start) state.stopped.erase(id);
    at_.push_back(step.at_us * 1000);
    states_.push_back(state);
  }
}

std::size_t ScriptPlay::steps_at(Nanos elapsed) const {
  const Nanos within = repeat_ > 0 ? elapsed % repeat_ : elapsed;
  return static_cast<std::size_t>(std::upper_bound(at_.begin(), at_.end(), within) - at_.begin());
}

Nanos ScriptPlay::next_change(Nanos elapsed) const {
  const Nanos begin = repeat_ > 0 ? elapsed - elapsed % repeat_ : 0;
  const auto next = std::upper_bound(at_.begin(), at_.end(), elapsed - begin);
  if (next != at_.end()) return begin + *next;
  return repeat_ > 0 ? begin + repeat_ : std::numeric_limits<Nanos>::max();
}

}  // namespace xauto::emu
