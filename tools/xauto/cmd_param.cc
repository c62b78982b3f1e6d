// SPDX-License-Identifier: Apache-2.0
// xauto param: the parameters and scenarios of a run that goes on. They are read from its counts, as
// `xauto top` does; to change one the run's tool is asked.
#include <array>
#include <chrono>
#include <iostream>
#include <thread>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/utf8.h"
#include "model/json_value.h"
#include "processes/parameters.h"

#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

using runtime::PostedParameter;

struct ParamFlags {
  std::string action = "list", run;
  std::vector<std::string> words;  ///< module, then what of it; or a scenario
  bool none = false;
  int wait_s = 0;
};

/// All of the run's, or of one module.
Result<std::vector<PostedParameter>> read(const Watched& run, const std::string& module) {
  auto all = runtime::posted_parameters(*run.board);
  for (int i = 0; i < 100 && !all; ++i) {  // its app is about to post them
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    all = runtime::posted_parameters(*run.board);
  }
  if (!all) return all;
  if (module.empty()) return all;
  bool there = false;
  for (std::uint32_t m = 0; m < run.board->shape().modules; ++m)
    there = there || runtime::line_name(run.board->module(static_cast<int>(m)).name) == module;
  if (!there)
    return fail(ErrorCode::kNotFound, "the app has no XModule '" + module + "'",
                "run '" + run.run + "'", "`xauto param list` shows those with parameters");
  std::erase_if(*all, [&](const PostedParameter& p) { return p.module != module; });
  return all;
}

/// As its type says.
Json to_json(const ParameterValue& value) {
  return std::visit([](const auto& v) { return Json(v); }, value);
}

/// Of a run with tables; of another one nothing.
void add_scenarios(const Watched& run, Json& all) {
  const Counts counts = counts_of(*run.board);
  if (!counts.scenario) return;
  const ScenarioCounts& now = *counts.scenario;
  all["now"] = now.name;
  all["why"] = now.why;
  all["asked"] = now.asked.empty() ? Json() : Json(now.asked);
  all["switches"] = now.switches;
  all["spanned"] = spanned_json(counts);
  Json scenarios = Json::array();
  for (std::uint32_t s = 0; s < run.board->shape().scenarios; ++s) {
    const ScenarioCounts one = scenario_of(*run.board, s);
    scenarios.push_back({{"name", one.name}, {"table", one.table}, {"releases", one.releases}});
  }
  all["scenarios"] = std::move(scenarios);
}

std::string scenarios_table(const Watched& run) {
  const Counts counts = counts_of(*run.board);
  if (!counts.scenario) return {};
  const ScenarioCounts& now = *counts.scenario;
  const std::uint32_t scenarios = run.board->shape().scenarios;
  std::string out =
      "\n  " + row_of("scenario", kNameColumns) + fmt::format("{:>10}  table\n", "releases");
  for (std::uint32_t s = 0; s < scenarios; ++s) {
    const ScenarioCounts one = scenario_of(*run.board, s);
    out += wrapped((one.name == now.name ? "  * " : "    ") + left(one.name, kNameColumns) +
                       fmt::format("{:>10}  {}{}", one.releases, one.table,
                                   one.name == now.asked ? "  asked for" : ""),
                   6) +
           "\n";
  }
  if (counts.spanned) out += "\n" + spanned_text(counts);
  return out;
}

Result<int> list(const ParamFlags& flags, const Options& options) {
  if (flags.words.size() > 1)
    return fail(ErrorCode::kInvalid, "'" + flags.words[1] + "' is one word too much",
                "xauto param list", "xauto param list [MODULE]");
  XAUTO_ASSIGN(const Watched run, find_run(flags.run, flags.wait_s));
  XAUTO_ASSIGN(const std::vector<PostedParameter> all,
               read(run, flags.words.empty() ? "" : flags.words.front()));
  if (options.json) {
    Json parameters = Json::array();
    for (const PostedParameter& p : all) {
      const ParameterType type = p.spec.type();
      const bool number = type == ParameterType::kInteger || type == ParameterType::kReal;
      parameters.push_back({{"module", p.module},
                            {"name", p.spec.name},
                            {"type", to_string(type)},
                            {"least", number ? to_json(p.spec.least) : Json()},
                            {"most", number ? to_json(p.spec.most) : Json()},
                            {"value", to_json(p.value)},
                            {"default", to_json(p.spec.initial)},
                            {"changes", p.changes}});
    }
    Json shown = {{"run", run.run}, {"app", run.app}, {"parameters", std::move(parameters)}};
    if (flags.words.empty()) add_scenarios(run, shown);
    std::cout << shown.dump(2) << "\n";
    return kDone;
  }
  const std::string scenarios = flags.words.empty() ? scenarios_table(run) : "";
  if (all.empty()) {
    std::cout << "no parameters\n" << scenarios;
    return kDone;
  }
  std::vector<std::vector<std::string>> rows = {
      {"module", "name", "type", "range", "value", "default"}};
  for (const PostedParameter& p : all)
    rows.push_back({p.module, p.spec.name, to_string(p.spec.type()), p.spec.range(),
                    for_terminal(to_text(p.value)), for_terminal(to_text(p.spec.initial))});
  std::vector<std::size_t> width(rows.front().size());
  constexpr std::array<std::size_t, 6> kMost = {16, 20, 9, 16, 10, 9};
  for (const auto& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i)
      width[i] = std::min(kMost[i], std::max(width[i], columns_of(row[i]) + 2));
  for (const auto& row : rows) {
    for (std::size_t i = 0; i + 1 < row.size(); ++i) std::cout << left(row[i], width[i]);
    std::cout << cut(row.back(), kMost.back()) << "\n";
  }
  std::cout << scenarios;
  return kDone;
}

