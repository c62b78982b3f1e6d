// SPDX-License-Identifier: Apache-2.0
// bench_ordinary: what a certificate costs on an ordinary day. Keys against the fixed priorities that `xauto compare`
// makes (--placed-alike: with those on the XPUs of the keys), both played with the same parts of the WCETs, 60 to 100 %
// (--least-pct), jitter and phases at random. Of each chain the p50 and the p99 of keys / those of the priorities.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include <fmt/format.h>

#include "base/index.h"
#include "cli/cli.h"
#include "model/components.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/keys/check.h"
#include "solver/keys/one_release.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"
#include "solver/random.h"

#include "bench/keys/generate.h"
#include "bench/synthetic/report.h"

namespace xauto::bench {
namespace {

namespace keys = solver::keys;

/// Of the fixed priorities: a second or two.
constexpr std::int64_t kEvaluations = 200'000;
/// Of a play at least; of an XNode's times so many are drawn.
constexpr double kLeastS = 5;
constexpr std::size_t kTimes = 997;
/// Above it a chain, or an app, counts as worse.
constexpr double kWorse = 1.02, kMuchWorse = 1.2;

struct Flags {
  std::string app, platform, policy, fixed, json;
  std::vector<std::string> only;
  std::uint64_t first = 101, seed = 1;
  double time_limit_s = 10;
  std::int64_t evaluations = 0;
  int threads = 2, plays = 6, periods = 60, least_pct = 60;
  bool placed_alike = false;
};

struct Ratios {
  double p50 = 0, p99 = 0;
};

/// [chain] of all plays the mean of each quantile; an empty one: its backlog grows.
Result<std::vector<Ratios>> latencies(const AppSpec& app, const Platform& platform,
                                      const Policy& policy, const Flags& flags) {
  std::vector<Ratios> of(app.chains.size());
  const std::vector<std::int64_t> periods = app.periods();
  const auto longest = static_cast<double>(*std::max_element(periods.begin(), periods.end())) / 1e6;
  for (int k = 0; k < flags.plays; ++k) {
    keys::PlayOptions options;
    options.seconds =
        static_cast<std::int64_t>(std::ceil(std::max(kLeastS, flags.periods * longest)));
    options.jitter = options.phases = true;
    options.seed = flags.seed * 1000 + static_cast<std::uint64_t>(k);
    solver::Random random(options.seed);
    const double least = flags.least_pct / 100.0;
    for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
      const auto most = *app.xnodes[i].wcet_on(platform.xpus[at(policy.placements[i].xpu)].type);
      std::vector<std::int64_t>& times = options.times_us.emplace_back();
      for (std::size_t n = 0; n < kTimes; ++n)
        times.push_back(std::max<std::int64_t>(
            1, std::llround((least + (1 - least) * random.unit()) * static_cast<double>(most))));
    }
    XAUTO_ASSIGN(const keys::PlayReport played, keys::play(app, platform, policy, options));
    if (played.backlog) return std::vector<Ratios>{};
    for (std::size_t c = 0; c < of.size(); ++c) {
      of[c].p50 += played.chains[c].median_us;
      of[c].p99 += played.chains[c].p99_us;
    }
  }
  return of;
}

Result<Policy> priorities(const RatedCase& made, const Policy& ours, const Flags& flags) {
  if (!flags.fixed.empty()) return load_policy(flags.fixed, made.app, made.platform);
  solver::SolveOptions options;
  options.max_evaluations = kEvaluations;
  options.time_limit_s = 10;
  options.seed = flags.seed;
  if (flags.placed_alike)
    for (std::size_t i = 0; i < made.app.xnodes.size(); ++i)
      options.objectives.pins.emplace_back(made.app.xnodes[i].name,
                                           made.platform.xpus[at(ours.placements[i].xpu)].id);
  return keys::fixed_priorities(made.app, made.platform, options);
}

struct All {
  std::vector<double> p50, p99;  ///< [app]
  int worse = 0, chains = 0, much_worse = 0;
  double worst = 0;
  Json rows = Json::array();
};

Status measure(const RatedCase& made, const Flags& flags, All& all) {
  std::printf("%-14s", made.name.c_str());
  std::fflush(stdout);
  Policy ours;
  if (flags.policy.empty()) {
    keys::Options options;
    options.time_limit_s = flags.time_limit_s;
    options.threads = flags.threads;
    options.seed = flags.seed;
    options.max_evaluations = flags.evaluations;
    XAUTO_ASSIGN(keys::Answer answer, keys::solve(made.app, made.platform, options));
    if (answer.outcome != keys::Outcome::kPolicy) {
      std::printf(" no policy\n");
      return {};
    }
    ours = std::move(answer.policy);
  } else {
    XAUTO_ASSIGN(ours, load_policy(flags.policy, made.app, made.platform));
  }
  XAUTO_TRY(keys::check(made.app, made.platform, ours));
  const keys::Totals totals = keys::totals_of(made.app, worst_cases(ours));
  XAUTO_ASSIGN(const Policy fixed, priorities(made, ours, flags));
  XAUTO_ASSIGN(const auto mine, latencies(made.app, made.platform, ours, flags));
  XAUTO_ASSIGN(const auto theirs, latencies(made.app, made.platform, fixed, flags));
  std::printf(" largest %.4f sum %.4f", totals.largest, totals.sum);
  if (mine.empty() || theirs.empty()) {
    std::printf(" backlog of %s grows\n", mine.empty() ? "keys" : "priorities");
    return {};
  }
  std::vector<double> p50, p99;
  Json row = {{"case", made.name}, {"largest", totals.largest}, {"sum", totals.sum}};
  std::string chains;
  for (std::size_t c = 0; c < mine.size(); ++c) {
    if (mine[c].p50 <= 0 || theirs[c].p50 <= 0) continue;
    p50.push_back(mine[c].p50 / theirs[c].p50);
    p99.push_back(mine[c].p99 / theirs[c].p99);
    ++all.chains;
    all.much_worse += p50.back() > kMuchWorse ? 1 : 0;
    all.worst = std::max(all.worst, p50.back());
    row["chains"].push_back({{"name", made.app.chains[c].name},
                             {"p50", p50.back()},
                             {"p99", p99.back()},
                             {"p50_us", mine[c].p50 / flags.plays},
                             {"fixed_p50_us", theirs[c].p50 / flags.plays},
                             {"fixed_p99_us", theirs[c].p99 / flags.plays},
                             {"claimed_us", ours.chains[c].worst_case_us},
                             {"lower_bound_us", ours.chains[c].lower_bound_us}});
    if (!flags.app.empty())
      chains += fmt::format("  {} {:.2f} {:.2f} ({:.1f} ms)", made.app.chains[c].name, p50.back(),
                            p99.back(), mine[c].p50 / flags.plays / 1e3);
  }
  if (p50.empty()) {
    const bool ours_do = std::ranges::any_of(mine, [](const Ratios& of) { return of.p50 > 0; });
    std::printf(" by %s no release comes through\n", ours_do ? "priorities" : "keys");
    return {};
  }
  all.p50.push_back(geometric_mean(p50));
  all.p99.push_back(geometric_mean(p99));
  all.worse += all.p50.back() > kWorse ? 1 : 0;
  all.rows.push_back(std::move(row));
  std::printf(" p50 %.3f worst chain %.2f p99 %.3f worst chain %.2f%s\n", all.p50.back(),
              *std::max_element(p50.begin(), p50.end()), all.p99.back(),
              *std::max_element(p99.begin(), p99.end()), chains.c_str());
  std::fflush(stdout);
  return {};
}

Result<std::vector<RatedCase>> cases_of(const Flags& flags) {
  if (flags.app.empty()) {
    std::vector<RatedCase> cases = standard_set(flags.first);
    std::erase_if(cases, [&](const RatedCase& made) {
      return made.kind == Kind::kOverload ||
             (!flags.only.empty() && std::ranges::none_of(flags.only, [&](const std::string& name) {
               return name == made.name || name == to_string(made.kind);
             }));
    });
    return cases;
  }
  if (flags.platform.empty())
    return fail(ErrorCode::kInvalid, "is needed with --app", "--platform", "name one");
  RatedCase one;
  XAUTO_ASSIGN(one.app, load_app(flags.app));
  XAUTO_ASSIGN(one.platform, load_platform(flags.platform));
  one.name = one.app.name;
  return std::vector<RatedCase>{std::move(one)};
}

Result<int> run(const Flags& flags) {
  XAUTO_ASSIGN(const std::vector<RatedCase> cases, cases_of(flags));
  if (cases.empty()) return fail(ErrorCode::kNotFound, "no case has this name or kind", "--only");
  All all;
  for (const RatedCase& made : cases) XAUTO_TRY(measure(made, flags, all));
  if (all.p50.empty()) return 1;
  std::printf(
      "%zu apps: p50 %.3f, worse in %d, p99 %.3f; of %d chains %d above 1.2, the worst %.2f\n",
      all.p50.size(), geometric_mean(all.p50), all.worse, geometric_mean(all.p99), all.chains,
      all.much_worse, all.worst);
  if (!flags.json.empty()) XAUTO_TRY(write_file(flags.json, all.rows.dump(1) + "\n"));
  return 0;
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::cli::Program program("Keys against fixed priorities, on an ordinary day.");
  program.option("--app", flags.app, "app.json, in place of generated apps");
  program.option("--platform", flags.platform, "its platform.json");
  program.option("--policy", flags.policy, "policy.json of keys for it, in place of a solve");
  program.option("--fixed", flags.fixed, "policy.json of priorities for it, in place of our own");
  program.option("--only", flags.only, "cases or kinds: rates,clocks-103").separated_by(',');
  program.option("--first", flags.first, "seed of the first case of each kind").shown();
  program.duration("--time-limit", flags.time_limit_s, xauto::cli::Unit::kSeconds, 0,
                   xauto::cli::kYearS, "of the solver, per case");
  program.option("--evaluations", flags.evaluations, "of the solver, per case; 0: no limit")
      .shown();
  program.option("--threads", flags.threads, "of the solver").range(1, 64).shown();
  program.option("--plays", flags.plays, "of each policy").range(1, 1000).shown();
  program.option("--periods", flags.periods, "a play lasts so many of the longest")
      .positive()
      .shown();
  program.option("--least-pct", flags.least_pct, "of a WCET that jobs take").range(0, 100).shown();
  program.option("--seed", flags.seed, "of the solver and of the plays").shown();
  program.flag("--placed-alike", flags.placed_alike, "the priorities have the XPUs of the keys");
  program.option("--json", flags.json, "write what was measured here");
  if (const auto status = program.parse(argc, argv)) return *status;
  const auto done = xauto::bench::run(flags);
  if (done) return *done;
  std::fprintf(stderr, "error: %s\n", done.error().to_string().c_str());
  return 2;
}
