// SPDX-License-Identifier: Apache-2.0
// What XNodes that stay on one instance each take of a window there, counted so that it tells that
// three of 40 ms do not fit on two instances of 60 ms. A part of the LP of energy_lp.h, whose
// energies alone would let an XNode be in two places.
//
// With e_1, e_2, ... the work that must fall into a window of length L, and f with
//     f(e_1) + f(e_2) + ... <= room  for all on one instance (where e_1 + e_2 + ... <= L),
// those on m instances satisfy  sum of f(e_i) <= m room. Such an f is a dual feasible function
// (Fekete, Schepers 2001; Carlier, Clautiaux, Moukrim 2007). Two families, by `grain`:
//
//   g > 0   q = floor(L / g) is the room; e counts floor(e / g), and q - floor((L - e) / g) if it is
//           more than half of L. Without one of these the sum is at most floor(L / g). One instance
//           has no two of them; beside one, of e, there is L - e for the others, floor((L - e) / g).
//   c < 0   L is the room; e counts nothing below -c, L above L + c, e in between. Beside one above
//           L + c there are only some below -c.
//
// grain 0 is the energy itself.
#pragma once

#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

[[nodiscard]] Time packed(Time work, Time length, Time grain);
[[nodiscard]] Time packed_room(Time length, Time grain);

/// Looks for the grain by which fractions of XNodes overfill a window most.
class Packing {
 public:
  void clear() {
    work_.clear();
    fraction_.clear();
  }
  void add(Time work, double fraction) {
    work_.push_back(static_cast<double>(work));
    fraction_.push_back(fraction);
  }
  /// By how many instances' room the XNodes added exceed all that there is; `grain`: by which.
  [[nodiscard]] double excess(Time length, double instances, Time& grain) const;

 private:
  // In floating point: what is found is a hint, and counted anew in integers.
  [[nodiscard]] double in_grains(Time length, Time grain) const;
  [[nodiscard]] double in_between(Time length, Time cut) const;

  std::vector<double> work_, fraction_;
};

}  // namespace xauto::solver
