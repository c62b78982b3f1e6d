// SPDX-License-Identifier: Apache-2.0
// xauto solve: app.json + platform.json -> policy.json, with a bound and, where possible, a proof.
// Progress goes to stderr: a redrawn line on a terminal, a line every two seconds elsewhere. Ctrl-C
// ends the search and writes the best policy so far.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <iostream>
#include <memory>

#include <fmt/format.h>

#include "model/claims.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/explain.h"
#include "solver/solve.h"

#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/outputs.h"
#include "xauto/periodic.h"
#include "xauto/rare_wcets.h"
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
  std::string app, platform, out;
  Wishes wishes;
  bool what_if = false;
  std::vector<std::string> implement;
  std::string hint;
  std::vector<std::string> assume;
  bool keep = false;
  std::string objective;
  std::string scenarios;
  int tables = 0;
  double regret = 0;
  solver::SolveOptions options;
};

void show(SearchLine& line, const solver::Progress& progress) {
  if (!line.due(progress.elapsed_s)) return;
  line.show(progress.elapsed_s,
            fmt::format("best {}   bound {}   gap {:.2f} %   {:.0f} k evaluations/s",
                        ms(progress.incumbent), ms(progress.bound), progress.gap * 100,
                        progress.evaluations_per_s / 1000));
}

/// The problem as it was asked: keys of app.json, then the command line on top.
Status read_objectives(SolveFlags& flags) {
  XAUTO_ASSIGN(solver::Objectives objectives, load_objectives(flags.app));
  XAUTO_TRY(add_to_objectives(flags.wishes, objectives));
  const bool shaped = !objectives.chains.empty() || !objectives.pins.empty() ||
                      !objectives.forbids.empty() || !objectives.groups.empty();
  if (shaped && flags.options.method != "auto" && flags.options.method != "search")
    return fail(ErrorCode::kInvalid, "chains, pins and groups need --method auto or search",
                "--method " + flags.options.method);
  flags.options.objectives = std::move(objectives);
  return {};
}

const char* words(solver::Feasibility feasibility) {
  switch (feasibility) {
    case solver::Feasibility::kMet:
      return "met";
    case solver::Feasibility::kImpossible:
      return "proven impossible";
    case solver::Feasibility::kUnknown:
      return "missed; not proven impossible";
    default:
      return "none";
  }
}

bool missed(const solver::SolveReport& report) {
  return report.feasibility == solver::Feasibility::kImpossible ||
         report.feasibility == solver::Feasibility::kUnknown;
}

/// One release is one way.
std::vector<RareWcet> rare_in(const AppSpec& app, const Platform& platform, const Policy& policy,
                              const solver::SolveReport& report) {
  Way all{{}, policy.latency_us, missed(report)};
  std::vector<int> xpu;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    all.xnodes.push_back(static_cast<int>(i));
    xpu.push_back(policy.placements[i].xpu);
  }
  return rare_in_policy(app, platform, xpu, {std::move(all)});
}

/// The cases of --what-if and --implement, best first.
Result<std::vector<solver::WhatIf>> ask_what_if(const SolveFlags& flags, const AppSpec& app,
                                                const Platform& platform, const Policy& policy) {
  std::vector<solver::WhatIf> answers;
  solver::SolveOptions options = flags.options;
  options.time_limit_s = std::min(2.0, options.time_limit_s);
  for (const std::string& text : flags.implement) {
    XAUTO_ASSIGN(const auto parsed, parse_assignment(text, "--implement"));
    const std::size_t colon = parsed.second.rfind(':');
    std::int64_t wcet = 0;
    if (colon != std::string::npos) wcet = std::atoll(parsed.second.c_str() + colon + 1);
    if (wcet <= 0 || wcet > kMaxTimeUs)
      return fail(ErrorCode::kInvalid, "'" + text + "' is not of the form XNODE=TYPE:WCET_US",
                  "--implement");
    XAUTO_ASSIGN(solver::WhatIf what,
                 solver::what_if_implemented(app, platform, policy, parsed.first,
                                             parsed.second.substr(0, colon), wcet, options));
    answers.push_back(std::move(what));
  }
  if (!flags.what_if || interrupted.load()) return answers;
  XAUTO_ASSIGN(std::vector<solver::WhatIf> all, solver::what_if(app, platform, policy, options));
  answers.insert(answers.end(), all.begin(), all.end());
  return answers;
}

