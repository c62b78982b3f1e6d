// SPDX-License-Identifier: Apache-2.0
// bench_tables: how few policies serve 24 clock scenarios (GPU x 1 to 2, DLA x 1 to 1.5, CPU x 1 to
// 2) of an app how well. Prints the worst regret of one, two and four tables: the largest certified
// worst case over the scenario's proven lower bound. A line of JSON each in --out.
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <string>

#include <fmt/format.h>

#include "cli/cli.h"
#include "model/json.h"
#include "solver/keys/check_tables.h"
#include "solver/tables.h"

#include "bench/synthetic/measure.h"
#include "bench/synthetic/report.h"

namespace xauto::bench {
namespace {

struct Flags {
  std::string app, platform = "small", out;
  int apps = 20, nodes = 20, first_seed = 500;
  double time_limit_s = 60;
  int threads = 2;
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

Status bench(const Flags& flags) {
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  std::ofstream lines(flags.out);
  if (!flags.out.empty() && !lines) return fail(ErrorCode::kIo, "cannot write", flags.out);
  std::vector<double> regrets[3];
  constexpr int kTables[] = {1, 2, 4};
  std::printf("  %-12s %9s %9s %9s   most s\n", "app", "1 table", "2 tables", "4 tables");
  const int apps = flags.app.empty() ? flags.apps : 1;
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
      if (const auto v = solver::keys::examine_tables(app, platform, tables); !v.truthful())
        return fail(ErrorCode::kInternal, v.lies.front(), app.name);
      regrets[t].push_back(tables.worst_regret());
      const double seconds = static_cast<double>(tables.solve_us) / 1e6;
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
    means += fmt::format(" {:>9.3f}", geometric_mean(of));
    most += fmt::format(" {:>9.3f}", *std::max_element(of.begin(), of.end()));
  }
  std::printf("  %-12s%s\n  %-12s%s\n", "geo. mean", means.c_str(), "largest", most.c_str());
  return {};
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::cli::Program app("One, two and four policies for 24 clock scenarios: the worst regret.");
  app.option("--app", flags.app, "this one instead of synthetic ones");
  app.option("--platform", flags.platform).shown();
  app.option("--apps", flags.apps, "synthetic ones").shown();
  app.option("--nodes", flags.nodes, "XNodes of each").shown();
  app.option("--first-seed", flags.first_seed).shown();
  app.duration("--time-limit", flags.time_limit_s, xauto::cli::Unit::kSeconds, 0,
               xauto::cli::kYearS, "per set of tables");
  app.option("--threads", flags.threads).shown();
  app.option("--out", flags.out, "lines of JSON");
  if (const auto exit = app.parse(argc, argv)) return *exit;
  const auto status = xauto::bench::bench(flags);
  if (!status) std::fprintf(stderr, "bench_tables: %s\n", status.error().to_string().c_str());
  return status ? 0 : 1;
}
