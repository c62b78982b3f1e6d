// SPDX-License-Identifier: Apache-2.0
// xauto profile: times each XNode alone on each XPU; profile.json, and the app.json that follows.
#include <algorithm>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>

#include <fmt/format.h>

#include "base/log.h"
#include "model/json.h"
#include "model/periodic.h"

#include "xauto/command.h"
#include "xauto/emulation.h"
#include "xauto/outputs.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct ProfileFlags {
  std::string platform = "small", input, deployment, out, app_out, from = "wcet", read;
  std::uint64_t warmup = 3, repetitions = 30;
  std::int64_t margin_pct = 20, exec_limit_s = 30;
  int app_version = 1;
  bool stable = false;
  std::optional<Argument> repetitions_given;
  EmulationOptions emulation;
  std::vector<std::string> command, merge;
};

/// Further rounds of repetitions with --stable, at most: docs/formats.md, profile.json.
constexpr std::uint64_t kStableRounds = 10;

const char* conditions_of(const Profile& profile) {
  if (!profile.conditions.emulated) return "";
  for (const XNodeProfile& x : profile.xnodes)
    for (const auto& [id, samples] : x.on)
      if (!samples.emulated) return " (emulated, real where it says so)";
  return " (emulated)";
}

/// Wide spreads and what became of them, and what is not there: a line each.
std::vector<std::string> remarks(const Profile& profile, const Platform& platform) {
  std::vector<std::string> lines;
  const auto below = profile.conditions.repetitions;
  for (const XNodeProfile& x : profile.xnodes) {
    for (const Xpu& xpu : platform.xpus) {
      const auto at = x.on.find(xpu.id);
      if (at == x.on.end()) continue;
      const Samples& s = at->second;
      const std::string where = x.name + " on " + xpu.id;
      const double times =
          static_cast<double>(s.max_us) / static_cast<double>(std::max<std::int64_t>(1, s.p50_us));
      if (s.outlier)
        lines.push_back(fmt::format(
            "{}: outlier: repetition {} took {} us{}, and none of the {} after that more than "
            "twice "
            "the median; the WCET is from the others' maximum, {} us",
            where, s.max_at, s.max_us,
            s.outlier->count > 1 ? fmt::format(" (one of {} so long)", s.outlier->count) : "",
            s.outlier->later_count, s.outlier->max_us));
      else if (s.spread() && s.count > below)
        lines.push_back(
            fmt::format("{}: repetition {} took {} us, {:.1f} times the median, and such times "
                        "came back within "
                        "{} repetitions: the WCET is from the maximum of all",
                        where, s.max_at, s.max_us, times, s.count));
      else if (s.spread())
        lines.push_back(fmt::format(
            "{}: repetition {} of {} took {} us, {:.1f} times the median, and becomes the WCET; "
            "--stable repeats until it is seen whether that comes back",
            where, s.max_at, s.count, s.max_us, times));
      if (!profile.incomplete.empty() && s.count < below)
        lines.push_back(fmt::format("{}: {} of {} repetitions", where, s.count, below));
    }
    for (const std::string& xpu : x.missing)
      lines.push_back(fmt::format("{} on {}: not measured", x.name, xpu));
  }
  return lines;
}

std::string table(const Profile& profile, const Platform& platform) {
  std::string out =
      fmt::format("{} on {}{}: execution times in us, {} repetitions after {} warm-up\n\n",
                  profile.app, platform.name, conditions_of(profile),
                  profile.conditions.repetitions, profile.conditions.warmup);
  out += fmt::format("  {:<24}{:<8}{:>9}{:>9}{:>9}{:>9}{:>10}{:>6}\n", "XNode", "XPU", "min", "p50",
                     "p99", "max", "WCET", "n");
  for (const XNodeProfile& x : profile.xnodes) {
    std::string name = x.name;
    for (const Xpu& xpu : platform.xpus) {
      const auto at = x.on.find(xpu.id);
      if (at == x.on.end()) continue;
      const Samples& s = at->second;
      out += fmt::format("  {:<24}{:<8}{:>9}{:>9}{:>9}{:>9}{:>10}{:>6}{}\n", name, xpu.id, s.min_us,
                         s.p50_us, s.count < kP99Samples ? "-" : std::to_string(s.p99_us), s.max_us,
                         statistic(s, WcetFrom::kMaxPlusMargin, profile.margin_pct), s.count,
                         profile.conditions.emulated && !s.emulated ? "  real" : "");
      name.clear();
    }
  }
  out += fmt::format("\n  WCET: max + {} %\n", profile.margin_pct);
  for (const std::string& line : remarks(profile, platform)) out += "  " + line + "\n";
  if (!profile.incomplete.empty()) out += "  incomplete: " + profile.incomplete + "\n";
  return out;
}