void print_more(const Policy& policy, const solver::SolveReport& report,
                const std::vector<solver::WhatIf>& answers) {
  if (policy.worst_case_us != policy.latency_us && report.certified_us > 0)
    std::printf(
        "  certified    %12s   with --certify: %+.2f %% latency, and that as the worst case\n",
        ms(report.certified_us).c_str(),
        100 * static_cast<double>(report.certified_us - policy.latency_us) /
            static_cast<double>(std::max<std::int64_t>(1, policy.latency_us)));
  if (report.feasibility != solver::Feasibility::kNotAsked)
    std::printf("  deadlines    %12s   %s\n", "", words(report.feasibility));
  for (const solver::ChainOutcome& chain : report.chains)
    std::printf("  chain %-20s %s%s\n", chain.name.c_str(), ms(chain.latency_us).c_str(),
                chain.deadline_us
                    ? (" of " + ms(*chain.deadline_us) + (chain.met() ? "" : "  MISSED")).c_str()
                    : "");
  if (!answers.empty())
    std::printf("\n  What if ...                              latency       gain\n");
  for (const solver::WhatIf& what : answers)
    std::printf("  %-36s %12s %8.1f %%\n", what.change.c_str(), ms(what.latency_us).c_str(),
                100 * what.gain);
}

void print_json(const AppSpec& app, const Platform& platform, const Policy& policy,
                const solver::SolveReport& report, const std::vector<solver::WhatIf>& answers,
                double reading_ms) {
  Json root = Json::parse(to_json(policy, app, platform)).value_or(Json());
  root["evaluations"] = report.evaluations;
  if (report.first_latency_us > 0)
    root["first_answer"] = {{"latency_us", report.first_latency_us},
                            {"after_ms", reading_ms + report.first_answer_ms}};
  if (report.certified_us > 0) root["certified_us"] = report.certified_us;
  if (report.feasibility != solver::Feasibility::kNotAsked)
    root["deadlines"] = words(report.feasibility);
  for (const solver::ChainOutcome& chain : report.chains)
    root["chains"].push_back({{"name", chain.name},
                              {"latency_us", chain.latency_us},
                              {"lower_bound_us", chain.bound_us},
                              {"met", chain.met()}});
  if (const std::vector<RareWcet> rare = rare_in(app, platform, policy, report); !rare.empty())
    root["rare_wcets"] = to_json(rare, app);
  for (const solver::WhatIf& what : answers)
    root["what_if"].push_back({{"change", what.change},
                               {"latency_us", what.latency_us},
                               {"lower_bound_us", what.lower_bound_us},
                               {"gain", what.gain}});
  std::cout << root.dump(2) << "\n";
}

void print_table(const AppSpec& app, const Platform& platform, const Policy& policy) {
  const auto latency = static_cast<double>(std::max<std::int64_t>(1, policy.latency_us));
  std::printf("%s on %s: %zu XNodes, method %s, %.2f s%s\n\n", app.name.c_str(),
              platform.name.c_str(), app.xnodes.size(), policy.method.c_str(),
              static_cast<double>(policy.solve_ms) / 1000,
              interrupted.load() ? " (interrupted: best so far)" : "");
  std::printf("  XPU        XNodes        load   of latency\n");
  for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
    std::int64_t load = 0;
    int count = 0;
    for (std::size_t i = 0; i < policy.placements.size(); ++i) {
      if (policy.placements[i].xpu != static_cast<int>(x)) continue;
      load += app.xnodes[i].wcet_on(platform.xpus[x].type).value_or(0);
      ++count;
    }
    std::printf("  %-9s %7d %11s %10.1f %%\n", platform.xpus[x].id.c_str(), count, ms(load).c_str(),
                100 * static_cast<double>(load) / latency);
  }
  std::printf("\n  latency      %12s\n", ms(policy.latency_us).c_str());
  std::printf("  lower bound  %12s   %s\n", ms(policy.lower_bound_us).c_str(),
              policy.optimal ? "proven optimal" : "no policy is shorter");
  std::printf("  gap          %10.2f %%\n",
              100 * static_cast<double>(policy.latency_us - policy.lower_bound_us) / latency);
  if (policy.worst_case_us)
    std::printf("  worst case   %12s   of %s%s\n", ms(*policy.worst_case_us).c_str(),
                kWorstCaseScope, policy.order.empty() ? "" : ", kept by run-time order");
  if (policy.worst_case_us && !app.sources.empty() &&
      app.sources.front().period.floor_us() < *policy.worst_case_us)
    std::printf(
        "\n  releases come every %s: those that overlap may take longer than the worst case\n",
        ms(app.sources.front().period.floor_us()).c_str());
}

