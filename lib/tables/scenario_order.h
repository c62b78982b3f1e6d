// SPDX-License-Identifier: Apache-2.0
// Which of several scenarios is the least, and which covers most. One rule, for what jobs show
// (scenario_choice.h) and for what the machine's files say (condition_watch.h).
//
//   least  the one in which the app loses least (model/loss.h), then the one whose worst case is the
//          least, then the one that covers fewest others: keys have one worst case for all that their
//          table serves
//   most   one that no other one covers; of those the one that is passed by least; then the greatest in
//          that order, so the one in which the app loses most
#pragma once

#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include "model/app.h"
#include "model/tables.h"

namespace xauto::runtime {

/// Threads: any.
class ScenarioOrder {
 public:
  /// `tables` are valid for `app`.
  ScenarioOrder(const AppSpec& app, const Tables& tables);

  [[nodiscard]] std::size_t size() const { return rank_.size(); }
  /// What holds under `covered` holds under `by`.
  [[nodiscard]] bool covers(std::size_t by, std::size_t covered) const {
    return covers_[by][covered] != 0;
  }
  /// ... and not the other way round.
  [[nodiscard]] bool above(std::size_t by, std::size_t covered) const {
    return covers(by, covered) && !covers(covered, by);
  }
  [[nodiscard]] bool less(std::size_t a, std::size_t b) const { return rank_[a] < rank_[b]; }

  /// Of those that `may`, the least one; of equal ones the first; -1: none may.
  template <class May>
  [[nodiscard]] int least(May may) const {
    int best = -1;
    for (std::size_t s = 0; s < size(); ++s)
      if ((best < 0 || less(s, static_cast<std::size_t>(best))) && may(s))
        best = static_cast<int>(s);
    return best;
  }
  /// Of those that `may`, the one that covers most. `passed_by(s)`: how far what is there passes it.
  template <class May, class PassedBy>
  [[nodiscard]] int most(May may, PassedBy passed_by) const {
    std::vector<std::size_t> those;
    for (std::size_t s = 0; s < size(); ++s)
      if (may(s)) those.push_back(s);
    int best = -1;
    double least_passed = 0;
    for (const std::size_t s : those) {
      bool covered = false;
      for (const std::size_t other : those) covered = covered || above(other, s);
      if (covered) continue;
      const double passed = passed_by(s);
      if (best >= 0 && (passed > least_passed ||
                        (passed == least_passed && !less(static_cast<std::size_t>(best), s))))
        continue;
      best = static_cast<int>(s);
      least_passed = passed;
    }
    return best;
  }

 private:
  /// What is lost, the worst case, and how many scenarios it covers.
  using Rank = std::tuple<std::int64_t, std::int64_t, std::int64_t>;
  std::vector<Rank> rank_;                 ///< [scenario]
  std::vector<std::vector<char>> covers_;  ///< [scenario][covered scenario]
};

}  // namespace xauto::runtime
