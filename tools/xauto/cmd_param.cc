// SPDX-License-Identifier: Apache-2.0
// xauto param: the parameters of a run that goes on. They are read from its counts, as `xauto top`
// does; to change one the run's tool is asked.
#include <atomic>
#include <chrono>
#include <iostream>
#include <thread>

#include <fmt/format.h>

#include "base/utf8.h"
#include "model/json_value.h"
#include "processes/parameters.h"

#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

using runtime::PostedParameter;

struct ParamFlags {
  std::string action, run;
  std::vector<std::string> words;  ///< module, then what of it
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
    std::cout
        << Json{{"run", run.run}, {"app", run.app}, {"parameters", std::move(parameters)}}.dump(2)
        << "\n";
    return kDone;
  }
  if (all.empty()) {
    std::cout << "no parameters\n";
    return kDone;
  }
  std::vector<std::vector<std::string>> rows = {
      {"module", "name", "type", "range", "value", "default"}};
  for (const PostedParameter& p : all)
    rows.push_back({p.module, p.spec.name, to_string(p.spec.type()), p.spec.range(),
                    for_terminal(to_text(p.value)), for_terminal(to_text(p.spec.initial))});
  std::vector<std::size_t> width(rows.front().size());
  for (const auto& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i) width[i] = std::max(width[i], row[i].size());
  for (const auto& row : rows) {
    std::string line;
    for (std::size_t i = 0; i < row.size(); ++i)
      line += i + 1 == row.size() ? row[i] : fmt::format("{:<{}}  ", row[i], width[i]);
    std::cout << line << "\n";
  }
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

}  // namespace

void add_param(Commands& commands) {
  auto flags = std::make_shared<ParamFlags>();
  Verb verb =
      commands.add("param", "Show and change the parameters of a run that goes on.",
                   "xauto param list\n  xauto param get lanes threshold\n"
                   "  xauto param set lanes threshold=0.7 mode=night",
                   [flags](const Options& options) -> Result<int> {
                     if (flags->action == "list") return list(*flags, options);
                     return flags->action == "get" ? get(*flags, options) : set(*flags, options);
                   });
  verb.option("action", flags->action, "list, get or set")
      .required()
      .one_of({"list", "get", "set"});
  verb.option(
      "words", flags->words,
      "list: [MODULE]; get: MODULE NAME; set: MODULE NAME=VALUE ..., which change together");
  verb.option("--run", flags->run, "which run, where several go on");
  verb.option("--wait-s", flags->wait_s, "wait so long for a run").not_negative().shown();
}

}  // namespace xauto::cli
