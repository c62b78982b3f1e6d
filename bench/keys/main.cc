// SPDX-License-Identifier: Apache-2.0
// bench_keys: the cases of generate.h, or the large ones (--scale), through the solver, and beside
// it a plain annealer, fixed priorities, rate-monotonic, first-come, and everybody on its fastest
// type. A table; with --json FILE everything that was measured.
#include <algorithm>
#include <cstdio>

#include <fmt/format.h>

#include "cli/cli.h"
#include "model/components.h"
#include "model/json.h"
#include "model/json_value.h"

#include "bench/keys/measure.h"

namespace xauto::bench {
namespace {

struct Flags {
  Asked asked;
  std::vector<std::string> only;
  std::string json, folder;
  std::uint64_t first = 1;
  bool scale = false, list = false;
};

struct Row {
  const RatedCase* made = nullptr;
  Measured measured;
};

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return values.empty() ? 0 : sum / static_cast<double>(values.size());
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 == 1 ? values[half] : (values[half - 1] + values[half]) / 2;
}

Json to_json(const Row& row) {
  const Measured& m = row.measured;
  Json j = {{"case", row.made->name},
            {"kind", to_string(row.made->kind)},
            {"xnodes", row.made->app.xnodes.size()},
            {"jobs", m.jobs},
            {"load_pct", static_cast<double>(load_ppm(row.made->app, row.made->platform)) / 1e4},
            {"outcome", m.outcome},
            {"first_ms", m.first_ms},
            {"solve_s", m.solve_s},
            {"cpu_s", m.cpu_s},
            {"memory_mib", m.memory_mib},
            {"evaluations", m.evaluations}};
  if (m.outcome == "policy") {
    j["objective"] = m.objective;
    j["largest"] = {{"value", m.totals.largest}, {"lower_bound", m.bounds.largest}};
    j["sum"] = {{"value", m.totals.sum}, {"lower_bound", m.bounds.sum}};
    j["bound"] = m.bound;
    j["misses_deadline"] = m.misses;
    j["check_ms"] = m.check_ms;
    j["own_observed"] = m.ours_ratio;
    j["own_late"] = m.late;
  }
  if (m.annealer_evaluations > 0)
    j["annealer"] = {{"objective", m.annealed},
                     {"first_ms", m.annealer_first_ms},
                     {"evaluations", m.annealer_evaluations}};
  for (const Beside& beside : m.beside)
    j["beside"].push_back({{"rule", beside.name},
                           {"load", beside.load},
                           {"backlog", beside.backlog},
                           {"observed", beside.ratio},
                           {"breaks_worst_case", beside.breaks},
                           {"misses_deadline", beside.misses}});
  return j;
}

std::string in_table(const Row& row) {
  const Measured& m = row.measured;
  std::string line =
      fmt::format("{:<14}{:>7}{:>8}{:>7.1f}  {:<9}{:>9.0f}{:>7.0f}", row.made->name,
                  row.made->app.xnodes.size(), m.jobs > 0 ? std::to_string(m.jobs) : "no H",
                  static_cast<double>(load_ppm(row.made->app, row.made->platform)) / 1e4, m.outcome,
                  m.first_ms, m.memory_mib);
  if (m.outcome == "policy") {
    line += fmt::format("{:>9.1f}{:>9.3f}", m.check_ms, m.objective / m.bound);
    line +=
        m.annealed ? fmt::format("{:>10.3f}", *m.annealed / m.bound) : fmt::format("{:>10}", "-");
    for (const Beside& b : m.beside)
      line += b.backlog ? fmt::format("{:>9}", "grows") : fmt::format("{:>9.2f}", b.ratio);
  } else if (m.annealed) {
    line += fmt::format("{:>28}", "found");
  }
  return line;
}

/// Ours over the bound, the annealer's over the bound, where both have a policy.
void sum_up(const std::vector<Row>& rows, const Asked& asked) {
  std::vector<double> ratio, theirs, both, first, memory, check;
  int policies = 0, overloads = 0, unknown = 0, worse = 0, only_theirs = 0, only_ours = 0;
  for (const Row& row : rows) {
    const Measured& m = row.measured;
    memory.push_back(m.memory_mib);
    overloads += m.outcome == "overload" ? 1 : 0;
    unknown += m.outcome == "unknown" ? 1 : 0;
    if (m.outcome != "policy") {
      only_theirs += m.annealed ? 1 : 0;
      continue;
    }
    ++policies;
    ratio.push_back(m.objective / m.bound);
    first.push_back(m.first_ms);
    check.push_back(m.check_ms);
    if (m.annealer_evaluations == 0) continue;
    if (!m.annealed) {
      ++only_ours;
      continue;
    }
    both.push_back(m.objective / m.bound);
    theirs.push_back(*m.annealed / m.bound);
    worse += m.objective > *m.annealed * 1.000001 ? 1 : 0;
  }
  const auto greatest = [](const std::vector<double>& values) {
    return values.empty() ? 0 : *std::max_element(values.begin(), values.end());
  };
  std::printf(
      "\n%zu cases, one run each, %.1f s and %d threads each: %d policies, %d proven overloads, "
      "%d unknown\n",
      rows.size(), asked.time_limit_s, asked.threads, policies, overloads, unknown);
  std::printf("objective / lower bound: mean %.3f, median %.3f, greatest %.3f\n", mean(ratio),
              median(ratio), greatest(ratio));
  std::printf(
      "first policy: median %.0f ms, greatest %.0f ms; check: median %.1f ms, greatest %.0f "
      "ms; memory: greatest %.0f MiB\n",
      median(first), greatest(first), median(check), greatest(check), greatest(memory));
  if (!theirs.empty() || only_ours + only_theirs > 0)
    std::printf(
        "plain annealer, %zu cases where both have a policy: mean %.3f, median %.3f (the "
        "solver's there: %.3f, %.3f); the solver is worse in %d; %d solved by the solver "
        "alone, %d by the annealer alone\n",
        theirs.size(), mean(theirs), median(theirs), mean(both), median(both), worse, only_ours,
        only_theirs);
  std::vector<std::string> names;
  for (const Row& row : rows)
    if (names.empty())
      for (const Beside& beside : row.measured.beside) names.push_back(beside.name);
  if (names.empty()) return;
  std::printf("\n%-10s%7s%12s%10s%12s%16s%20s\n", "rule", "cases", "overloaded", "backlog",
              "breaks", "misses", "observed /");
  std::printf("%-10s%7s%12s%10s%12s%16s%20s\n", "", "", "(load > 1)", "grows", "worst case",
              "a deadline of", "worst case");
  for (std::size_t k = 0; k < names.size(); ++k) {
    int cases = 0, over = 0, grows = 0, breaks = 0, missed = 0, with_deadline = 0;
    std::vector<double> observed;
    for (const Row& row : rows) {
      if (row.measured.beside.size() <= k) continue;
      const Beside& beside = row.measured.beside[k];
      ++cases;
      over += beside.load > 1 ? 1 : 0;
      grows += beside.backlog ? 1 : 0;
      breaks += beside.breaks ? 1 : 0;
      const bool deadlines =
          std::any_of(row.made->app.chains.begin(), row.made->app.chains.end(),
                      [](const ChainSpec& c) { return c.deadline_us.has_value(); });
      with_deadline += deadlines ? 1 : 0;
      missed += deadlines && beside.misses ? 1 : 0;
      if (!beside.backlog) observed.push_back(beside.ratio);
    }
    std::printf("%-10s%7d%12d%10d%12d%16s%20s\n", names[k].c_str(), cases, over, grows, breaks,
                fmt::format("{} of {}", missed, with_deadline).c_str(),
                fmt::format("{:.2f} (to {:.2f})", median(observed), greatest(observed)).c_str());
  }
  std::vector<double> own;
  std::int64_t late = 0;
  for (const Row& row : rows)
    if (!row.measured.beside.empty())
      own.push_back(row.measured.ours_ratio), late += row.measured.late;
  std::printf(
      "the solver's keys: %lld jobs late, observed / worst case median %.3f, greatest %.3f\n",
      static_cast<long long>(late), median(own), greatest(own));
}

bool wanted(const RatedCase& made, const std::vector<std::string>& only) {
  return only.empty() || std::any_of(only.begin(), only.end(), [&](const std::string& name) {
           return made.name == name || name == to_string(made.kind);
         });
}

void list(const std::vector<RatedCase>& cases) {
  std::printf("%-14s %6s %6s %10s %6s %8s %7s %10s  %s\n", "case", "load %", "XNodes", "components",
              "clocks", "samples", "chains", "jobs per H", "platform");
  for (const RatedCase& made : cases) {
    const Components found = find_components(made.app).value();
    std::string jobs;
    for (const Domain& domain : found.domains)
      jobs += (jobs.empty() ? "" : "+") +
              (domain.jobs > 0 ? std::to_string(domain.jobs) : std::string("no H"));
    std::printf("%-14s %6.1f %6zu %10zu %6zu %8zu %7zu %10s  %s\n", made.name.c_str(),
                static_cast<double>(load_ppm(made.app, made.platform)) / 1e4,
                made.app.xnodes.size(), found.components.size(), found.domains.size(),
                made.app.samples.size(), made.app.chains.size(), jobs.c_str(),
                made.platform.name.c_str());
  }
}

Status write_cases(const std::vector<RatedCase>& cases, const std::string& folder) {
  for (const RatedCase& made : cases) {
    const std::string path = folder + "/" + made.name;
    XAUTO_TRY(write_file(path + ".app.json", xauto::to_json(made.app)));
    XAUTO_TRY(write_file(path + ".platform.json", xauto::to_json(made.platform)));
  }
  return {};
}

Result<int> run(const Flags& flags) {
  std::vector<RatedCase> cases = flags.scale ? scale_set() : standard_set(flags.first);
  std::erase_if(cases, [&](const RatedCase& made) { return !wanted(made, flags.only); });
  if (cases.empty())
    return fail(ErrorCode::kNotFound, "no case has this name or kind", "--only",
                "--list names all of them");
  if (flags.list) {
    list(cases);
    return 0;
  }
  if (!flags.folder.empty()) {
    XAUTO_TRY(write_cases(cases, flags.folder));
    return 0;
  }
  std::printf("%-14s%7s%8s%7s  %-9s%9s%7s%9s%9s%10s%9s%9s%9s%9s\n", "case", "XNodes", "jobs",
              "load", "outcome", "first ms", "MiB", "check ms", "/ bound", "annealer", "fixed",
              "rm", "fcfs", "fastest");
  std::vector<Row> rows;
  Json all = Json::array();
  bool broken = false;
  for (const RatedCase& made : cases) {
    Asked asked = flags.asked;
    if (made.app.xnodes.size() > 500) asked.annealer_s = 0;  // it is not made for that
    XAUTO_ASSIGN(Measured measured, measure(made, asked));
    rows.push_back({&made, std::move(measured)});
    const Row& row = rows.back();
    std::printf("%s\n", in_table(row).c_str());
    std::fflush(stdout);
    all.push_back(to_json(row));
    if (row.measured.late > 0 || row.measured.ours_ratio > 1) {
      std::printf("BROKEN: %s: %lld jobs late, observed / worst case %.3f\n", made.name.c_str(),
                  static_cast<long long>(row.measured.late), row.measured.ours_ratio);
      broken = true;
    }
  }
  sum_up(rows, flags.asked);
  if (!flags.json.empty())
    XAUTO_TRY(write_file(flags.json, Json{{"time_limit_s", flags.asked.time_limit_s},
                                          {"threads", flags.asked.threads},
                                          {"seed", flags.asked.seed},
                                          {"runs", 1},
                                          {"cases", std::move(all)}}
                                             .dump(1) +
                                         "\n"));
  return broken ? 1 : 0;
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  xauto::bench::Flags flags;
  xauto::bench::Asked& asked = flags.asked;
  xauto::cli::Program program(
      "Policies of keys for generated apps, beside what else one could do.");
  program.duration("--time-limit", asked.time_limit_s, xauto::cli::Unit::kSeconds, 0,
                   xauto::cli::kYearS, "of the solver, per case");
  std::string objective = "largest";
  program
      .option("--objective", objective, "of the solver, where chains have deadlines; else the sum")
      .one_of({"largest", "mix", "sum"})
      .shown();
  program.option("--threads", asked.threads, "of the solver").range(1, 64).shown();
  program.option("--seed", asked.seed, "of the solver, of the annealer and of the plays").shown();
  program.duration("--annealer", asked.annealer_s, xauto::cli::Unit::kSeconds, 0,
                   xauto::cli::kYearS,
                   "of the plain annealer, one thread; 0: none; default: as the solver");
  program.flag("!--no-rivals", asked.rivals, "leave out the plays");
  program.option("--plays", asked.plays.count, "of each rule").range(1, 1000).shown();
  program.option("--jobs", asked.plays.jobs, "in each play, about").positive().shown();
  program.option("--only", flags.only, "cases or kinds: rates,clocks-3").separated_by(',');
  program.option("--first", flags.first, "seed of the first case of each kind; 1: what we tune on")
      .shown();
  program.flag("--scale", flags.scale, "the large cases instead");
  program.flag("--list", flags.list, "name the cases, and end");
  program.option("--write", flags.folder, "write the cases into this folder, and end");
  program.option("--json", flags.json, "write what was measured here");
  if (const auto status = program.parse(argc, argv)) return *status;
  asked.plays.seed = asked.seed;
  using xauto::solver::keys::Aim;
  asked.aim = objective == "mix" ? Aim::kMix : objective == "sum" ? Aim::kSum : Aim::kLargest;
  const auto done = xauto::bench::run(flags);
  if (done) return *done;
  std::fprintf(stderr, "error: %s\n", done.error().to_string().c_str());
  return 2;
}