/// Of version 2.
Result<int> solve_on_and_on(SolveFlags& flags, const AppSpec& app, const Options& options) {
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (flags.wishes.deadline_us > 0)
    return fail(ErrorCode::kInvalid, "is for an app of version 1, one release", "--deadline-us",
                "give the chains of app.json deadlines");
  if (flags.what_if || !flags.implement.empty())
    return fail(ErrorCode::kInvalid, "are for an app of version 1", "--what-if, --implement",
                "ask with --assume");
  solver::steady::Options asked;
  XAUTO_ASSIGN(asked.wishes, load_objectives(flags.app));
  asked.wishes.chains.clear();  // the app's own
  XAUTO_TRY(add_to_objectives(flags.wishes, asked.wishes));
  asked.time_limit_s = flags.options.time_limit_s;
  asked.threads = flags.options.threads;
  asked.seed = flags.options.seed;
  asked.max_evaluations = flags.options.max_evaluations;
  KeyPolicy hint;
  if (!flags.hint.empty()) {
    XAUTO_ASSIGN(hint, load_key_hint(flags.hint, app, platform));
    asked.hint = &hint;
  }
  if (flags.keep && flags.hint.empty())
    return fail(ErrorCode::kInvalid, "keeps what a policy says", "--keep",
                "name the policy: --hint policy.json");
  if (flags.keep) asked.keep = solver::steady::Keep::kMost;
  asked.method = flags.options.method;
  asked.aim = solver::steady::usual_aim(app);
  if (flags.objective == "largest") asked.aim = solver::steady::Aim::kLargest;
  if (flags.objective == "sum") asked.aim = solver::steady::Aim::kSum;
  asked.stop = &interrupted;
  stop_on_interrupt();
  return solve_periodic(app, platform, asked, flags.assume, flags.out, options);
}

/// Several policies: --scenarios.
Result<int> solve_tables(SolveFlags& flags, const AppSpec& app, const Options& options) {
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (app.version == 1) {
    XAUTO_TRY(read_objectives(flags));
  } else {
    XAUTO_ASSIGN(flags.options.objectives, load_objectives(flags.app));
    flags.options.objectives.chains.clear();  // the app's own
    XAUTO_TRY(add_to_objectives(flags.wishes, flags.options.objectives));
  }
  const solver::Objectives& asked = flags.options.objectives;
  if (!asked.chains.empty() || !asked.pins.empty() || !asked.forbids.empty() ||
      !asked.groups.empty() || asked.deadline_us)
    return fail(ErrorCode::kInvalid,
                "chains, pins, forbids, groups and --deadline-us are not known", "--scenarios",
                "take them out of app.json");
  if (flags.options.method != "auto" || flags.what_if || !flags.implement.empty() ||
      !flags.hint.empty() || flags.keep || !flags.assume.empty() || !flags.objective.empty())
    return fail(ErrorCode::kInvalid,
                "does not go with --method, --what-if, --implement, --hint, --keep, --assume and "
                "--objective",
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
  return solve_with_tables(app, platform, flags.scenarios, tables, flags.out, options);
}

Result<int> solve(SolveFlags& flags, const Options& options) {
  const auto began = std::chrono::steady_clock::now();
  XAUTO_ASSIGN(const AppSpec app, load_any_app(flags.app));
  if (!flags.scenarios.empty()) return solve_tables(flags, app, options);
  if (flags.tables > 0 || flags.regret > 0)
    return fail(ErrorCode::kInvalid, "are for several scenarios", "--tables, --regret",
                "name them: --scenarios scenarios.json");
  if (app.version == 2) return solve_on_and_on(flags, app, options);
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  if (!flags.hint.empty() || flags.keep || !flags.assume.empty() || !flags.objective.empty())
    return fail(ErrorCode::kInvalid, "are for an app of version 2",
                "--hint, --keep, --assume, --objective");
  XAUTO_TRY(read_objectives(flags));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  solver::SolveReport report;
  flags.options.report = &report;
  SearchLine line;
  flags.options.stop = &interrupted;
  flags.options.on_progress = [&](const solver::Progress& progress) { show(line, progress); };
  stop_on_interrupt();
  const double reading_ms =
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - began).count();
  const auto solved = solver::solve(app, platform, flags.options);
  line.end();
  if (!solved) return tl::unexpected<Error>(solved.error());
  const Policy& policy = *solved;
  XAUTO_ASSIGN(const auto answers, ask_what_if(flags, app, platform, policy));
  if (options.json) {
    print_json(app, platform, policy, report, answers, reading_ms);
  } else {
    print_table(app, platform, policy);
    print_more(policy, report, answers);
    std::fputs(words_of(rare_in(app, platform, policy, report), app).c_str(), stdout);
  }
  std::fflush(stdout);
  if (!flags.out.empty()) outputs.write(flags.out, to_json(policy, app, platform));
  if (!options.json && !flags.out.empty() && outputs.good())
    std::printf("\n  written to %s\n", flags.out.c_str());
  return outputs.status(missed(report) ? kAnswerIsNo : kDone);
}

}  // namespace

