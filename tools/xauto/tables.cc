// SPDX-License-Identifier: Apache-2.0
#include "xauto/tables.h"

#include <algorithm>
#include <cstdio>
#include <iostream>

#include <fmt/format.h>

#include "model/claims.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/verify_tables.h"

#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

double regret_of(const Served& served) {
  return static_cast<double>(served.worst_case_us) /
         static_cast<double>(std::max<std::int64_t>(1, served.lower_bound_us));
}

bool misses(const AppSpec& app, const Served& served) {
  return app.deadline_us && served.worst_case_us > *app.deadline_us;
}
bool misses(const AppSpec& app, const Change& change) {
  return app.deadline_us && change.worst_case_us && *change.worst_case_us > *app.deadline_us;
}

void print_tables(const AppSpec& app, const Tables& tables) {
  std::size_t width = 8, table_width = 10;
  for (const Scenario& s : tables.scenarios) width = std::max(width, s.name.size());
  for (const Table& t : tables.tables) table_width = std::max(table_width, t.name.size());
  const std::size_t count = tables.tables.size();
  std::printf("%s on %s: %zu scenarios, %zu table%s, %.2f s\n\n", app.name.c_str(),
              tables.platform.c_str(), tables.scenarios.size(), count, count == 1 ? "" : "s",
              static_cast<double>(tables.solve_ms) / 1000);
  std::printf("  %-*s  %-*s %12s %12s %8s\n", static_cast<int>(width), "scenario",
              static_cast<int>(table_width), "table", "worst case", "lower bound", "regret");
  std::size_t worst = 0;
  for (std::size_t s = 0; s < tables.serves.size(); ++s) {
    const Served& served = tables.serves[s];
    if (regret_of(served) > regret_of(tables.serves[worst])) worst = s;
    std::printf("  %-*s  %-*s %12s %12s %8.3f%s\n", static_cast<int>(width),
                tables.scenarios[s].name.c_str(), static_cast<int>(table_width),
                tables.tables[static_cast<std::size_t>(served.table)].name.c_str(),
                ms(served.worst_case_us).c_str(), ms(served.lower_bound_us).c_str(),
                regret_of(served), misses(app, served) ? "  MISSES THE DEADLINE" : "");
  }
  const Change* longest = nullptr;
  std::size_t without = 0;
  for (const Change& change : tables.changes) {
    if (!change.worst_case_us)
      ++without;
    else if (longest == nullptr || *change.worst_case_us > *longest->worst_case_us)
      longest = &change;
  }
  std::printf(
      "\n  worst regret %.3f, under '%s'. Each worst case is certified, of %s, at the scenario's "
      "times and below; each bound is proven.%s\n",
      tables.worst_regret(), tables.scenarios[worst].name.c_str(), kWorstCaseScope,
      tables.worst_regret() > 1 ? " That as few tables cannot do better is not." : "");
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Table& table = tables.tables[t];
    if (table.loss.none()) continue;
    const bool suffices =
        std::none_of(tables.serves.begin(), tables.serves.end(), [&](const Served& served) {
          return served.table == static_cast<int>(t) &&
                 served.worst_case_us > time_for_a_release(app).value_or(0);
        });
    std::printf("  %s: loses %lld %%, %s.\n", table.name.c_str(),
                static_cast<long long>(loss_pct(table.loss, app)),
                suffices ? "the least that was found to end a release in time; that less does not "
                           "suffice is not proven"
                         : "all that it may lose, and no release was found to end in time");
  }
  if (count > 1) {
    std::size_t most = 0;
    for (const Table& a : tables.tables)
      for (const Table& b : tables.tables) most = std::max(most, moves(a, b));
    std::printf(
        "  A run makes %zu instances of %zu XNodes at its start; from one table to another at most "
        "%zu XNodes move.\n",
        instances(tables), app.xnodes.size(), most);
  }
  if (longest != nullptr)
    std::printf("  A release that is under way when the scenario changes takes at most %s%s.\n",
                ms(*longest->worst_case_us).c_str(),
                app.deadline_us && *longest->worst_case_us > *app.deadline_us
                    ? ", which MISSES THE DEADLINE"
                    : "");
  if (longest != nullptr && longest->delay_us)
    std::printf("  The next one waits for it: it comes at most %s later than planned.\n",
                ms(*longest->delay_us).c_str());
  if (without > 0)
    std::printf(
        "  In %zu of %zu changes it may need an XPU that is lost: nothing is claimed of it then.\n",
        without, tables.changes.size());
}

}  // namespace

