// SPDX-License-Identifier: Apache-2.0
// xauto check: is every number of a policy.json true, and does it do what was asked for (pins,
// groups, deadlines)? Exit status 1 and each lie or miss by name if not.
#include <iostream>
#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "model/json.h"
#include "model/json_value.h"
#include "solver/verify.h"

#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/periodic.h"
#include "xauto/tables.h"

namespace xauto::cli {
namespace {

struct CheckFlags {
  std::string app, platform = "small", policy, against;
  solver::VerifyOptions options;
  Wishes wishes;
  /// What only the attacks on version 1 take: option, argument.
  std::vector<std::pair<const char*, Argument>> of_attacks;
};

Result<int> check(const CheckFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_any_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (is_tables_file(flags.policy)) {
    if (!flags.against.empty() || flags.wishes.given())
      return fail(ErrorCode::kInvalid, "are for a policy.json", "--against, pins and deadlines",
                  "leave them out: tables know the app's deadline alone");
    return check_tables(app, platform, flags.policy, flags.options, options);
  }
  if (app.version == 2) {
    if (!flags.against.empty() || flags.wishes.deadline_us > 0)
      return fail(ErrorCode::kInvalid, "are for an app of version 1", "--against, --deadline-us");
    for (const auto& [option, argument] : flags.of_attacks)
      if (argument.given())
        return fail(ErrorCode::kInvalid, "is for an app of version 1", option,
                    "leave it out: the check of version 2 derives everything, and plays nothing; "
                    "`xauto simulate` does");
    XAUTO_ASSIGN(solver::Objectives asked, load_objectives(flags.app));
    XAUTO_TRY(add_to_objectives(flags.wishes, asked));
    return check_periodic(app, platform, flags.policy, asked, options);
  }
  XAUTO_ASSIGN(const Policy policy, load_policy(flags.policy, app, platform));
  solver::VerifyOptions asked = flags.options;
  XAUTO_ASSIGN(asked.asked, load_objectives(flags.app));
  XAUTO_TRY(add_to_objectives(flags.wishes, asked.asked));
  if (!flags.against.empty()) {
    XAUTO_ASSIGN(const Policy other, load_policy(flags.against, app, platform));
    asked.other_bound_us = other.lower_bound_us;
  }
  const solver::Verification v = solver::verify(app, platform, policy, asked);
  const int status =
      v.truthful() && v.missed.empty() && v.counterexample.empty() ? kDone : kAnswerIsNo;
  if (options.json) {
    std::cout << Json{{"schema", "xauto.check"},
                      {"version", 1},
                      {"truthful", v.truthful()},
                      {"lies", v.lies},
                      {"shown", v.shown},
                      {"taken", v.taken},
                      {"missed", v.missed},
                      {"counterexample", v.counterexample},
                      {"latency_us", v.latency_us},
                      {"own_bound_us", v.own_bound_us},
                      {"best_found_us", v.best_found_us},
                      {"bound_proven", v.bound_proven},
                      {"worst_found_us", v.worst_found_us},
                      {"executions", v.executions}}
                     .dump(2)
              << "\n";
    return status;
  }
  for (const std::string& lie : v.lies) std::cout << "  LIE    " << lie << "\n";
  for (const std::string& missed : v.missed) std::cout << "  MISSED " << missed << "\n";
  for (const std::string& shown : v.shown) std::cout << "  shown  " << shown << "\n";
  for (const std::string& taken : v.taken) std::cout << "  taken  " << taken << "\n";
  std::cout << (v.truthful() ? fmt::format("\n{} tells the truth.\n", flags.policy)
                             : fmt::format("\n{} lies: {} of its statements are false.\n",
                                           flags.policy, v.lies.size()))
            << words_of_missed(v.missed);
  if (!v.counterexample.empty())
    std::cout << "\n  COUNTEREXAMPLE  " << v.counterexample
              << ".\n  If both are about the same pins, forbids and groups, that bound is false: a "
                 "fault of who proved it.\n  If xauto solve did, report it with app, platform and "
                 "policy.\n";
  return status;
}

}  // namespace

void add_check(Commands& commands) {
  auto flags = std::make_shared<CheckFlags>();
  Verb verb = commands.add("check",
                           "Re-derive every number of a policy; exit status 1 if one of them is "
                           "false, or a deadline, a pin, "
                           "a forbid or a group is missed.",
                           "xauto check --app app.json --platform small --policy policy.json",
                           [flags](const Options& options) { return check(*flags, options); });
  verb.option("--app", flags->app, "app.json").required();
  verb.option("--platform", flags->platform, kPlatformNames).shown();
  verb.option("--policy", flags->policy, "policy.json, or tables.json").required();
  const auto of_attack = [&](const char* option, auto& value, const std::string& help) {
    const Argument argument = verb.option(option, value, help + "; of version 1").shown();
    flags->of_attacks.emplace_back(option, argument);
    return argument;
  };
  of_attack("--executions", flags->options.executions, "random executions against worst_case_us")
      .not_negative();
  of_attack("--proof-nodes", flags->options.proof_nodes, "budget of the proof of lower_bound_us")
      .not_negative();
  add_wishes(verb, flags->wishes);
  verb.option("--against", flags->against,
              "another policy.json of this app: is this one shorter than what it calls a bound?");
  of_attack("--seed", flags->options.seed, "of the attacks");
}

}  // namespace xauto::cli
