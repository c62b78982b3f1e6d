// SPDX-License-Identifier: Apache-2.0
// attack_keys: random apps with policies of keys that the check just accepts, each attacked; the
// same policies played. Then the solver's own policies; and those of a solver that is not told of
// the jitter, say. Exit status 1 if a policy is broken, or what was not told is never found.
#include <algorithm>
#include <cstdio>

#include <fmt/format.h>

#include "cli/cli.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"

#include "attack/attack.h"
#include "attack/pairs.h"
#include "attack/producer.h"

namespace xauto::attack {
namespace {

struct Flags {
  int policies = 40;
  int solved = 10;
  int pairs = 0;
  std::int64_t jobs = 200'000;
  std::uint64_t seed = 1;
};

struct NamedKind {
  const char* name;
  Wanted wanted;
};

const NamedKind kKinds[] = {
    {"one clock", {.load = 0.6}},
    {"one clock, loaded, preemption 8", {.load = 0.9, .preempt_us = 8}},
    {"one clock, jitter, preemption 5", {.load = 0.6, .preempt_us = 5, .jitter_us = 40}},
    {"one clock, drift, jitter", {.ppm = 1000, .load = 0.6, .jitter_us = 30}},
    {"one clock, holds, much jitter",
     {.load = 0.8, .preempt_us = 20, .jitter_us = 200, .holds = true}},
    {"thirds of microseconds", {.load = 0.6, .preempt_us = 5, .thirds = true}},
    {"no preemption", {.load = 0.6, .preemptive = false}},
    {"no preemption, loaded", {.components = 2, .load = 0.8, .preemptive = false}},
    {"two clocks", {.clocks = 2, .load = 0.6}},
    {"two clocks, 100 ppm", {.clocks = 2, .ppm = 100, .load = 0.6}},
    {"two clocks, holds", {.clocks = 2, .load = 0.6, .preempt_us = 3, .holds = true}},
    {"two clocks, preemption 10", {.clocks = 2, .components = 2, .load = 0.85, .preempt_us = 10}},
    {"two clocks, no preemption, 1000 ppm",
     {.clocks = 2, .ppm = 1000, .load = 0.6, .preemptive = false}},
    {"three clocks, 10000 ppm",
     {.clocks = 3, .ppm = 10'000, .components = 5, .load = 0.8, .preempt_us = 4, .jitter_us = 100}},
    {"two levels, loaded, preemption 5",
     {.components = 5, .load = 0.85, .preempt_us = 5, .levels = 2, .jitter_us = 40}},
    {"three levels, two clocks, 1000 ppm",
     {.clocks = 2, .ppm = 1000, .components = 5, .load = 0.8, .levels = 3, .holds = true}},
    {"contention, preemption 20", {.load = 0.4, .preempt_us = 20, .holds = true, .beside = true}},
    {"contention, two clocks, no preemption",
     {.clocks = 2, .ppm = 1000, .load = 0.4, .preemptive = false, .holds = true, .beside = true}},
};

/// What the solver is not told.
struct Fault {
  const char* name;
  void (*hide)(AppSpec&, Platform&);
};

const Fault kFaults[] = {
    {"(nothing is left out)", [](AppSpec&, Platform&) {}},
    {"the jitter",
     [](AppSpec& app, Platform&) {
       for (SourceSpec& s : app.sources) s.jitter_us = 0;
     }},
    {"what preemption costs",
     [](AppSpec&, Platform& platform) {
       for (Xpu& xpu : platform.xpus) xpu.preempt_us = 0;
     }},
    {"that an XPU does not preempt",
     [](AppSpec&, Platform& platform) {
       for (Xpu& xpu : platform.xpus) xpu.preemptive = true;
     }},
    {"how many levels an XPU has",
     [](AppSpec&, Platform& platform) {
       for (Xpu& xpu : platform.xpus) xpu.levels = 0;
     }},
    {"that an XPU has no level more",
     [](AppSpec&, Platform& platform) {
       for (Xpu& xpu : platform.xpus) xpu.levels += xpu.levels > 0 ? 1 : 0;
     }},
    {"what XNodes take beside loads",
     [](AppSpec& app, Platform&) {
       for (XNodeSpec& x : app.xnodes) x.beside.clear();
     }},
    {"what they take beside two at once",
     [](AppSpec& app, Platform&) {
       for (XNodeSpec& x : app.xnodes) {
         std::int64_t one = 0;  // the longest of a single load
         for (const BesideSpec& beside : x.beside)
           if (beside.load.size() == 1) one = std::max(one, beside.wcet_us);
         for (BesideSpec& beside : x.beside)
           if (beside.load.size() > 1) beside.wcet_us = one;
       }
     }},
    {"how many are in flight",
     [](AppSpec& app, Platform&) {
       for (ModuleSpec& m : app.modules) m.max_in_flight = 9;
     }},
};

/// Until clocks that drift have come round, at half of their ppm in half of the play: at most a minute.
std::int64_t seconds_to_play(const AppSpec& app) {
  std::int64_t longest = 0, ppm = 0;
  for (const SourceSpec& s : app.sources) longest = std::max(longest, s.period.floor_us());
  for (const ClockSpec& c : app.clocks) ppm = std::max(ppm, c.ppm);
  return app.clocks.size() < 2 || ppm == 0 ? 1 : std::min<std::int64_t>(60, 1 + 4 * longest / ppm);
}

/// The policy played, with all that may vary: what is wrong with it in `bad`, the most that a chain takes of
/// its worst case.
Result<double> played(const Case& c, std::uint64_t seed, std::int64_t& jobs, std::string& bad) {
  XAUTO_ASSIGN(const auto report,
               solver::keys::play(c.app, c.platform, c.policy,
                                  {seconds_to_play(c.app), seed % 2 == 1, true, true, seed}));
  jobs += report.jobs;
  bad = report.first_late;
  double fullest = 0;
  for (const auto& chain : report.chains) {
    fullest = std::max(fullest, chain.longest_us / static_cast<double>(*chain.claimed_us));
    if (chain.exceeded()) bad += " chain " + chain.name;
  }
  return fullest;
}

/// Policies of the solver itself, with a budget that makes them the same on every machine.
Result<bool> run_solved(const Flags& flags) {
  bool as_it_should = true;
  for (const Fault& fault : kFaults) {
    std::int64_t policies = 0, broken = 0, jobs = 0;
    for (const NamedKind& kind : kKinds)
      for (int k = 0; k < flags.solved; ++k) {
        const std::uint64_t seed = flags.seed + static_cast<std::uint64_t>(k);
        std::optional<Case> c = valid(seed, kind.wanted);
        if (!c) continue;
        tighten(*c, seed, false);  // few activations in flight, so that they matter
        AppSpec app_told = c->app;
        Platform platform_told = c->platform;
        fault.hide(app_told, platform_told);
        const bool hidden = !(app_told == c->app && platform_told == c->platform);
        if (&fault != kFaults && !hidden) continue;
        solver::keys::Options options;
        options.max_evaluations = 500;
        options.time_limit_s = 60;
        options.seed = seed;
        XAUTO_ASSIGN(const auto answer, solver::keys::solve(app_told, platform_told, options));
        if (answer.outcome != solver::keys::Outcome::kPolicy) continue;
        const Found found = attack(c->app, c->platform, answer.policy, {flags.jobs, seed});
        ++policies;
        jobs += found.jobs;
        std::string bad;
        if (&fault == kFaults) {
          c->policy = answer.policy;
          XAUTO_TRY(played(*c, seed, jobs, bad));
        }
        if (!found.broken() && bad.empty()) continue;
        ++broken;
        if (&fault == kFaults)
          fmt::print("BROKEN: {}, seed {}: {} {} {}\n", kind.name, seed, found.late, found.chain,
                     bad);
      }
    fmt::print("the solver is told all but {:<30} {:>4} policies {:>11} jobs, {:>4} broken\n",
               fault.name, policies, jobs, broken);
    as_it_should = as_it_should && (&fault == kFaults) == (broken == 0);
  }
  return as_it_should;
}

/// Two apps together, in place of all else. Exit status 1: what is accepted is late.
int run_pairs(const Flags& flags) {
  Tally t;
  for (int k = 0; k < flags.pairs; ++k)
    play_pairs(flags.seed + static_cast<std::uint64_t>(k), flags.jobs, t);
  fmt::print(
      "{} pairs, {} jobs\n  accepted {}: {} late\n  refused {}: {} exhibited late; {} of {} where "
      "nobody waits for "
      "another one\n  refused, but not with preemptions charged per app: {}, of these {} exhibited "
      "late\n",
      t.pairs, t.jobs, t.accepted, t.broken, t.refused, t.exhibited, t.alone_late, t.alone,
      t.per_app, t.per_app_late);
  if (!t.first.empty()) fmt::print("BROKEN: {}\n", t.first);
  return t.broken == 0 ? 0 : 1;
}

Result<int> run(const Flags& flags) {
  if (flags.pairs > 0) return run_pairs(flags);
  std::int64_t jobs = 0, policies = 0, broken = 0;
  for (const NamedKind& kind : kKinds) {
    std::int64_t made = 0, at_key = 0, met = 0, own = 0;
    double fullest = 0;
    for (int k = 0; k < flags.policies; ++k) {
      const std::uint64_t seed = flags.seed + static_cast<std::uint64_t>(k);
      std::optional<Case> c = valid(seed, kind.wanted);
      if (!c) continue;
      tighten(*c, seed, seed % 2 == 1);
      const Found found = attack(c->app, c->platform, c->policy, {flags.jobs, seed});
      ++made;
      own += found.jobs;
      at_key += found.closest_us > -0.001 ? 1 : 0;
      std::string bad;
      XAUTO_ASSIGN(const double seen, played(*c, seed, own, bad));
      met += std::max(seen, found.fullest) > 0.999 ? 1 : 0;
      fullest += std::max(seen, found.fullest);
      if (found.broken() || !bad.empty()) {
        ++broken;
        fmt::print("BROKEN: {}, seed {}: {} {} {}\n", kind.name, seed, found.late, found.chain,
                   bad);
      }
    }
    fmt::print(
        "{:<38} {:>4} policies {:>11} jobs; a job ends at its key in {:>3}, a chain takes its "
        "worst case "
        "in {:>3}; fullest {:.3f} of it on average\n",
        kind.name, made, own, at_key, met,
        fullest / static_cast<double>(std::max<std::int64_t>(made, 1)));
    jobs += own;
    policies += made;
  }
  fmt::print("\n{} jobs, {} policies, {} broken\n", jobs, policies, broken);
  if (flags.solved == 0) return broken > 0 ? 1 : 0;
  XAUTO_ASSIGN(const bool as_it_should, run_solved(flags));
  return broken == 0 && as_it_should ? 0 : 1;
}

}  // namespace
}  // namespace xauto::attack

int main(int argc, char** argv) {
  xauto::attack::Flags flags;
  xauto::cli::Program program("Tries to break policies of keys that the check just accepts.");
  program.option("--policies", flags.policies, "of each kind").shown();
  program.option("--solved", flags.solved, "of each kind by the solver; 0: none").shown();
  program.option("--pairs", flags.pairs, "of apps on one machine, in place of all these");
  program.option("--jobs", flags.jobs, "to simulate per policy").shown();
  program.option("--seed", flags.seed, "of the first policy").shown();
  if (const auto exit = program.parse(argc, argv)) return *exit;
  const auto status = xauto::attack::run(flags);
  if (status) return *status;
  std::fprintf(stderr, "attack_keys: %s\n", status.error().to_string().c_str());
  return 2;
}