Result<int> solve_with_tables(const AppSpec& app, const Platform& platform,
                              const std::string& scenarios, solver::TablesOptions asked,
                              const std::string& out, const Options& options) {
  XAUTO_ASSIGN(const Scenarios list, load_scenarios(scenarios, app, platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", out));
  SearchLine line;
  asked.on_progress = [&](double elapsed_s, int solved, double worst) {
    if (!line.due(elapsed_s)) return;
    line.show(elapsed_s, static_cast<std::size_t>(solved) < list.list.size()
                             ? fmt::format("{} of {} scenarios solved", solved, list.list.size())
                             : fmt::format("worst regret {:.3f}", worst));
  };
  const auto solved = solver::solve_tables(app, platform, list, asked);
  line.end();
  if (!solved) return tl::unexpected<Error>(solved.error());
  const Tables& tables = *solved;
  if (options.json) {
    Json root = Json::parse(to_json(tables, app, platform)).value_or(Json());
    root["worst_regret"] = tables.worst_regret();
    root["instances"] = instances(tables);
    std::cout << root.dump(2) << "\n";
  } else {
    print_tables(app, tables);
  }
  std::fflush(stdout);
  if (!out.empty()) outputs.write(out, to_json(tables, app, platform));
  if (!options.json && !out.empty() && outputs.good())
    std::printf("\n  written to %s\n", out.c_str());
  const auto late = [&](const auto& of) { return misses(app, of); };
  const bool missed = std::any_of(tables.serves.begin(), tables.serves.end(), late) ||
                      std::any_of(tables.changes.begin(), tables.changes.end(), late);
  return outputs.status(missed ? kAnswerIsNo : kDone);
}

Result<int> check_tables(const AppSpec& app, const Platform& platform, const std::string& path,
                         const solver::VerifyOptions& asked, const Options& options) {
  XAUTO_ASSIGN(const Tables tables, load_tables(path, app, platform));
  const solver::TablesVerification v = solver::verify_tables(app, platform, tables, asked);
  std::vector<std::string> missed;
  for (std::size_t s = 0; s < tables.serves.size(); ++s)
    if (misses(app, tables.serves[s]))
      missed.push_back("scenario '" + tables.scenarios[s].name +
                       "': " + ms(tables.serves[s].worst_case_us) + " of " + ms(*app.deadline_us));
  for (const Change& change : tables.changes)
    if (misses(app, change))
      missed.push_back("change from '" +
                       tables.scenarios[static_cast<std::size_t>(change.from)].name + "' to '" +
                       tables.scenarios[static_cast<std::size_t>(change.to)].name +
                       "': " + ms(*change.worst_case_us) + " of " + ms(*app.deadline_us));
  const int status = v.truthful() && missed.empty() ? kDone : kAnswerIsNo;
  if (options.json) {
    std::cout << Json{{"schema", "xauto.check"},  {"version", 1},
                      {"truthful", v.truthful()}, {"lies", v.lies},
                      {"shown", v.shown},         {"taken", v.taken},
                      {"missed", missed},         {"worst_regret", v.worst_regret}}
                     .dump(2)
              << "\n";
    return status;
  }
  for (const std::string& lie : v.lies) std::cout << "  LIE    " << lie << "\n";
  for (const std::string& one : missed) std::cout << "  MISSED " << one << "\n";
  for (const std::string& shown : v.shown) std::cout << "  shown  " << shown << "\n";
  for (const std::string& taken : v.taken) std::cout << "  taken  " << taken << "\n";
  std::cout << (v.truthful() ? fmt::format("\n{} tells the truth; its worst regret is {:.3f}.\n",
                                           path, v.worst_regret)
                             : fmt::format("\n{} lies: {} of its statements are false.\n", path,
                                           v.lies.size()));
  return status;
}

}  // namespace xauto::cli
