// SPDX-License-Identifier: Apache-2.0
#include "base/nearest.h"

#include <algorithm>
#include <cstdint>

namespace xauto {
namespace {

/// Optimal string alignment.
std::size_t distance(std::string_view a, std::string_view b) {
  std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i)
    for (std::size_t j = 0; j <= b.size(); ++j) {
      if (i == 0 || j == 0) {
        d[i][j] = i + j;
        continue;
      }
      d[i][j] = std::min(
          {d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1)});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
    }
  return d[a.size()][b.size()];
}

}  // namespace

std::string nearest(std::string_view given, const std::vector<std::string>& words) {
  constexpr std::size_t kLongest = 60;  // what is longer is no slip
  constexpr std::size_t kLeastBeginning = 3;
  std::string best;
  std::size_t least = SIZE_MAX;
  if (given.size() > kLongest) return best;
  for (const std::string& word : words) {
    const std::size_t most = std::max<std::size_t>(1, word.size() / 3);
    const bool begins = given.size() >= kLeastBeginning && word.starts_with(given);
    const std::size_t wrong = begins ? 1 : distance(given, word);
    if (wrong > most || wrong >= least) continue;
    least = wrong;
    best = word;
  }
  return best;
}

}  // namespace xauto
