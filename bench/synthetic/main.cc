// SPDX-License-Identifier: Apache-2.0
// bench_synthetic: the paper's sections 6.1 and 6.2 on the synthetic workload, solved and simulated. A line per DAG;
// scripts/paper.py makes figures of them.
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

namespace xauto::bench {
namespace {

struct Flags {
  Settings settings;
  std::vector<int> groups = {10, 15, 20, 25, 30, 35, 40};
  int dags = 50;
  std::vector<std::string> platforms = {"small", "large"};
  std::string out = "synthetic";
};

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
Status bench(const Flags& flags) {
  std::error_code error;
  std::filesystem::create_directories(flags.out, error);
  if (error) return fail(ErrorCode::kIo, "cannot make the folder: " + error.message(), flags.out);
  const std::string path = flags.out + "/workload.jsonl";
  const std::vector<Measured> known = read_lines(path);
  std::ofstream lines(path, std::ios::app);
  for (int dag = 1; dag <= flags.dags; ++dag)
    for (const int nodes : flags.groups)
      for (const std::string& name : flags.platforms) {
        const auto seed = static_cast<std::uint64_t>(dag);
        XAUTO_ASSIGN(const Platform platform, load_platform(name));
        if (std::any_of(known.begin(), known.end(), [&](const Measured& m) {
              return m.nodes == nodes && m.seed == seed && m.platform == platform.name;
            }))
          continue;
        XAUTO_ASSIGN(const AppSpec app, workload(nodes, seed, flags.settings, platform));
        XAUTO_ASSIGN(Measured m, measure(app, platform, flags.settings));
        m.seed = seed;
        if (!(lines << json_line(m) << std::flush))
          return fail(ErrorCode::kIo, "cannot write here", path);
        std::fprintf(stderr, "\rDAG %d of %d: N=%d %s    ", dag, flags.dags, nodes, name.c_str());
      }
  std::fprintf(stderr, "\n");
  std::printf("%s\n", path.c_str());
  return {};
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::cli::Program app(
      "The paper's synthetic workload: a line of measurements per DAG and platform.");
  app.option("--dags", flags.dags, "DAGs a group; 0: none").shown();
  app.option("--groups", flags.groups, "XNodes per group").separated_by(',').shown();
  app.option("--platforms", flags.platforms, "small, large, core-ultra or a platform.json")
      .separated_by(',')
      .shown();
  app.duration("--time-limit", flags.settings.time_limit_s, xauto::cli::Unit::kSeconds, 0,
               xauto::cli::kYearS, "per DAG and platform");
  app.option("--threads", flags.settings.threads).shown();
  app.option("--max-depth", flags.settings.max_depth, "of the workload's DAGs").shown();
  app.flag("!--no-fork-join", flags.settings.fork_join,
           "the workload's forks and joins are no XNodes");
  app.option("--out", flags.out, "folder for workload.jsonl; goes on from what it holds").shown();
  if (const auto exit = app.parse(argc, argv)) return *exit;
  const auto status = xauto::bench::bench(flags);
  if (!status) std::fprintf(stderr, "bench_synthetic: %s\n", status.error().to_string().c_str());
  return status ? 0 : 1;
}
