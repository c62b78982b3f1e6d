// SPDX-License-Identifier: Apache-2.0
// bench_tables: how few policies serve 24 clock scenarios (GPU x 1 to 2, DLA x 1 to 1.5, CPU x 1 to
// 2) of an app how well. Prints the worst regret of one, two and four tables: the largest certified
// worst case over the scenario's proven lower bound. A line of JSON each in --out. With --changes so
// many releases during which the scenario changes are played against what four tables claim, by XAuto's
// rule and by others; exit status 1 if one takes longer by XAuto's.
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <string>

#include <fmt/format.h>

#include "cli/cli.h"
#include "model/json.h"
#include "solver/tables.h"
#include "solver/verify_tables.h"

#include "bench/synthetic/measure.h"
#include "bench/synthetic/report.h"
#include "bench/tables/changes.h"

namespace xauto::bench {
namespace {

struct Flags {
  std::string app, platform = "small", out;
  int apps = 20, nodes = 20, first_seed = 500;
  double time_limit_s = 60;
  int threads = 2;
  std::int64_t changes = 0;
};

Scenarios clocks(const AppSpec& app) {
  Scenarios scenarios{app.name, {}};
  for (const int gpu : {100, 125, 150, 200})
    for (const int dla : {100, 150})
      for (const int cpu : {100, 150, 200})
        scenarios.list.push_back({fmt::format("gpu {} dla {} cpu {}", gpu, dla, cpu),
                                  {{"gpu", gpu}, {"dla", dla}, {"cpu", cpu}}});
  return scenarios;
}

/// A row for each rule; a line of JSON, too.
void tell(const Attack& alone, const Rules& rules, std::ostream& lines) {
  std::printf("  %-58s %9s %9s %8s %7s %7s\n", "a change of scenario", "plays", "longer", "longest",
              "first", "next");
  const auto row = [&](const char* key, const std::string& rule, std::int64_t plays,
                       std::int64_t above, double worst, const Overlap* two) {
    std::string text = fmt::format("  {:<58} {:>9} {:>9} {:>8.4f}", rule, plays, above, worst);
    std::string json =
        fmt::format("{{\"rule\":\"{}\",\"plays\":{},\"longer\":{},\"longest\":{:.5f}", key, plays,
                    above, worst);
    if (two != nullptr) {
      const auto mean_of = [&](double sum) {
        return sum / static_cast<double>(std::max<std::int64_t>(1, two->drawn));
      };
      text += fmt::format(" {:>7.4f} {:>7.4f}", mean_of(two->first_of_claim),
                          mean_of(two->next_of_own));
      json += fmt::format(
          ",\"pairs\":{},\"longer_first\":{},\"longer_others\":{},\"met\":{},\"drawn_met\":{},"
          "\"first_mean\":{:.5f},\"next_mean\":{:.5f}",
          rules.pairs, two->first_above, two->others_above, two->met, two->drawn,
          mean_of(two->first_of_claim), mean_of(two->next_of_own));
    }
    std::printf("%s\n", text.c_str());
    lines << json << "}\n";
  };
  row("alone", "one release, which keeps its table", alone.releases, alone.above, alone.nearest,
      nullptr);
  row("moved", "the same, but jobs move to the new table", alone.releases, alone.moved_above,
      alone.moved_worst, nullptr);
  row("waits", fmt::format("three, of {} changes; the next one waits: XAuto's", rules.pairs),
      rules.waits.plays, rules.waits.above, rules.waits.worst, &rules.waits);
  row("own", "the same, but each table's own priorities", rules.own.plays, rules.own.above,
      rules.own.worst, &rules.own);
  std::printf(
      "  longer: than claimed; longest: over what is claimed (jobs that move: both scenarios' "
      "worst\n"
      "  cases). Where releases meet, on average, first: over its claim; next: over its scenario's "
      "worst\n"
      "  case. They met in %lld and %lld plays. By own priorities the first was longer than "
      "claimed in\n"
      "  %lld, another one in %lld.\n",
      static_cast<long long>(rules.waits.met), static_cast<long long>(rules.own.met),
      static_cast<long long>(rules.own.first_above),
      static_cast<long long>(rules.own.others_above));
}

/// False: a release was longer than claimed.
Result<bool> bench(const Flags& flags) {
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  std::ofstream lines(flags.out);
  if (!flags.out.empty() && !lines) return fail(ErrorCode::kIo, "cannot write", flags.out);
  std::vector<double> regrets[3];
  constexpr int kTables[] = {1, 2, 4};
  std::printf("  %-12s %9s %9s %9s   most s\n", "app", "1 table", "2 tables", "4 tables");
  const int apps = flags.app.empty() ? flags.apps : 1;
  Attack all;
  Rules rules;
  for (int k = 0; k < apps; ++k) {
    AppSpec app;
    if (flags.app.empty()) {
      XAUTO_ASSIGN(app, workload(flags.nodes, static_cast<std::uint64_t>(flags.first_seed + k), {},
                                 platform));
    } else {
      XAUTO_ASSIGN(app, load_app(flags.app));
    }
    double longest = 0;
    std::string row;
    for (std::size_t t = 0; t < std::size(kTables); ++t) {
      solver::TablesOptions options;
      options.tables = kTables[t];
      options.time_limit_s = flags.time_limit_s;
      options.threads = flags.threads;
      XAUTO_ASSIGN(const Tables tables, solver::solve_tables(app, platform, clocks(app), options));
      if (const auto v = solver::verify_tables(
              app, platform, tables, {.executions = 200, .proof_nodes = 1000, .schedules = 1000});
          !v.truthful())
        return fail(ErrorCode::kInternal, v.lies.front(), app.name);
      if (kTables[t] == 4 && flags.changes > 0) {
        const Attack one = attack_changes(app, platform, tables, flags.changes / apps,
                                          static_cast<std::uint64_t>(k) + 1);
        all.releases += one.releases;
        all.above += one.above;
        all.moved_above += one.moved_above;
        all.nearest = std::max(all.nearest, one.nearest);
        all.moved_worst = std::max(all.moved_worst, one.moved_worst);
        const Rules two = attack_rules(app, platform, tables, flags.changes / apps,
                                       static_cast<std::uint64_t>(k) + 1);
        rules.pairs += two.pairs;
        rules.waits.add(two.waits);
        rules.own.add(two.own);
      }
      regrets[t].push_back(tables.worst_regret());
      const double seconds = static_cast<double>(tables.solve_ms) / 1000;
      longest = std::max(longest, seconds);
      row += fmt::format(" {:>9.3f}", tables.worst_regret());
      lines << fmt::format(
                   "{{\"app\":\"{}\",\"seed\":{},\"tables\":{},\"worst_regret\":{:.5f},"
                   "\"solve_s\":{:.2f}}}\n",
                   app.name, flags.first_seed + k, kTables[t], tables.worst_regret(), seconds)
            << std::flush;
    }
    std::printf(
        "  %-12s%s   %6.1f\n",
        flags.app.empty() ? fmt::format("DAG {}", flags.first_seed + k).c_str() : app.name.c_str(),
        row.c_str(), longest);
    std::fflush(stdout);
  }
  std::string means, most;
  for (const auto& of : regrets) {
    means += fmt::format(" {:>9.3f}", mean(of));
    most += fmt::format(" {:>9.3f}", *std::max_element(of.begin(), of.end()));
  }
  std::printf("  %-12s%s\n  %-12s%s\n", "mean", means.c_str(), "largest", most.c_str());
  if (flags.changes > 0) tell(all, rules, lines);
  return all.above == 0 && rules.waits.above == 0;
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::cli::Program app("One, two and four policies for 24 clock scenarios: the worst regret.");
  app.option("--app", flags.app, "this one, without rates, instead of synthetic ones");
  app.option("--platform", flags.platform).shown();
  app.option("--apps", flags.apps, "synthetic ones").shown();
  app.option("--nodes", flags.nodes, "XNodes of each").shown();
  app.option("--first-seed", flags.first_seed).shown();
  app.option("--time-limit-s", flags.time_limit_s, "per set of tables").shown();
  app.option("--threads", flags.threads).shown();
  app.option("--changes", flags.changes, "releases that span a change, in all");
  app.option("--out", flags.out, "lines of JSON");
  if (const auto exit = app.parse(argc, argv)) return *exit;
  const auto status = xauto::bench::bench(flags);
  if (!status) std::fprintf(stderr, "bench_tables: %s\n", status.error().to_string().c_str());
  return status && *status ? 0 : 1;
}
