// SPDX-License-Identifier: Apache-2.0
// bench_synthetic: the paper's sections 6.1 and 6.2 on the synthetic workload, its scaling, and
// other solvers.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>

#include "cli/cli.h"
#include "model/json.h"
#include "solver/generate.h"

#include "bench/synthetic/measure.h"
#include "bench/synthetic/report.h"
#include "bench/synthetic/yardsticks.h"

namespace xauto::bench {
namespace {

struct Flags {
  Settings settings;
  std::vector<int> groups = {10, 15, 20, 25, 30, 35, 40};
  int dags = 50;
  std::vector<std::string> platforms = {"small", "large"};
  std::vector<int> scaling;
  double scaling_limit_s = 10;
  std::vector<int> yardsticks;
  double yardstick_limit_s = 30;
  int scaling_apps = 1;
  bool summarise = false;
  std::string out = "synthetic";
};

std::string options_text(const Flags& flags) {
  solver::GenerateOptions o;
  o.max_depth = flags.settings.max_depth;
  o.fork_join = flags.settings.fork_join;
  std::string text;
  for (const auto& [name, value] : o.describe())
    if (name != "nodes" && name != "seed")
      text += fmt::format("{}{} {}", text.empty() ? "" : ", ", name, value);
  return text;
}

/// What an earlier run of the same folder has measured.
std::vector<Measured> read_lines(const std::string& path) {
  std::vector<Measured> known;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);)
    if (auto m = read_line(line)) known.push_back(*std::move(m));
  return known;
}

/// One DAG of every group on every platform, then the next: a run cut short has measured all groups
/// alike, and the next one goes on from its lines.
Result<std::string> workload_part(const Flags& flags, std::vector<Measured>& all) {
  const std::string path = flags.out + "/workload.jsonl";
  all = read_lines(path);
  std::ofstream lines(path, std::ios::app);
  if (!lines) return fail(ErrorCode::kIo, "cannot write here", path);
  for (int dag = 1; dag <= flags.dags && !flags.summarise; ++dag)
    for (const int nodes : flags.groups)
      for (const std::string& name : flags.platforms) {
        const auto seed = static_cast<std::uint64_t>(dag);
        if (std::any_of(all.begin(), all.end(), [&](const Measured& m) {
              return m.nodes == nodes && m.seed == seed && m.platform == name;
            }))
          continue;
        XAUTO_ASSIGN(const Platform platform, load_platform(name));
        XAUTO_ASSIGN(const AppSpec app, workload(nodes, seed, flags.settings, platform));
        XAUTO_ASSIGN(Measured m, measure(app, platform, flags.settings));
        m.seed = seed;
        lines << json_line(m) << std::flush;
        all.push_back(m);
        std::fprintf(stderr, "\rDAG %d of %d: N=%d %s    ", dag, flags.dags, nodes, name.c_str());
      }
  std::fprintf(stderr, "\n");
  if (all.empty()) return fail(ErrorCode::kNotFound, "no measured lines", path);
  for (const std::string& name : flags.platforms) {
    XAUTO_TRY(write_file(flags.out + "/speedup-" + name + ".svg", speedup_svg(all, name)));
    XAUTO_TRY(write_file(flags.out + "/ablation-" + name + ".svg", ablation_svg(all, name)));
  }
  return table(all) + calibration(all) + speed(all);
}

Result<std::string> scaling_part(const Flags& flags) {
  std::string text = fmt::format(
      "scaling, {} s: gap to the proven bound\n  {:>6} {:>8} {:>4} {:>12} {:>12} {:>8} {:>12} "
      "{:>12} "
      "{:>10}\n",
      flags.scaling_limit_s, "N", "platform", "app", "XAuto ms", "bound ms", "gap %", "HEFT/XAuto",
      "certif./XAuto", "seconds");
  Settings settings = flags.settings;
  settings.time_limit_s = flags.scaling_limit_s;
  std::string lines;
  for (const int nodes : flags.scaling)
    for (const std::string& name : flags.platforms)
      for (int k = 1; k <= flags.scaling_apps; ++k) {
        XAUTO_ASSIGN(const Platform platform, load_platform(name));
        XAUTO_ASSIGN(const AppSpec app,
                     workload(nodes, static_cast<std::uint64_t>(k), settings, platform));
        XAUTO_ASSIGN(Measured m, measure(app, platform, settings));
        m.seed = static_cast<std::uint64_t>(k);
        lines += json_line(m);
        XAUTO_TRY(write_file(flags.out + "/scaling.jsonl", lines));
        text += fmt::format(
            "  {:>6} {:>8} {:>4} {:>12.2f} {:>12.2f} {:>8.2f} {:>12.3f} {:>12.3f} {:>10.2f}\n",
            nodes, name, k, static_cast<double>(m.xauto) / 1000,
            static_cast<double>(m.bound) / 1000, 100 * m.gap(),
            static_cast<double>(m.heft) / static_cast<double>(m.xauto),
            static_cast<double>(m.certified) / static_cast<double>(m.xauto), m.solve_s);
      }
  XAUTO_TRY(write_file(flags.out + "/scaling.jsonl", lines));
  return text + "\n";
}

