// SPDX-License-Identifier: Apache-2.0
#include "xauto/command.h"

#include <algorithm>
#include <cstdio>
#include <iostream>

#include "base/log.h"
#include "model/keys.h"

#include "xauto/priorities.h"

namespace xauto::cli {

int exit_status(const Error& error) {
  switch (error.code) {
    case ErrorCode::kInvalid:
    case ErrorCode::kNotFound:
      return kBadInput;
    default:
      return kAnswerIsNo;
  }
}

/// Prints "xauto: error: ..." with its hint to stderr and returns exit_status(error).
static int report(const Error& error) {
  log::error("{}", error.to_string());
  return exit_status(error);
}

CLI::App* Commands::add(const std::string& verb, const std::string& description,
                        const std::string& example, Body body) {
  CLI::App* sub = root_.add_subcommand(verb, description);
  sub->footer("Example:\n  " + example);
  sub->add_flag("--json", options_.json, "print one JSON object on stdout");
  sub->callback([this, body = std::move(body)] { chosen_ = body; });
  return sub;
}

int Commands::run(int argc, char** argv) {
  root_.require_subcommand(1);
  root_.set_version_flag("--version", XAUTO_VERSION);
  root_.footer(
      "Exit status: 0 done, 1 the answer is no, 2 bad usage or bad input.\n"
      "Next: xauto doctor");
  for (CLI::App* sub : root_.get_subcommands({}))
    if (sub->get_option_no_throw("--app") != nullptr ||
        sub->get_option_no_throw("--platform") != nullptr)
      sub->add_flag("--strict", options_.strict,
                    "refuse files with keys that their format does not have");
  // CLI11 would only say that a verb is missing.
  const auto known = verbs();
  if (argc > 1 && argv[1][0] != '-' &&
      std::none_of(known.begin(), known.end(), [&](const Verb& v) { return v.name == argv[1]; })) {
    log::error("there is no verb '{}'", argv[1]);
    log::hint("`xauto --help` lists the verbs");
    return kBadInput;
  }
  try {
    root_.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return root_.exit(e) == 0 ? kDone : kBadInput;
  }
  // Verbs that start an app, and the one that says how an app would run.
  for (const char* verb : {"run", "compare", "profile", "doctor"})
    if (root_.got_subcommand(verb)) obtain_priorities(argv);
  if (options_.strict) set_unknown_keys(UnknownKeys::kRefuse);
  try {
    const Result<int> status = chosen_(options_);
    if (!status) return report(status.error());
    std::cout.flush();
    if (std::fflush(stdout) == 0 && std::cout && std::ferror(stdout) == 0) return *status;
    log::error("the result could not be written to stdout");
    return *status == kDone ? kAnswerIsNo : *status;
  } catch (const std::exception& e) {
    // Our own code does not throw; this is memory exhaustion or a bug, and it gets a name either
    // way.
    log::error("unexpected: {}", e.what());
    return kAnswerIsNo;
  }
}

/// CLI11 keeps the words of IsMember in the option's type only: "TEXT:{auto,heft}".
static std::vector<std::string> values_of(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const std::size_t open = type.find('{'), close = type.rfind('}');
  std::vector<std::string> values;
  if (open == std::string::npos || close == std::string::npos || close < open) return values;
  std::string word;
  for (std::size_t i = open + 1; i <= close; ++i) {
    if (type[i] != ',' && i < close) {
      word += type[i];
      continue;
    }
    values.push_back(std::move(word));
    word.clear();
  }
  return values;
}

std::vector<Commands::Verb> Commands::verbs() const {
  std::vector<Verb> verbs;
  for (const CLI::App* sub : root_.get_subcommands({})) {
    Verb verb{sub->get_name(), sub->get_description(), {}};
    for (const CLI::Option* option : sub->get_options()) {
      if (option->get_lnames().empty()) verb.options.push_back({"", values_of(*option)});
      for (const std::string& name : option->get_lnames())
        verb.options.push_back({"--" + name, values_of(*option)});
    }
    verbs.push_back(std::move(verb));
  }
  return verbs;
}

}  // namespace xauto::cli
