// SPDX-License-Identifier: Apache-2.0
// xauto check: is every number of a policy.json true, and does it do what was asked for (pins,
// groups, deadlines)? Exit status 1 and each lie or miss by name if not.
#include <algorithm>
#include <memory>

#include "model/json.h"
#include "model/json_value.h"

#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/policies.h"
#include "xauto/tables.h"

namespace xauto::cli {
namespace {

struct CheckFlags {
  std::vector<std::string> apps, policies;
  std::string platform, demand_out;
  BesideFlags beside;
  Wishes wishes;
};

Result<int> check(const CheckFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const Apps apps, load_apps(flags.apps));
  XAUTO_ASSIGN(const Platform platform, load_platform_of_all(flags.policies, flags.platform));
  if (const auto tables = std::ranges::find_if(flags.policies, is_tables_file);
      tables != flags.policies.end()) {
    if (flags.wishes.given())
      return fail(ErrorCode::kInvalid, "are for a policy.json", "--pin, --forbid, --group",
                  "leave them out: tables keep none");
    if (apps.several() || flags.policies.size() > 1 || flags.beside.given() ||
        !flags.demand_out.empty())
      return fail(ErrorCode::kInvalid, "is tables: of their changes nothing is known beside others",
                  *tables, "check it alone, or a policy.json");
    return check_tables(apps.all, platform, *tables, options);
  }
  XAUTO_ASSIGN(solver::Objectives asked, load_objectives_of(apps, flags.apps));
  XAUTO_TRY(add_to_objectives(flags.wishes, asked));
  return check_policy(apps, platform, flags.policies, asked, flags.beside, flags.demand_out,
                      options);
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
  verb.option("--app", flags->apps, "app.json; several: they are on one machine").required();
  verb.option("--platform", flags->platform, kPlatformNames).shown_as("the policy's");
  verb.option("--policy", flags->policies, "policy.json, one for each --app; or tables.json")
      .required();
  add_beside(verb, flags->beside);
  verb.option("--demand-out", flags->demand_out,
              "demand.json: what others have to know to be planned beside it");
  add_wishes(verb, flags->wishes);
}

}  // namespace xauto::cli
