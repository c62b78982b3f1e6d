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
#include "xauto/policies.h"
#include "xauto/tables.h"

namespace xauto::cli {
namespace {

struct CheckFlags {
  std::string app, platform = "small", policy;
  solver::VerifyOptions options;
  Wishes wishes;
  /// What only attacks on tables of priorities take: option, argument.
  std::vector<std::pair<const char*, Argument>> of_attacks;
};

Status no_attacks(const CheckFlags& flags) {
  for (const auto& [option, argument] : flags.of_attacks)
    if (argument.given())
      return fail(
          ErrorCode::kInvalid, "is for tables of an app whose sources have no rate", option,
          "leave it out: the check derives everything, and plays nothing; `xauto simulate` does");
  return {};
}

Result<int> check(const CheckFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (is_tables_file(flags.policy)) {
    if (flags.wishes.given())
      return fail(ErrorCode::kInvalid, "are for a policy.json", "--pin, --forbid, --group",
                  "leave them out: tables keep none");
    if (!app.one_at_a_time) XAUTO_TRY(no_attacks(flags));
    return check_tables(app, platform, flags.policy, flags.options, options);
  }
  XAUTO_TRY(no_attacks(flags));
  XAUTO_ASSIGN(solver::Objectives asked, load_objectives(flags.app));
  XAUTO_TRY(add_to_objectives(flags.wishes, asked));
  return check_policy(app, platform, flags.policy, asked, options);
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
    const Argument argument =
        verb.option(option, value, help + "; of tables without rates").shown();
    flags->of_attacks.emplace_back(option, argument);
    return argument;
  };
  of_attack("--executions", flags->options.executions, "random executions against worst_case_us")
      .not_negative();
  of_attack("--proof-nodes", flags->options.proof_nodes, "budget of the proof of lower_bound_us")
      .not_negative();
  add_wishes(verb, flags->wishes);
  of_attack("--seed", flags->options.seed, "of the attacks");
}

}  // namespace xauto::cli
