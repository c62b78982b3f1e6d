// SPDX-License-Identifier: Apache-2.0
// The last of the search: of candidates that claim no more, of any chain, that with the least typical latency.
#include <algorithm>
#include <functional>
#include <utility>

#include "solver/keys/chains.h"
#include "solver/keys/holds.h"
#include "solver/keys/search.h"
#include "solver/keys/typical.h"

namespace xauto::solver::keys {
namespace {

// Chosen, not tuned.
constexpr double kSingleMove = 0.6;  ///< of candidates: one move, not two
/// Moves without a better one, until it ends.
constexpr std::int64_t kMostIdle = 20'000;
/// With all its holds it takes at most so much of the least: else it is not asked what it takes without those that are
/// not needed, which takes longer.
constexpr double kWorthDropping = 1.02;
constexpr double kJustAbove = 1 + 1e-9;
/// Who waits for another clock does so, but where it takes so much of that without.
constexpr double kWorthReadingLess = 0.98;

/// In microseconds, as they are claimed: of any release, and of an urgent one.
std::vector<Tick> claimed_by(const Problem& p, const Figures& figures) {
  std::vector<Tick> claims;
  for (std::size_t c = 0; c < p.chains.size(); ++c) {
    claims.push_back(p.up_to_us(std::max(Tick{0}, figures.chain[c])));
    if (p.any_urgent) claims.push_back(p.up_to_us(worst_case(p, p.chains[c], figures.w, true)));
  }
  return claims;
}

}  // namespace

/// `w` without the holds that no claim needs: as it is run.
double Search::typical_of(TypicalPlay& play, const Candidate& candidate, Windows& w) const {
  w = candidate.figures.w;
  drop_holds(p_, candidate.decision.xpu, w, limits_.until);
  return play.latency(candidate.decision.xpu, w);
}

void Search::least_typical(TypicalPlay& play, const SearchLimits& limits, Keep keep,
                           Candidate& best) {
  limits_ = limits;
  keep_ = keep;
  goal_ = {false, true};
  evaluator_.set_goal(goal_);
  critical_.clear();
  shared_ = shared_xpus(p_, best.decision.xpu);
  const std::vector<Tick> claims = claimed_by(p_, best.figures);
  const double most = evaluator_.cost_of(best.figures) * kJustAbove;
  Windows w, next_w;
  // Who need not wait for another clock is decided at the end.
  play.set_reads_all(std::vector<char>(at(p_.num_xnodes), 1));
  double least = typical_of(play, best, w);
  Candidate next;
  for (std::int64_t idle = 0; idle < kMostIdle && !over(); ++idle) {
    next.decision = best.decision;
    bool changed = false;
    for (int m = random_.unit() < kSingleMove ? 1 : 2; m > 0; --m)
      changed = mutate(best, next.decision) || changed;
    if (!changed) continue;
    evaluator_.evaluate(next.decision, most, next.figures, limits_.until, &best.decision,
                        &best.figures);
    if (!next.figures.valid) continue;
    const std::vector<Tick> now = claimed_by(p_, next.figures);
    if (!std::equal(now.begin(), now.end(), claims.begin(), std::less_equal<>())) continue;
    const bool same = next.decision.xpu == best.decision.xpu &&
                      next.figures.w.d == best.figures.w.d &&
                      next.figures.w.hold == best.figures.w.hold;
    if (!same) {
      if (play.latency(next.decision.xpu, next.figures.w) > least * kWorthDropping ||
          !certify(p_, next.decision.xpu, next.figures.w, nullptr, limits_.until))
        continue;
      const double typical = typical_of(play, next, next_w);
      if (typical > least || limits_.until.over()) continue;
      if (typical < least) idle = 0;
      least = typical;
      std::swap(w, next_w);
    }
    std::swap(best, next);
    shared_ = shared_xpus(p_, best.decision.xpu);
  }
  best.figures.w = std::move(w);
}

void least_typical(const AppSpec& app, const Problem& p, std::uint64_t seed, Keep keep,
                   const SearchLimits& limits, Candidate& best) {
  if (limits.until.over()) return;
  TypicalPlay play(app, p, seed);
  if (!play.is_short()) return;
  Search search(p, best.figures.chain, Aim::kSum, seed);
  search.least_typical(play, limits, keep, best);
}

std::vector<char> readers_of_all(const AppSpec& app, const Problem& p, std::uint64_t seed,
                                 const Until& until, const Candidate& of) {
  std::vector<char> readers(at(p.num_xnodes), 0), none = readers;
  for (const auto& [u, v] : p.samples)
    if (of_two_clocks(p, u, v)) readers[at(v)] = 1;
  if (readers == none) return none;
  TypicalPlay play(app, p, seed);
  if (!play.is_short()) return none;
  const auto latency = [&](const std::vector<char>& reads_all) {
    play.set_reads_all(reads_all);
    return play.latency(of.decision.xpu, of.figures.w);
  };
  std::vector<char> best = readers;
  double least = latency(best);
  for (std::size_t v = 0; v < readers.size() && !until.over(); ++v) {
    if (readers[v] == 0) continue;
    best[v] = 0;
    if (const double takes = latency(best); takes == least || takes <= least * kWorthReadingLess)
      least = takes;
    else
      best[v] = 1;
  }
  return best;
}

}  // namespace xauto::solver::keys