/// Runs the app and times it.
Result<Profile> measure(const ProfileFlags& flags, const Platform& platform) {
  launch::Supervision request;
  runtime::Session& session = request.session;
  session.mode = runtime::Mode::kProfile;
  session.platform = platform;
  XAUTO_ASSIGN(session.presence, flags.emulation.decide(platform, nullptr));
  session.input = flags.input;
  if (!flags.deployment.empty()) {
    XAUTO_ASSIGN(session.deployment, load_deployment(flags.deployment));
  }
  session.warmup = flags.warmup;
  session.repetitions = flags.repetitions;
  session.margin_pct = flags.margin_pct;
  session.exec_limit_s = flags.exec_limit_s;
  session.stable_rounds = flags.stable ? kStableRounds : 0;
  request.command = flags.command;
  const StopOnSignal stop;
  request.stop = stop.flag();
  Progress progress("profile", 0);
  request.on_tick = [&](double elapsed_s, const runtime::Board*) {
    progress.update(elapsed_s, fmt::format("{:.0f} s", elapsed_s));
  };
  XAUTO_ASSIGN(const launch::Outcome outcome, launch::supervise(std::move(request)));
  progress.finish();
  auto result = parse_profile(outcome.answer, "answer of the app");
  // What is no profile may be an error of the app's: that is the one to tell.
  if (!result) XAUTO_TRY(runtime::parse_run_report(outcome.answer));
  return result;
}

WcetFrom from_of(const ProfileFlags& flags) {
  return flags.from == "p50"   ? WcetFrom::kP50
         : flags.from == "p99" ? WcetFrom::kP99
                               : WcetFrom::kMaxPlusMargin;
}

/// Profiles, each made at other clocks or beside other work, to scenarios.json.
Result<int> merge(const ProfileFlags& flags, const Options& options) {
  if (!flags.read.empty() || !flags.command.empty() || !flags.app_out.empty())
    return fail(ErrorCode::kInvalid, "measures nothing: leave out the app, --read and --app-out",
                "--merge");
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  std::vector<NamedProfile> profiles;
  for (const std::string& path : flags.merge) {
    XAUTO_ASSIGN(Profile one, load_profile(path));
    profiles.push_back({std::filesystem::path(path).stem().string(), std::move(one)});
    const ProfileConditions &c = profiles.back().profile.conditions,
                            &first = profiles.front().profile.conditions;
    if (c.machine != first.machine || c.input != first.input)
      log::warn("{}: measured on '{}' with input '{}', the first one on '{}' with '{}'", path,
                c.machine, c.input, first.machine, first.input);
  }
  XAUTO_ASSIGN(const Scenarios scenarios, scenarios_of(profiles, platform, from_of(flags)));
  const std::string text = to_json(scenarios);
  if (options.json || flags.out.empty()) std::cout << text;
  outputs.write(flags.out, text);
  if (!options.json && !flags.out.empty() && outputs.good())
    std::cout << fmt::format(
        "{}: {} scenarios of app '{}'; `xauto solve --scenarios {}` plans for them\n", flags.out,
        scenarios.list.size(), scenarios.app, flags.out);
  return outputs.status(kDone);
}

