// SPDX-License-Identifier: Apache-2.0
// xauto solve: app.json + platform.json -> policy.json, with a bound and, where possible, a proof.
// Progress goes to stderr: a redrawn line on a terminal, a line every two seconds elsewhere. Ctrl-C
// ends the search and writes the best policy so far.
#include <atomic>
#include <csignal>
#include <memory>

#include "model/json.h"
#include "solver/keys/solve.h"

#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/policies.h"
#include "xauto/tables.h"

namespace xauto::cli {
namespace {

std::atomic<bool> interrupted{false};

extern "C" void on_interrupt(int) {
  interrupted.store(true);
}
/// The second Ctrl-C, and the second SIGTERM, end the program at once. What waits in the kernel meanwhile, for who
/// reads a pipe that is written to, goes on with an error.
void stop_on_interrupt() {
  struct sigaction action = {};
  action.sa_handler = on_interrupt;
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

struct SolveFlags {
  std::vector<std::string> apps, outs;
  std::string platform, demand_out, hint, objective, scenarios;
  Wishes wishes;
  BesideFlags beside;
  std::vector<std::string> assume;
  int tables = 0;
  double regret = 0;
  solver::keys::Options options;
};

/// Several policies: --scenarios.
Result<int> solve_tables(const SolveFlags& flags, const AppSpec& app, const Platform& platform,
                         const Options& options) {
  const solver::Objectives& asked = flags.options.wishes;
  if (!asked.pins.empty() || !asked.forbids.empty() || !asked.groups.empty())
    return fail(ErrorCode::kInvalid, "pins, forbids and groups are not known", "--scenarios",
                "take them out of app.json");
  if (flags.options.method != "auto" || !flags.hint.empty() || !flags.assume.empty() ||
      !flags.objective.empty())
    return fail(ErrorCode::kInvalid, "does not go with --method, --hint, --assume and --objective",
                "--scenarios");
  if (flags.tables <= 0 && flags.regret < 1)
    return fail(ErrorCode::kInvalid, "needs --tables or --regret", "--scenarios",
                "how many policies may there be, or how much longer than the bound may each take?");
  solver::TablesOptions tables;
  tables.tables = flags.tables;
  tables.regret = flags.regret;
  tables.time_limit_s = flags.options.time_limit_s;
  tables.max_evaluations = flags.options.max_evaluations;
  tables.threads = flags.options.threads;
  tables.seed = flags.options.seed;
  tables.stop = &interrupted;
  stop_on_interrupt();
  return solve_with_tables(app, platform, flags.scenarios, tables,
                           flags.outs.empty() ? "" : flags.outs.front(), options);
}

/// What goes with one policy of keys alone, and that of one app.
Status refuse_together(const SolveFlags& flags, const Apps& apps) {
  const bool together = apps.several() || flags.beside.given() || !flags.demand_out.empty();
  const std::string what =
      apps.several() ? "several --app" : "--beside, --reserve and --demand-out";
  if (!flags.scenarios.empty() && together)
    return fail(ErrorCode::kInvalid, "does not go with " + what, "--scenarios",
                "of changes of tables nothing is known beside others");
  if (flags.options.method != "auto" && together)
    return fail(ErrorCode::kInvalid, "does not go with " + what, "--method",
                "leave it out: only a policy of keys has claims beside others");
  if (!flags.hint.empty() && apps.several())
    return fail(ErrorCode::kInvalid, "does not go with " + what, "--hint",
                "leave it out, or solve one app beside the others' demands");
  if (!flags.assume.empty() && flags.beside.given())
    return fail(ErrorCode::kInvalid, "does not go with --beside and --reserve", "--assume",
                "leave it out: changes are looked at for the app alone");
  if (apps.all.one_at_a_time && !flags.demand_out.empty())
    return fail(ErrorCode::kInvalid,
                "sources without a rate release as soon as they can: no demand bounds that",
                "--demand-out", "state how often they release at most: rate_hz");
  return one_for_each(apps, flags.outs, "--out");
}

Result<int> solve(const SolveFlags& flags, const Options& options) {
  XAUTO_ASSIGN(const Apps apps, load_apps(flags.apps));
  const AppSpec& app = apps.all;
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  XAUTO_TRY(refuse_together(flags, apps));
  SolveFlags read = flags;
  solver::keys::Options& asked = read.options;
  XAUTO_ASSIGN(asked.wishes, load_objectives_of(apps, flags.apps));
  XAUTO_ASSIGN(asked.beside, load_beside(flags.beside, platform));
  XAUTO_TRY(add_to_objectives(flags.wishes, asked.wishes));
  if (!flags.scenarios.empty()) return solve_tables(read, app, platform, options);
  if (flags.tables > 0 || flags.regret > 0)
    return fail(ErrorCode::kInvalid, "are for several scenarios", "--tables, --regret",
                "name them: --scenarios scenarios.json");
  const bool of_priorities = asked.method == "heft" || asked.method == "local";
  if (of_priorities && (!flags.assume.empty() || !flags.hint.empty() || !flags.objective.empty()))
    return fail(ErrorCode::kInvalid, "has neither --assume, --hint nor --objective",
                "--method " + asked.method, "leave them out");
  Policy hint;
  if (!flags.hint.empty()) {
    XAUTO_ASSIGN(hint, load_key_hint(flags.hint, app, platform));
    asked.hint = &hint;
  }
  asked.aim = solver::keys::usual_aim(app);
  if (flags.objective == "largest") asked.aim = solver::keys::Aim::kLargest;
  if (flags.objective == "sum") asked.aim = solver::keys::Aim::kSum;
  asked.stop = &interrupted;
  stop_on_interrupt();
  return solve_policy(apps, platform, asked, flags.assume, {flags.outs, flags.demand_out}, options);
}

}  // namespace

void add_solve(Commands& commands) {
  auto flags = std::make_shared<SolveFlags>();
  Verb verb = commands.add(
      "solve",
      "Choose an XPU, and an instant to be done by, for every XNode; each chain has a proven worst "
      "case.",
      "xauto solve --app app.json --platform small --time-limit 10s --out policy.json",
      [flags](const Options& options) { return solve(*flags, options); });
  verb.option("--app", flags->apps, "app.json; several: for one machine, each with its claims")
      .required();
  verb.option("--platform", flags->platform, kPlatformNames).required();
  verb.option("--out", flags->outs, "where policy.json goes; one for each --app");
  verb.option(
          "--method", flags->options.method,
          "how; search and ilp plan one release, where no source has a rate; heft and local give "
          "priorities, of which nothing is claimed")
      .one_of({"auto", "search", "ilp", "heft", "local"})
      .shown();
  verb.duration("--time-limit", flags->options.time_limit_s, Unit::kSeconds, 0, kYearS,
                "end after this long");
  flags->options.threads = 2;
  verb.option("--threads", flags->options.threads, "solving threads").range(1, 64).shown();
  verb.option("--seed", flags->options.seed, "of the search").shown();
  verb.option("--max-evaluations", flags->options.max_evaluations,
              "end after this many schedules; the answer then depends on seed and threads only")
      .not_negative();
  add_wishes(verb, flags->wishes);
  add_beside(verb, flags->beside);
  verb.option("--demand-out", flags->demand_out,
              "demand.json: what others have to know to be planned beside it");
  verb.option("--hint", flags->hint,
              "a policy.json of this app, or of an earlier version of it, to begin with");
  verb.option("--assume", flags->assume,
              "what would be if SOURCE=HZ, TYPE=PERCENT% of its WCETs, or +TYPE one more");
  verb.option(
          "--objective", flags->objective,
          "minimise the largest worst case / deadline, or their weighted sum, alone; default: "
          "the sum, the largest within 5 % of the least; where no source has a rate, the largest")
      .one_of({"largest", "sum"});
  verb.option("--scenarios", flags->scenarios,
              "scenarios.json: several policies, one of which serves each scenario");
  verb.option("--tables", flags->tables, "with --scenarios: at most so many policies")
      .range(1, static_cast<int>(kMaxTables));
  verb.option("--regret", flags->regret,
              "with --scenarios: the fewest policies whose worst cases are at most so many times "
              "the lower bounds")
      .range(1.0, 1000.0);
}

}  // namespace xauto::cli
