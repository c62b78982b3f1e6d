// SPDX-License-Identifier: Apache-2.0
// An emulation script as a function of time: what holds at an instant, and when that changes. It
// remembers nothing, so an emulator that is started again needs to know only when the script began.
#pragma once

#include <cstddef>
#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "emu/machine.h"
#include "model/emulation_script.h"

namespace xauto::emu {

/// Threads: pure.
class ScriptPlay {
 public:
  /// What holds from a step on to the next.
  struct State {
    std::map<std::string, std::int64_t, std::less<>> speed_pct, contention_pct;
    std::set<std::string, std::less<>> stopped;
  };

  /// `script` has passed validate(). One without steps never changes anything.
  explicit ScriptPlay(const EmulationScript& script);

  [[nodiscard]] bool empty() const { return states_.size() == 1; }
  /// How many steps have been taken at `elapsed` >= 0, since the last repetition; 0: nominal.
  [[nodiscard]] std::size_t steps_at(Nanos elapsed) const;
  [[nodiscard]] const State& after(std::size_t steps) const { return states_[steps]; }
  /// The first change after `elapsed`; INT64_MAX: there is none.
  [[nodiscard]] Nanos next_change(Nanos elapsed) const;

 private:
  std::vector<Nanos> at_;
  std::vector<State> states_;  ///< one more than at_
  Nanos repeat_ = 0;
};

}  // namespace xauto::emu
