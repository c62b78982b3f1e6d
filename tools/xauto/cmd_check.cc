// SPDX-License-Identifier: Apache-2.0
// xauto check: is every number of a policy.json true, and does it do what was asked for (pins,
// groups, deadlines)? Exit status 1 and each lie or miss by name if not.
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "model/json.h"
#include "model/json_value.h"

#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/policies.h"
#include "xauto/tables.h"

namespace xauto::cli {
namespace {

struct CheckFlags {
  std::string app, platform, policy;
  Wishes wishes;
};

Result<int> check(const CheckFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform_of(flags.policy, flags.platform));
  if (is_tables_file(flags.policy)) {
    if (flags.wishes.given())
      return fail(ErrorCode::kInvalid, "are for a policy.json", "--pin, --forbid, --group",
                  "leave them out: tables keep none");
    return check_tables(app, platform, flags.policy, options);
  }
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
                           "xauto check --app app.json --policy policy.json",
                           [flags](const Options& options) { return check(*flags, options); });
  verb.option("--app", flags->app, "app.json").required();
  verb.option("--platform", flags->platform, kPlatformNames).shown_as("the policy's");
  verb.option("--policy", flags->policy, "policy.json, or tables.json").required();
  add_wishes(verb, flags->wishes);
}

}  // namespace xauto::cli