Result<int> profile(const ProfileFlags& given, const Options& options) {
  ProfileFlags flags = given;
  if (!flags.merge.empty()) return merge(flags, options);
  if (flags.read.empty() == flags.command.empty())
    return fail(ErrorCode::kInvalid, "give either an app to run, after --, or --read profile.json");
  if (flags.from == "p99" && flags.read.empty()) {
    if (!flags.repetitions_given->given()) flags.repetitions = kP99Samples;
    if (flags.repetitions < static_cast<std::uint64_t>(kP99Samples))
      return fail(
          ErrorCode::kInvalid,
          fmt::format("{} repetitions have no p99: it takes {}", flags.repetitions, kP99Samples),
          "--repetitions", "leave --repetitions out, or use --from wcet");
  }
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_TRY(outputs.expect("--app-out", flags.app_out));
  auto result = flags.read.empty() ? measure(flags, platform) : load_profile(flags.read);
  if (!result) return tl::unexpected<Error>(std::move(result).error());
  const std::string text = to_json(*result);
  if (options.json) {
    std::cout << text;
    for (const std::string& line : remarks(*result, platform)) log::warn("{}", line);
  } else {
    std::cout << table(*result, platform);
  }
  outputs.write(flags.out, text);
  if (!flags.app_out.empty()) {
    auto app = to_app(*result, platform, from_of(flags));
    if (app && flags.app_version == 2) {
      if (auto periodic = as_version_2(*app)) {
        app = std::move(periodic);
        for (const SourceSpec& source : result->sources)
          if (source.pushed)
            log::warn(
                "{}: source '{}' is pushed, and its grid was not measured: period_us {} is the "
                "least distance that the app states, offset_us and jitter_us are taken as 0; a "
                "worst case holds only if release k comes at offset + k period, at most jitter "
                "later: write there what the driver does",
                flags.app_out, source.name, source.period.num);
      } else
        log::warn("{} is of version 1: {}", flags.app_out, periodic.error().to_string());
    }
    if (app)
      outputs.write(flags.app_out, to_json(*app));
    else if (result->incomplete.empty())
      return tl::unexpected<Error>(app.error());
    else
      log::error("{} is not written: {}", flags.app_out, app.error().to_string());
  }
  if (result->incomplete.empty()) return outputs.status(kDone);
  log::error("the profile is incomplete: {}", result->incomplete);
  return outputs.status(kAnswerIsNo);
}

}  // namespace

void add_profile(Commands& commands) {
  auto flags = std::make_shared<ProfileFlags>();
  Verb verb = commands.add(
      "profile", "Time each XNode of an app alone on each XPU that it can run on.",
      "xauto profile --platform small --input drive.mcap --out profile.json --app-out app.json -- "
      "build/bin/driving",
      [flags](const Options& options) { return profile(*flags, options); });
  verb.option("--platform", flags->platform, kPlatformNames).shown();
  verb.option("--input", flags->input,
              "recorded input (rosbag2: .mcap, .db3, a folder); default: the app's own messages");
  verb.option("--deployment", flags->deployment,
              "deployment.json: its instances, names of topics, and values of parameters");
  verb.option("--warmup", flags->warmup, "releases that are not counted").range(0, 100000).shown();
  flags->repetitions_given =
      verb.option("--repetitions", flags->repetitions,
                  "releases that are counted; with --from p99 100 unless it says more")
          .range(1, 1000000)
          .shown();
  verb.flag("--stable", flags->stable,
            "where the maximum is above twice the median, repeat until it is seen whether such "
            "times come back; one that does not is reported, and does not make the WCET");
  verb.option("--exec-limit-s", flags->exec_limit_s,
              "an exec that takes longer ends the profile; what was measured is written")
      .range(std::int64_t{1}, std::int64_t{1'000'000})
      .shown();
  verb.option("--margin-pct", flags->margin_pct, "WCET = max + this much").range(0, 1000).shown();
  verb.option("--from", flags->from,
              "what becomes the WCET in app.json: wcet (max + margin), p99, p50")
      .one_of({"wcet", "p99", "p50"})
      .shown();
  verb.option("--out", flags->out, "write profile.json here");
  verb.option("--app-out", flags->app_out, "write the app.json that follows here");
  verb.option("--app-version", flags->app_version,
              "of that app.json: 1, one release, which solve and run take; 2, releases on and on, "
              "where each part that edges join has one period")
      .range(1, 2)
      .shown();
  flags->emulation.declare(verb);
  verb.option("--read", flags->read,
              "an existing profile.json instead of measuring, e.g. for --app-out");
  verb.option(
      "--merge", flags->merge,
      "profiles of one app, made under different conditions: write scenarios.json to --out, "
      "a scenario for each, named as its file");
  verb.option("command", flags->command, "the app's program and its arguments, after --");
}

}  // namespace xauto::cli
