// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/meetings.h"

#include <algorithm>

namespace xauto::solver::keys {
namespace {

/// Windows in a row of one XNode that another one's window is compared with.
constexpr int kMostInRow = 4;

int clock_of(const Problem& p, int i) {
  return p.domains[at(p.domain_of(i))].clock;
}

/// `k` windows of `u` in a row and one of `v`: where all of these fit into less than their work, all
/// windows of v have that work.
void add_rows(const Problem& p, int xpu, int u, int v, std::vector<Disjunction>& choices) {
  const Tick of_u = p.wcet(u, xpu), of_v = p.wcet(v, xpu), period = p.period_of(u);
  if (!repeats_at_once(p, u)) return;
  for (int k = 2; k <= kMostInRow; ++k) {
    const Tick by = (k - 1) * (of_u - period) + of_v;
    if (by <= 0) return;
    Disjunction choice;
    choice.add({u, by});
    choice.add({v, k * of_u});
    choices.push_back(choice);
  }
}

}  // namespace

std::vector<Disjunction> choices_on(const Problem& p, int xpu, const std::vector<int>& on,
                                    std::size_t most_in_threes) {
  std::vector<Disjunction> choices;
  const Tick cost = p.preempt[at(xpu)];
  for (std::size_t a = 0; a < on.size(); ++a)
    for (std::size_t b = a + 1; b < on.size(); ++b) {
      const int u = on[a], v = on[b];
      if (clock_of(p, u) == clock_of(p, v)) continue;
      const Tick of_u = p.wcet(u, xpu), of_v = p.wcet(v, xpu);
      Disjunction choice;
      if (p.preemptive[at(xpu)] == 0) {
        // The shorter window is blocked by who has the longer one.
        choice.add({u, of_v}, {v, of_u});
      } else {
        // The shorter window pays for a preemption.
        choice.add({u, of_v + cost});
        choice.add({v, of_u + cost});
        if (cost > 0) choice.add({u, of_v}, {v, of_u});
      }
      choices.push_back(choice);
      add_rows(p, xpu, u, v, choices);
      add_rows(p, xpu, v, u, choices);
      for (std::size_t c = b + 1; c < std::min(on.size(), most_in_threes); ++c) {
        const int w = on[c];
        if (clock_of(p, w) == clock_of(p, u) || clock_of(p, w) == clock_of(p, v)) continue;
        const Tick of_w = p.wcet(w, xpu);
        Disjunction three;
        three.add({u, of_v + of_w});
        three.add({v, of_u + of_w});
        three.add({w, of_u + of_v});
        choices.push_back(three);
      }
    }
  return choices;
}

Tick meets_itself(Tick period, Tick first, Tick last, Tick length, Tick longer) {
  if (length < period) return 0;
  const Tick into = length % period, least = std::min(first, last);
  if (into == 0 || into >= first + last || longer >= std::min(into, least)) return 0;
  return std::min(least - longer, first + last - into);
}

}  // namespace xauto::solver::keys
