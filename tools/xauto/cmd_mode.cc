// SPDX-License-Identifier: Apache-2.0
// xauto mode: the scenarios of a run with tables, which one counts now, and the wish for another one.
#include <atomic>
#include <iostream>

#include <fmt/format.h>

#include "model/json_value.h"

#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

struct ModeFlags {
  std::string name, run;
  bool none = false;
  int wait_s = 0;
};

Result<int> list(const Watched& run, const Options& options) {
  const std::uint32_t scenarios = run.board->shape().scenarios;
  const Counts counts = counts_of(*run.board);
  if (scenarios == 0 || !counts.scenario)
    return fail(ErrorCode::kUnavailable, "has one policy, so there are no modes",
                "run '" + run.run + "'", "start it with the tables of `xauto solve --scenarios`");
  const ScenarioCounts& now = *counts.scenario;
  if (options.json) {
    Json all = Json::array();
    for (std::uint32_t s = 0; s < scenarios; ++s) {
      const ScenarioCounts one = scenario_of(*run.board, s);
      all.push_back({{"name", one.name}, {"table", one.table}, {"releases", one.releases}});
    }
    std::cout << Json{{"run", run.run},
                      {"now", now.name},
                      {"why", now.why},
                      {"asked", now.asked.empty() ? Json() : Json(now.asked)},
                      {"switches", now.switches},
                      {"spanned", spanned_json(counts)},
                      {"scenarios", std::move(all)}}
                     .dump(2)
              << "\n";
    return kDone;
  }
  std::size_t width = 8;
  for (std::uint32_t s = 0; s < scenarios; ++s)
    width = std::max(width, scenario_of(*run.board, s).name.size());
  std::cout << fmt::format("    {:<{}}  {:<12}{:>10}\n", "scenario", width, "table", "releases");
  for (std::uint32_t s = 0; s < scenarios; ++s) {
    const ScenarioCounts one = scenario_of(*run.board, s);
    std::cout << fmt::format("  {} {:<{}}  {:<12}{:>10}{}\n", one.name == now.name ? "*" : " ",
                             one.name, width, one.table, one.releases,
                             one.name == now.asked ? "  asked for" : "");
  }
  if (counts.spanned) std::cout << "\n" << spanned_text(counts);
  return kDone;
}

Result<int> mode(const ModeFlags& flags, const Options& options) {
  if (flags.none && !flags.name.empty())
    return fail(ErrorCode::kInvalid, "asks for a scenario and for none", "xauto mode");
  XAUTO_ASSIGN(const Watched run, find_run(flags.run, flags.wait_s));
  if (flags.name.empty() && !flags.none) return list(run, options);
  XAUTO_ASSIGN(const Json was, ask_desk(run, Json{{"mode", flags.name}}));
  const std::string before = was.at("mode").text().value_or("");
  if (options.json) {
    std::cout << Json{{"was", before.empty() ? Json() : Json(before)}}.dump() << "\n";
    return kDone;
  }
  const auto said = [](const std::string& name) { return name.empty() ? "none" : name; };
  std::cout << "asked for: " << said(before) << " -> " << said(flags.name) << "\n";
  return kDone;
}

}  // namespace

void add_mode(Commands& commands) {
  auto flags = std::make_shared<ModeFlags>();
  Verb verb = commands.add("mode", "Show the scenarios of a run with tables, or ask for one.",
                           "xauto mode\n  xauto mode \"no DLA\"\n  xauto mode --none",
                           [flags](const Options& options) { return mode(*flags, options); });
  verb.option("name", flags->name,
              "from the next release on at least what this scenario covers counts; without it: the "
              "list");
  verb.flag("--none", flags->none, "nobody asks any more");
  verb.option("--run", flags->run, "which run, where several go on");
  verb.option("--wait-s", flags->wait_s, "wait so long for a run").not_negative().shown();
}

}  // namespace xauto::cli
