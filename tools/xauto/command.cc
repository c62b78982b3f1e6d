// SPDX-License-Identifier: Apache-2.0
#include "xauto/command.h"

#include <cstdio>
#include <iostream>
#include <new>

#include <fmt/format.h>

#include "base/log.h"
#include "base/nearest.h"
#include "model/keys.h"

namespace xauto::cli {

std::string ms(std::int64_t us) {
  return fmt::format("{:.{}f} ms", static_cast<double>(us) / 1000, us > -1000 && us < 1000 ? 3 : 2);
}

std::string words_of_missed(const std::vector<std::string>& missed) {
  if (missed.empty()) return {};
  constexpr std::size_t kShown = 3;
  std::string text = "But it misses what was asked for, so the exit status is 1: ";
  for (std::size_t i = 0; i < std::min(kShown, missed.size()); ++i)
    text += (i == 0 ? "" : "; ") + missed[i];
  if (missed.size() > kShown) text += fmt::format("; {} more", missed.size() - kShown);
  return text + ".\n";
}

std::string words_of_lies(const std::string& path, std::size_t lies) {
  return fmt::format("\n{} lies: {} of its statements {} false.\n", path, lies,
                     lies == 1 ? "is" : "are");
}

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

Verb Commands::add(const std::string& name, const std::string& description,
                   const std::string& example, Body body) {
  Verb verb = program_.verb(name, description);
  verb.footer("Example:\n  " + example);
  verb.flag("--json", options_.json, "print one JSON object on stdout");
  bodies_[name] = std::move(body);
  return verb;
}

int Commands::run(int argc, char** argv) {
  program_.version(XAUTO_VERSION);
  program_.footer(
      "Exit status: 0 done, 1 the answer is no or something failed, 2 bad usage or bad input.\n"
      "Next: xauto doctor");
  for (Verb& verb : program_.verbs())
    if (verb.has("--app") || verb.has("--platform"))
      verb.flag("--strict", options_.strict,
                "refuse files with keys that their format does not have");
  // The parser would only say that a verb is missing.
  if (argc > 1 && argv[1][0] != '-' && !bodies_.contains(argv[1])) {
    std::vector<std::string> verbs;
    for (const auto& [name, body] : bodies_) verbs.push_back(name);
    const std::string meant = nearest(argv[1], verbs);
    log::error("there is no verb '{}'{}", argv[1],
               meant.empty() ? "" : "; did you mean '" + meant + "'?");
    log::hint("`xauto --help` lists the verbs");
    return kBadInput;
  }
  if (const auto status = program_.parse(argc, argv)) return *status;
  const std::string chosen = program_.chosen();
  if (options_.strict) set_unknown_keys(UnknownKeys::kRefuse);
  try {
    const Result<int> status = bodies_.at(chosen)(options_);
    if (!status) return report(status.error());
    std::cout.flush();
    if (std::fflush(stdout) == 0 && std::cout && std::ferror(stdout) == 0) return *status;
    log::error("the result could not be written to stdout");
    return *status == kDone ? kAnswerIsNo : *status;
  } catch (const std::bad_alloc&) {
    log::error("there is no memory left");
    log::hint("raise the limit (`ulimit -v`, systemd's MemoryMax=), or free some");
    return kAnswerIsNo;
  } catch (const std::exception& e) {
    // Our own code does not throw; this is a bug, and it gets a name.
    log::error("unexpected: {}", e.what());
    return kAnswerIsNo;
  }
}

}  // namespace xauto::cli