void add_solve(Commands& commands) {
  auto flags = std::make_shared<SolveFlags>();
  Verb verb = commands.add(
      "solve", "Choose an XPU and a priority for every XNode so that the app ends soonest.",
      "xauto solve --app app.json --platform small --time-limit-s 10 --out policy.json",
      [flags](const Options& options) { return solve(*flags, options); });
  verb.option("--app", flags->app, "app.json").required();
  verb.option("--platform", flags->platform, kPlatformNames).required();
  verb.option("--out", flags->out, "where policy.json goes");
  verb.option("--method", flags->options.method, "how")
      .one_of({"auto", "search", "ilp", "heft", "local"})
      .shown();
  verb.option("--time-limit-s", flags->options.time_limit_s, "end after this long")
      .not_negative()
      .shown();
  flags->options.threads = 2;
  verb.option("--threads", flags->options.threads, "solving threads").range(1, 64).shown();
  verb.option("--seed", flags->options.seed, "of the search").shown();
  verb.option("--max-evaluations", flags->options.max_evaluations,
              "end after this many schedules; the answer then depends on seed and threads only")
      .not_negative();
  verb.flag("--certify", flags->options.certify,
            "minimise the certified worst case: run-time order in every case");
  add_wishes(verb, flags->wishes);
  verb.flag("--what-if", flags->what_if,
            "what one more XPU, or another implementation on the chain that limits, would gain");
  verb.option(
      "--hint", flags->hint,
      "version 2: a policy.json of this app, or of an earlier version of it, to begin with");
  verb.option(
      "--assume", flags->assume,
      "version 2: what would be if SOURCE=HZ, TYPE=PERCENT% of its WCETs, or +TYPE one more");
  verb.flag("--keep", flags->keep,
            "version 2: with --hint, as few XNodes as possible move to another XPU");
  verb.option("--objective", flags->objective,
              "version 2: minimise the largest worst case / deadline, or their weighted sum, "
              "alone; default: the sum, the largest within 5 % of the least")
      .one_of({"largest", "sum"});
  verb.option("--scenarios", flags->scenarios,
              "scenarios.json: several policies, one of which serves each scenario");
  verb.option("--tables", flags->tables, "with --scenarios: at most so many policies")
      .range(1, static_cast<int>(kMaxTables));
  verb.option("--regret", flags->regret,
              "with --scenarios: the fewest policies whose worst cases are at most so many times "
              "the lower bounds")
      .range(1.0, 1000.0);
  verb.option("--implement", flags->implement,
              "XNODE=TYPE:WCET_US: what this implementation would gain");
}

}  // namespace xauto::cli
