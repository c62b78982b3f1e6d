// SPDX-License-Identifier: Apache-2.0
// xauto simulate: what a policy does, to the microsecond, without running anything.
#include <memory>

#include "solver/simulate.h"

#include "xauto/command.h"
#include "xauto/outputs.h"
#include "xauto/policies.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct SimulateFlags {
  std::vector<std::string> apps, policies;
  std::string platform, out;
  solver::keys::PlayOptions play;
};

Result<int> simulate(const SimulateFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const Apps apps, load_apps(flags.apps));
  XAUTO_ASSIGN(const Platform platform, load_platform_of_all(flags.policies, flags.platform));
  return simulate_policy(apps, platform, flags.policies, flags.play, flags.out, options);
}

}  // namespace

void add_simulate(Commands& commands) {
  auto flags = std::make_shared<SimulateFlags>();
  Verb verb = commands.add("simulate", "Play a policy in virtual time, to the microsecond.",
                           "xauto simulate --app app.json --policy policy.json",
                           [flags](const Options& options) { return simulate(*flags, options); });
  verb.option("--app", flags->apps, "app.json; several: they are on one machine").required();
  verb.option("--platform", flags->platform, kPlatformNames).shown_as("the policy's");
  verb.option("--policy", flags->policies, "policy.json; one for each --app").required();
  verb.option("--out", flags->out, "write the result here");
  verb.duration("--duration", flags->play.seconds, Unit::kSeconds, 1, 86400, "how long");
  verb.flag("--random-times", flags->play.random_times, "execution times up to the WCET");
  verb.flag("--jitter", flags->play.jitter, "each source as late as it may be, at random");
  verb.flag("--phases", flags->play.phases,
            "between clocks at random, and clocks drift: constantly, at the ends of "
            "their ppm, bending");
  verb.flag("--urgent", flags->play.urgent,
            "releases that may be urgent are, or are not, at random");
  verb.option("--seed", flags->play.seed, "of all that is random").shown();
}

}  // namespace xauto::cli