Result<int> get(const ParamFlags& flags, const Options& options) {
  if (flags.words.size() != 2)
    return fail(ErrorCode::kInvalid, "needs a module and a name", "xauto param get",
                "xauto param get MODULE NAME");
  XAUTO_ASSIGN(const Watched run, find_run(flags.run, flags.wait_s));
  XAUTO_ASSIGN(const std::vector<PostedParameter> all, read(run, flags.words[0]));
  for (const PostedParameter& p : all) {
    if (p.spec.name != flags.words[1]) continue;
    std::cout << (options.json ? Json{{"value", to_json(p.value)}}.dump()
                               : for_terminal(to_text(p.value)))
              << "\n";
    return kDone;
  }
  return fail(ErrorCode::kNotFound,
              "XModule '" + flags.words[0] + "' has no parameter '" + flags.words[1] + "'",
              "run '" + run.run + "'", "`xauto param list` shows what there is");
}

Result<int> set(const ParamFlags& flags, const Options& options) {
  constexpr const char* kUsage = "xauto param set MODULE NAME=VALUE [NAME=VALUE ...]";
  if (flags.words.size() < 2)
    return fail(ErrorCode::kInvalid, "needs a module and NAME=VALUE", "xauto param set", kUsage);
  Json values = Json::object();
  for (std::size_t i = 1; i < flags.words.size(); ++i) {
    const std::string& word = flags.words[i];
    const std::size_t equals = word.find('=');
    if (equals == std::string::npos)
      return fail(ErrorCode::kInvalid, "'" + word + "' is not NAME=VALUE", "xauto param set",
                  kUsage);
    if (values.has(word.substr(0, equals)))
      return fail(ErrorCode::kInvalid, "'" + word.substr(0, equals) + "' is given twice",
                  "xauto param set", kUsage);
    values[word.substr(0, equals)] = word.substr(equals + 1);
  }
  XAUTO_ASSIGN(const Watched run, find_run(flags.run, flags.wait_s));
  Json request = {{"module", flags.words.front()}};
  request["set"] = values;
  XAUTO_ASSIGN(const Json was, ask_desk(run, request));
  if (options.json) {
    std::cout << Json{{"was", was}}.dump() << "\n";
    return kDone;
  }
  for (std::size_t i = 0; i < was.keys().size(); ++i)
    std::cout << for_terminal(was.keys()[i]) << ": " << was.elements()[i].text().value_or("?")
              << " -> " << values.at(was.keys()[i]).text().value_or("?") << "\n";
  return kDone;
}

Result<int> scenario(const ParamFlags& flags, const Options& options) {
  if (flags.words.size() != (flags.none ? 0 : 1))
    return fail(ErrorCode::kInvalid, "needs one scenario's name, or --none", "xauto param scenario",
                "`xauto param` shows the scenarios");
  XAUTO_ASSIGN(const Watched run, find_run(flags.run, flags.wait_s));
  const std::string name = flags.none ? "" : flags.words.front();
  XAUTO_ASSIGN(const Json was, ask_desk(run, Json{{"mode", name}}));
  const std::string before = was.at("mode").text().value_or("");
  if (options.json) {
    std::cout << Json{{"was", before.empty() ? Json() : Json(before)}}.dump() << "\n";
    return kDone;
  }
  const auto said = [](const std::string& one) { return one.empty() ? "none" : one; };
  std::cout << "asked for: " << said(before) << " -> " << said(name) << "\n";
  return kDone;
}

}  // namespace

void add_param(Commands& commands) {
  auto flags = std::make_shared<ParamFlags>();
  Verb verb = commands.add(
      "param", "Show and change the parameters of a run that goes on, and its scenario.",
      "xauto param\n  xauto param get lanes threshold\n"
      "  xauto param set lanes threshold=0.7 mode=night\n"
      "  xauto param scenario \"no DLA\"\n  xauto param scenario --none",
      [flags](const Options& options) -> Result<int> {
        if (flags->none && flags->action != "scenario")
          return fail(ErrorCode::kInvalid, "is of `xauto param scenario` only", "--none",
                      "xauto param scenario --none");
        if (flags->action == "list") return list(*flags, options);
        if (flags->action == "scenario") return scenario(*flags, options);
        return flags->action == "get" ? get(*flags, options) : set(*flags, options);
      });
  verb.option("action", flags->action, "list, get, set or scenario; without it: list")
      .one_of({"list", "get", "set", "scenario"});
  verb.option("words", flags->words,
              "list: [MODULE], without it scenarios, too; get: MODULE NAME; set: MODULE NAME=VALUE "
              "..., which change together; scenario: NAME, of which from the next release on at "
              "least what it covers counts");
  verb.flag("--none", flags->none, "with scenario: nobody asks for one any more");
  verb.option("--run", flags->run, "which run, where several go on");
  verb.duration("--wait", flags->wait_s, Unit::kSeconds, 0, kYearS,
                "how long to wait for a run to begin");
}

}  // namespace xauto::cli
