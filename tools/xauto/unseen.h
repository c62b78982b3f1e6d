// SPDX-License-Identifier: Apache-2.0
// Coordinators that do not answer us, by what /proc tells everybody.
#pragma once

#include <set>
#include <string>
#include <vector>

namespace xauto::cli {

struct Unseen {
  int pid = 0;
  unsigned uid = 0;
  bool elsewhere = false;  ///< known to be in another network namespace
};

/// All but those whose pids have `answered`.
[[nodiscard]] std::vector<Unseen> coordinators_but(const std::set<int>& answered);

/// What is there and cannot be asked from here, and how it can.
[[nodiscard]] std::string words_of(const Unseen& one);

}  // namespace xauto::cli
