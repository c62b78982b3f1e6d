// SPDX-License-Identifier: Apache-2.0
#include "xauto/tables.h"

#include <algorithm>
#include <cstdio>
#include <iostream>
#include <set>

#include <fmt/format.h>

#include "base/columns.h"
#include "model/claims.h"
#include "model/drain.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/keys/check_tables.h"

#include "xauto/outputs.h"
#include "xauto/rare_wcets.h"

namespace xauto::cli {
namespace {

double regret_of(const Served& served) {
  return static_cast<double>(served.worst_case_us) /
         static_cast<double>(std::max<std::int64_t>(1, served.lower_bound_us));
}

/// "from 'a' to 'b': brake: 81.00 of 80.00 ms", of what is beyond a chain's deadline.
std::vector<std::string> missed_chains(const AppSpec& app, const Tables& tables) {
  std::vector<std::string> missed;
  const auto judge = [&](const std::string& what, std::size_t chain,
                         std::optional<std::int64_t> us) {
    const auto& deadline = app.chains[chain].deadline_us;
    if (us && deadline && *us > *deadline)
      missed.push_back(what + ": " + app.chains[chain].name + ": " + ms(*us) + " of " +
                       ms(*deadline));
  };
  for (std::size_t t = 0; t < tables.tables.size(); ++t)
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      judge("'" + tables.tables[t].name + "', urgent", c,
            tables.tables[t].keys.chains[c].urgent_worst_case_us);
  for (std::size_t s = 0; s < tables.serves.size(); ++s)
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      judge("'" + tables.scenarios[s].name + "'", c, tables.serves[s].chain_worst_us[c]);
  for (const Handover& h : tables.handovers)
    for (std::size_t c = 0; c < app.chains.size(); ++c)
      judge("from '" + tables.tables[static_cast<std::size_t>(h.from)].name + "' to '" +
                tables.tables[static_cast<std::size_t>(h.to)].name + "'",
            c, h.worst_case_us[c]);
  return missed;
}

constexpr std::size_t kOfScenario = 24, kTableColumns = 12;

/// The longest of a chain while one table takes the place of another.
std::string any_change(const Tables& tables, std::size_t chain) {
  std::optional<std::int64_t> most = 0;
  for (const Handover& h : tables.handovers) {
    if (h.worst_case_us[chain] == kNotThere) continue;
    most = most && h.worst_case_us[chain] ? std::optional(std::max(*most, *h.worst_case_us[chain]))
                                          : std::nullopt;
  }
  return most == 0 ? "-" : most ? ms(*most) : "not known";
}

/// What chains take in each table, as many tables side by side as fit, and while one takes the place of another.
std::string chains_text(const AppSpec& app, const Tables& tables) {
  constexpr std::size_t kAtATime = (kLineColumns - 2 - kOfScenario) / kTableColumns;
  const auto right = [](const std::string& text) {
    return std::string(kTableColumns - columns_of(text), ' ') + text;
  };
  std::vector<std::pair<std::string, std::vector<std::string>>> columns(1, {"deadline", {}});
  for (const ChainSpec& chain : app.chains)
    columns[0].second.push_back(chain.deadline_us ? ms(*chain.deadline_us) : "-");
  for (const Table& table : tables.tables) {
    auto& [name, cells] = columns.emplace_back(table.name, std::vector<std::string>());
    for (const ChainClaim& claim : table.keys.chains)
      cells.push_back(claim.worst_case_us == kNotThere ? "off" : ms(claim.worst_case_us));
  }
  columns.push_back({"any change", {}});
  for (std::size_t c = 0; c < app.chains.size(); ++c)
    columns.back().second.push_back(any_change(tables, c));
  std::string out;
  for (std::size_t first = 0; first < columns.size(); first += kAtATime) {
    const std::size_t end = std::min(columns.size(), first + kAtATime);
    out += "\n" + row_of("chain", kOfScenario);
    for (std::size_t i = first; i < end; ++i)
      out += right(cut(columns[i].first, kTableColumns - 1));
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      out += "\n" + row_of(app.chains[c].name, kOfScenario);
      for (std::size_t i = first; i < end; ++i) out += right(columns[i].second[c]);
    }
    out += "\n";
  }
  return out;
}

void print_chains(const AppSpec& app, const Platform& platform, const Tables& tables) {
  std::fputs(chains_text(app, tables).c_str(), stdout);
  std::int64_t settles = 0;
  for (const Handover& h : tables.handovers) settles = std::max(settles, h.settles_us);
  if (settles > 0)
    std::printf("  A change has settled after %s at most: a run makes no other one before.\n",
                ms(settles).c_str());
  std::set<std::string> why;
  for (const Handover& h : tables.handovers) why.insert(h.not_claimed.begin(), h.not_claimed.end());
  for (const std::string& line : why)
    std::printf("  Not known what a change costs: %s.\n", line.c_str());
  std::int64_t drains = 0;
  for (const Handover& h : tables.handovers)
    drains = std::max(drains, drain_us(tables, h.from, h.to, app, platform));
  if (drains > 0)
    std::printf(
        "  Such a change drains: nothing is released for %s at most, and then the next table's "
        "worst "
        "cases hold.\n",
        ms(drains).c_str());
  for (const std::string& missed : missed_chains(app, tables))
    std::printf("  MISSES THE DEADLINE: %s\n", missed.c_str());
}

/// All that the table serves keeps its deadlines.
bool in_time(const Tables& tables, std::size_t table, const AppSpec& app) {
  for (const Served& served : tables.serves) {
    if (served.table != static_cast<int>(table)) continue;
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      const ChainClaim& claim = tables.tables[table].keys.chains[c];
      if (std::max(served.chain_worst_us[c], claim.urgent_worst_case_us.value_or(0)) >
          app.chains[c].deadline_us.value_or(kMaxTimeUs))
        return false;
    }
  }
  return true;
}