Result<std::string> yardstick_part(const Flags& flags) {
  std::string text =
      fmt::format("side by side, small, at most {} s each\n", flags.yardstick_limit_s);
  for (const int nodes : flags.yardsticks) {
    XAUTO_ASSIGN(const Platform platform, load_platform("small"));
    // The first DAG on which HEFT is not the best: otherwise there is nothing to find.
    AppSpec app;
    std::uint64_t dag = 0;
    for (bool easy = true; easy && dag < 50;) {
      XAUTO_ASSIGN(app, workload(nodes, ++dag, flags.settings, platform));
      Settings quick = flags.settings;
      quick.time_limit_s = 0.2;
      XAUTO_ASSIGN(const Measured m, measure(app, platform, quick));
      easy = m.xauto == m.heft;
    }
    XAUTO_ASSIGN(const auto rows,
                 run_yardsticks(app, platform, flags.yardstick_limit_s, flags.out));
    text += fmt::format("  DAG {} of N={}\n", dag, nodes);
    for (const Yardstick& y : rows)
      text += fmt::format("  N={:<4} {:<32} {:>12} {:>9.3f} s  {}\n", nodes, y.name,
                          y.makespan_us > 0
                              ? fmt::format("{:.3f} ms", static_cast<double>(y.makespan_us) / 1000)
                              : "-",
                          y.seconds, y.status);
  }
  return text;
}

Status bench(const Flags& flags) {
  std::error_code error;
  std::filesystem::create_directories(flags.out, error);
  if (error) return fail(ErrorCode::kIo, "cannot make the folder: " + error.message(), flags.out);
  std::string text = fmt::format(
      "{} DAGs a group, {} s and {} thread(s) each; without assignment: a quarter of "
      "that\nworkload: {}\n\n",
      flags.dags, flags.settings.time_limit_s, flags.settings.threads, options_text(flags));
  std::vector<Measured> all;
  if (flags.dags > 0) {
    XAUTO_ASSIGN(const std::string part, workload_part(flags, all));
    text += part;
  }
  if (!flags.scaling.empty()) {
    XAUTO_ASSIGN(const std::string part, scaling_part(flags));
    text += part;
  }
  if (!flags.yardsticks.empty()) {
    XAUTO_ASSIGN(const std::string part, yardstick_part(flags));
    text += part;
  }
  XAUTO_TRY(write_file(flags.out + "/table.txt", text));
  std::fputs(text.c_str(), stdout);
  return {};
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::cli::Program app(
      "The paper's synthetic workload: speed-ups, ablations, gaps, solving time.");
  app.option("--dags", flags.dags, "DAGs a group; 0: none").shown();
  app.option("--groups", flags.groups, "XNodes per group").separated_by(',').shown();
  app.option("--platforms", flags.platforms).separated_by(',').shown();
  app.duration("--time-limit", flags.settings.time_limit_s, xauto::cli::Unit::kSeconds, 0,
               xauto::cli::kYearS, "per DAG and platform");
  app.option("--threads", flags.settings.threads).shown();
  app.option("--max-depth", flags.settings.max_depth, "of the workload's DAGs").shown();
  app.option("--scaling", flags.scaling, "sizes, e.g. 100,300,1000").separated_by(',');
  app.duration("--scaling-limit", flags.scaling_limit_s, xauto::cli::Unit::kSeconds, 0,
               xauto::cli::kYearS, "per app of --scaling");
  app.option("--scaling-apps", flags.scaling_apps, "apps a size").shown();
  app.flag("!--no-fork-join", flags.settings.fork_join,
           "the workload's forks and joins are no XNodes");
  app.flag("--summarise", flags.summarise, "tables and plots of what --out has; solve nothing");
  app.option("--yardsticks", flags.yardsticks, "sizes for other solvers, e.g. 8,10,12")
      .separated_by(',');
  app.duration("--yardstick-limit", flags.yardstick_limit_s, xauto::cli::Unit::kSeconds, 0,
               xauto::cli::kYearS, "per DAG and yardstick");
  app.option("--out", flags.out,
             "folder for table.txt, *.jsonl, *.svg; goes on from its workload.jsonl")
      .shown();
  if (const auto exit = app.parse(argc, argv)) return *exit;
  const auto status = xauto::bench::bench(flags);
  if (!status) std::fprintf(stderr, "bench_synthetic: %s\n", status.error().to_string().c_str());
  return status ? 0 : 1;
}
