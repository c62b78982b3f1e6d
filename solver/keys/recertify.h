// SPDX-License-Identifier: Apache-2.0
// Whether a certified policy still is one when some of its jobs may start sooner: their a and e fall, their d stay.
//
// Windows only grow then. Of the intervals that hold some of them, the old ones were no longer: no interval's demand
// grows, but by who may preempt now and pays for it. So an XPU where nobody pays, and nobody is blocked, keeps its
// certificate; one of one domain is looked at only around what changed (alone.h); one of several is tested where somebody
// pays anew. With levels, urgent releases, others beside or contention all is tested each time.
#pragma once

#include <optional>
#include <vector>

#include "solver/keys/alone.h"
#include "solver/keys/pair.h"
#include "solver/keys/problem.h"
#include "solver/keys/windows.h"

namespace xauto::solver::keys {

class Recertifier {
 public:
  /// A job, and what was.
  struct Was {
    int slot;
    Tick a, hold, e;
  };

  /// `w` is certified.
  Recertifier(const Problem& problem, const std::vector<int>& xpu, const Windows& w);
  /// Whether `w` still is, of which these have fallen since it last was. If so the next call goes on from here; if
  /// not, from where this one did.
  [[nodiscard]] bool still(const Windows& w, const std::vector<Was>& fallen);

 private:
  /// What it takes to know whether an XPU keeps its certificate.
  enum class Kind { kKeeps, kPays, kWhole };
  struct Lane {
    Kind kind = Kind::kWhole;
    bool shared = false;
    std::vector<int> xnodes;
    Tick pad = 0;
    std::optional<FittingAlone> alone;
    std::vector<Was> fallen;
  };

  [[nodiscard]] bool keeps(int m, const Windows& w);
  [[nodiscard]] bool pays_no_more(int m, const Windows& w);
  void who_pays(int m, const Windows& w);
  void look_at(const Lane& lane, int i, int n, const Windows& w);
  void look_at_those_ready_by(const Lane& lane, const Was& was, const Windows& w);
  void pays(std::size_t slot, bool does);
  void take_back();

  const Problem& p_;
  const std::vector<int>& xpu_;
  std::vector<Lane> lanes_;    ///< [xpu]
  Charges charges_;            ///< of XPUs where it is asked who pays: that alone
  std::vector<Starts> early_;  ///< [xnode] by e
  std::vector<int> number_;    ///< [slot] in its XPU's `alone`
  Windows urgent_;
  // Of this call.
  std::vector<std::pair<std::size_t, char>> paid_;  ///< slot, and before
  std::vector<std::pair<int, Starts>> started_;     ///< XNode, and before
  std::vector<int> changed_;                        ///< XPUs whose `alone` has changed
  Charges all_charges_;
};

}  // namespace xauto::solver::keys