/// What all instances add to the memory of the app's processes when a run starts.
std::string memory_text(const InstanceMemory& memory, std::size_t all) {
  if (memory.measured == 0) return "not measured (`xauto profile` does, where stages are real)";
  return fmt::format(
      "{}{} MiB measured by profile{} (device memory not included)",
      memory.measured < all ? "at least " : "", (memory.kb + 1023) / 1024,
      memory.measured < all ? fmt::format(", of {} of {} instances", memory.measured, all) : "");
}

void print_tables(const AppSpec& app, const Platform& platform, const Tables& tables,
                  bool tried_all) {
  const std::size_t count = tables.tables.size();
  std::printf("%s on %s: %zu scenarios, %zu table%s, %.2f s\n\n", app.name.c_str(),
              tables.platform.c_str(), tables.scenarios.size(), count, count == 1 ? "" : "s",
              static_cast<double>(tables.solve_us) / 1e6);
  const bool deadlines = std::any_of(app.chains.begin(), app.chains.end(),
                                     [](const ChainSpec& c) { return c.deadline_us.has_value(); });
  std::printf("%s%12s%13s%8s  table\n", row_of("scenario", kOfScenario).c_str(), "worst case",
              "lower bound", "regret");
  std::size_t worst = 0;
  for (std::size_t s = 0; s < tables.serves.size(); ++s) {
    const Served& served = tables.serves[s];
    if (regret_of(served) > regret_of(tables.serves[worst])) worst = s;
    const std::string& table = tables.tables[static_cast<std::size_t>(served.table)].name;
    const std::string row = row_of(tables.scenarios[s].name, kOfScenario) +
                            fmt::format("{:>12}{:>13}{:>8.3f}  {}", ms(served.worst_case_us),
                                        ms(served.lower_bound_us), regret_of(served), table);
    std::printf("%s\n", wrapped(row, 6).c_str());
  }
  std::printf(
      "\n  worst regret %.3f, under '%s'.%s Each worst case is certified, of %s, at the scenario's "
      "times and below; each bound is proven, of policies of keys.%s\n",
      tables.worst_regret(), tables.scenarios[worst].name.c_str(),
      deadlines
          ? " Told is the chain that is worst off relative to its deadline, and what that comes to "
            "in any policy of keys."
      : app.one_at_a_time ? " Told is the longest chain: none has a deadline."
                          : " Told is the sum over all chains: none has a deadline.",
      scope_of(app.one_at_a_time),
      tables.worst_regret() <= 1 ? ""
      : tried_all                ? " As few tables cannot do better: every one was tried."
                                 : " That as few tables cannot do better is not.");
  for (std::size_t t = 0; t < tables.tables.size(); ++t) {
    const Table& table = tables.tables[t];
    if (table.loss.none()) continue;
    std::printf(
        "  %s: loses %lld %%, %s.\n", table.name.c_str(),
        static_cast<long long>(loss_pct(table.loss, app)),
        in_time(tables, t, app)
            ? "the least that was found to keep the deadlines; that less does not suffice is "
              "not proven"
            : "all that it may lose, and it was not found to keep the deadlines so");
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
  std::printf("  Memory of all instances: %s.\n",
              memory_text(memory_of_instances(tables, app, platform), instances(tables)).c_str());
  print_chains(app, platform, tables);
}

bool any_missed(const AppSpec& app, const Tables& tables) {
  return !missed_chains(app, tables).empty();
}

/// The app's own, in whose steps the scenarios' times are counted, on a type where a table has the XNode.
std::vector<RareWcet> rare_in(const AppSpec& app, const Platform& platform, const Tables& tables) {
  return rare_wcets(app, [&](int xnode, const std::string& type) {
    return std::any_of(tables.tables.begin(), tables.tables.end(), [&](const Table& table) {
      const int xpu = table.xpu(static_cast<std::size_t>(xnode));
      return xpu >= 0 && platform.xpus[static_cast<std::size_t>(xpu)].type == type;
    });
  });
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
  bool tried_all = false;
  asked.tried_all = &tried_all;
  const auto solved = solver::solve_tables(app, platform, list, asked);
  line.end();
  if (!solved) {
    if (solved.error().code == ErrorCode::kInfeasible && !options.json)
      std::fputs(words_of(rare_wcets(app, [](int, const std::string&) { return true; }), app, false)
                     .c_str(),
                 stderr);
    return tl::unexpected<Error>(solved.error());
  }
  const Tables& tables = *solved;
  const bool missed = any_missed(app, tables);
  const std::vector<RareWcet> rare =
      missed ? rare_in(app, platform, tables) : std::vector<RareWcet>();
  if (options.json) {
    Json root = Json::parse(to_json(tables, app, platform)).value_or(Json());
    root["worst_regret"] = tables.worst_regret();
    root["tried_all"] = tried_all;
    root["instances"] = instances(tables);
    const InstanceMemory memory = memory_of_instances(tables, app, platform);
    root["memory_kb"] = memory.measured > 0 ? Json(memory.kb) : Json();
    root["memory_measured"] = memory.measured;
    if (!rare.empty()) root["rare_wcets"] = to_json(rare, app);
    std::cout << root.dump(2) << "\n";
  } else {
    print_tables(app, platform, tables, tried_all);
    std::fputs(words_of(rare, app, false).c_str(), stdout);
  }
  std::fflush(stdout);
  if (!out.empty()) outputs.write(out, to_json(tables, app, platform));
  if (!options.json && !out.empty() && outputs.good())
    std::printf("\n  written to %s\n", out.c_str());
  return outputs.status(missed ? kAnswerIsNo : kDone);
}

Result<int> check_tables(const AppSpec& app, const Platform& platform, const std::string& path,
                         const Options& options) {
  XAUTO_ASSIGN(const Tables tables, load_tables(path, app, platform));
  const solver::keys::TablesReport v = solver::keys::examine_tables(app, platform, tables);
  const std::vector<std::string> missed = missed_chains(app, tables);
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
  for (const std::string& lie : v.lies) std::cout << wrapped("  LIE    " + lie, 9) << "\n";
  for (const std::string& one : missed) std::cout << wrapped("  MISSED " + one, 9) << "\n";
  for (const std::string& shown : v.shown) std::cout << wrapped("  shown  " + shown, 9) << "\n";
  for (const std::string& taken : v.taken) std::cout << wrapped("  taken  " + taken, 9) << "\n";
  std::cout << (v.truthful() ? fmt::format("\n{} tells the truth; its worst regret is {:.3f}.\n",
                                           path, v.worst_regret)
                             : words_of_lies(path, v.lies.size()))
            << words_of_missed(missed);
  return status;
}

}  // namespace xauto::cli
