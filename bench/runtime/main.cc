// SPDX-License-Identifier: Apache-2.0
// The runtime's benchmarks: a table in microseconds for people, then `R SECTION CASE IMPL METRIC
// VALUE` lines (tab-separated) and a JSON file, then the targets of this run against its own
// anchors. Repeat it, and compare rows of one run only: the machine's other users are in all.
#include <fstream>

#include "cli/cli.h"
#include "model/json_value.h"

#include "bench.h"

namespace xauto::bench {
namespace {

int judge(const Table& table) {
  int missed = 0;
  fmt::print("\n  {:<64}{:>10}{:>10}\n", "target", "measured", "");
  const auto say = [&](const std::string& what, double value, double limit) {
    const bool met = value <= limit;
    missed += met ? 0 : 1;
    fmt::print("  {:<64}{:>10.3f}{:>10}\n", what, value, met ? "met" : "MISSED");
  };
  const auto value = [&](const char* name, const char* program) {
    const Row* row = table.find(name, program);
    return row == nullptr ? -1.0 : row->p50;
  };
  const auto ratio = [&](const std::string& what, const char* name, const char* ours,
                         const char* floor, double limit) {
    const double a = value(name, ours), b = value(name, floor);
    if (a >= 0 && b > 0) say(what, a / b, limit);
  };
  const auto absolute = [&](const std::string& what, const char* name, const char* program,
                            double limit) {
    if (const double a = value(name, program); a >= 0) say(what, a, limit);
  };
  absolute("dispatch per XNode, dag40, one XPU: <= 0.15 us p50", "dag40", "xauto", 0.15);
  ratio("the same by the own-worker floor: <= 2.5", "dag40", "xauto", "own-worker", 2.5);
  ratio("XPU change by a futex hand-over: <= 1.2", "xpu change", "xauto", "futex hand-over", 1.2);
  absolute("start, uncontended: <= 0.2 us", "start uncontended", "xauto", 0.2);
  for (const char* name : {"contended 1 core", "contended 2 cores"}) {
    ratio(std::string("parked START by the futex round trip, ") + (name + 10) + ": <= 1.3", name,
          "xauto, parked", "futex round trip", 1.3);
    ratio(std::string("preempting START by the futex round trip, ") + (name + 10) + ": <= 1.3",
          name, "xauto, preempting", "futex round trip", 1.3);
  }
  ratio("6 MB between processes by own-shm-futex: <= 1.3", "6 MB between processes", "xauto",
        "own-shm-futex", 1.3);
  ratio("6 MB image over DDS by Cyclone's own type: <= 1.05", "6 MB image over DDS", "xauto",
        "cyclone-own-type", 1.05);
  absolute("coordinators at 40 XNodes and 10 Hz: <= 0.35 %", "40 XNodes at 10 Hz",
           "share of a CPU, %", 0.35);
  absolute("coordinators at 40 XNodes and 100 Hz: <= 2 %", "40 XNodes at 100 Hz",
           "share of a CPU, %", 2);
  absolute("coordinators at 40 XNodes in order pairs and 100 Hz: <= 0.5 %",
           "20 order pairs at 100 Hz", "share of a CPU, %", 0.5);
  return missed;
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  using namespace xauto::bench;
  xauto::cli::Program cli("Measures the runtime beside its floors and peers.", "bench_runtime");
  Options options;
  std::string json = "runtime.json";
  cli.option("--rounds", options.rounds, "samples per row").shown();
  cli.duration("--duration", options.seconds, xauto::cli::Unit::kSeconds, 0.001, xauto::cli::kYearS,
               "of the coordinators' load");
  cli.option("--json", json, "write the rows here").shown();
  cli.option("--only", options.only,
             "dispatch, decision, suspend, transfer, image, or coordinator");
  cli.flag("--fifo", options.fifo, "SCHED_FIFO, as a run with the permission for it");
  if (const auto status = cli.parse(argc, argv)) return *status;

  (void)cores();
  Table table;
  fmt::print("  {:<12}{:<26}{:<24}{:>10}{:>10}{:>10}\n", "us", "case", "program", "p50", "p99",
             "p99.9");
  const auto wanted = [&](const char* what) {
    return options.only.empty() || options.only == what;
  };
  if (wanted("decision")) decisions(options, table);
  if (wanted("suspend")) suspensions(options, table);
  if (wanted("transfer")) transfers(options, table);
  if (options.only == "image") images(options, table);  // else with the transfers
  if (wanted("coordinator")) coordinators(options, table);
  if (wanted("dispatch")) dispatch(options, table);

  xauto::Json rows = xauto::Json::array();
  for (const Row& row : table.rows()) {
    rows.push_back({{"section", row.section},
                    {"case", row.name},
                    {"program", row.program},
                    {"p50", row.p50},
                    {"p99", row.p99},
                    {"p99.9", row.p999}});
    for (const auto& [metric, v] :
         {std::pair<const char*, double>{"p50", row.p50}, {"p99", row.p99}, {"p99.9", row.p999}})
      fmt::print("R\t{}\t{}\t{}\t{}\t{:.3f}\n", row.section, row.name, row.program, metric, v);
  }
  std::ofstream(json) << xauto::Json{{"schema", "xauto.bench.runtime"},
                                     {"version", 1},
                                     {"rows", std::move(rows)}}
                             .dump(1)
                      << "\n";
  judge(table);
  return 0;
}
