// SPDX-License-Identifier: Apache-2.0
// xauto profile: times each XNode alone on each XPU; profile.json, and the app.json that follows.
#include <iostream>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/log.h"
#include "model/json.h"

#include "xauto/command.h"
#include "xauto/outputs.h"
#include "xauto/priorities.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct Flags {
  std::string platform = "small", input, out, app_out, from = "wcet", read;
  std::uint64_t warmup = 3, repetitions = 30;
  std::int64_t margin_pct = 20;
  bool emulate = false, real = false;
  std::vector<std::string> command;
};

std::string table(const Profile& profile, const Platform& platform) {
  std::string out =
      fmt::format("{} on {}{}: execution times in us, {} repetitions after {} warm-up\n\n",
                  profile.app, platform.name, profile.conditions.emulated ? " (emulated)" : "",
                  profile.conditions.repetitions, profile.conditions.warmup);
  out += fmt::format("  {:<24}{:<8}{:>9}{:>9}{:>9}{:>9}{:>10}{:>6}\n", "XNode", "XPU", "min", "p50",
                     "p99", "max", "WCET", "n");
  for (const XNodeProfile& x : profile.xnodes) {
    std::string name = x.name;
    for (const Xpu& xpu : platform.xpus) {
      const auto at = x.on.find(xpu.id);
      if (at == x.on.end()) continue;
      const Samples& s = at->second;
      out += fmt::format("  {:<24}{:<8}{:>9}{:>9}{:>9}{:>9}{:>10}{:>6}\n", name, xpu.id, s.min_us,
                         s.p50_us, s.p99_us, s.max_us,
                         s.max_us + (s.max_us * profile.margin_pct + 99) / 100, s.count);
      name.clear();
    }
  }
  return out + fmt::format("\n  WCET: max + {} %\n", profile.margin_pct);
}

/// Runs the app and times it.
Result<Profile> measure(const Flags& flags, const Platform& platform) {
  runtime::Supervision request;
  runtime::Session& session = request.session;
  session.mode = runtime::Mode::kProfile;
  session.platform = platform;
  const std::string missing = runtime::needs_emulation(session.platform);
  if (flags.real && !missing.empty())
    return fail(ErrorCode::kUnavailable, missing, "--real", "drop --real to emulate the platform");
  session.emulated = flags.emulate || !missing.empty();
  session.fifo_lowest = granted().lowest;
  session.fifo_why = granted().why;
  session.input = flags.input;
  session.warmup = flags.warmup;
  session.repetitions = flags.repetitions;
  session.margin_pct = flags.margin_pct;
  request.command = flags.command;
  const StopOnSignal stop;
  request.stop = stop.flag();
  Progress progress("profile", 0);
  request.on_tick = [&](double elapsed_s, const runtime::Board*) {
    progress.update(elapsed_s, fmt::format("{:.0f} s", elapsed_s));
  };
  XAUTO_ASSIGN(const runtime::Outcome outcome, runtime::supervise(std::move(request)));
  progress.finish();
  auto result = parse_profile(outcome.answer, "answer of the app");
  // What is no profile may be an error of the app's: that is the one to tell.
  if (!result) XAUTO_TRY(runtime::parse_run_report(outcome.answer));
  return result;
}

Result<int> profile(const Flags& flags, const Options& options) {
  if (flags.read.empty() == flags.command.empty())
    return fail(ErrorCode::kInvalid, "give either an app to run, after --, or --read profile.json");
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_TRY(outputs.expect("--app-out", flags.app_out));
  auto result = flags.read.empty() ? measure(flags, platform) : load_profile(flags.read);
  if (!result) return tl::unexpected<Error>(std::move(result).error());
  const std::string text = to_json(*result);
  if (options.json)
    std::cout << text;
  else
    std::cout << table(*result, platform);
  outputs.write(flags.out, text);
  if (!flags.app_out.empty()) {
    const WcetFrom from = flags.from == "p50"   ? WcetFrom::kP50
                          : flags.from == "p99" ? WcetFrom::kP99
                                                : WcetFrom::kMaxPlusMargin;
    XAUTO_ASSIGN(const AppSpec app, to_app(*result, platform, from));
    outputs.write(flags.app_out, to_json(app));
  }
  return outputs.status(kDone);
}

}  // namespace

void add_profile(Commands& commands) {
  auto flags = std::make_shared<Flags>();
  CLI::App* verb = commands.add(
      "profile", "Time each XNode of an app alone on each XPU that it can run on.",
      "xauto profile --platform small --input drive.db3 --out profile.json --app-out app.json -- "
      "build/bin/driving",
      [flags](const Options& options) { return profile(*flags, options); });
  verb->add_option("--platform", flags->platform, "small, large, or a platform.json")
      ->capture_default_str();
  verb->add_option("--input", flags->input,
                   "recorded input (rosbag2 SQLite); default: the app's own messages");
  verb->add_option("--warmup", flags->warmup, "releases that are not counted")
      ->check(CLI::Range(0, 100000))
      ->capture_default_str();
  verb->add_option("--repetitions", flags->repetitions, "releases that are counted")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  verb->add_option("--margin-pct", flags->margin_pct, "WCET = max + this much")
      ->check(CLI::Range(0, 1000))
      ->capture_default_str();
  verb->add_option("--from", flags->from,
                   "what becomes the WCET in app.json: wcet (max + margin), p99, p50")
      ->check(CLI::IsMember({"wcet", "p99", "p50"}))
      ->capture_default_str();
  verb->add_option("--out", flags->out, "write profile.json here");
  verb->add_option("--app-out", flags->app_out, "write the app.json that follows here");
  auto* emulate = verb->add_flag("--emulate", flags->emulate, "emulate all XPUs");
  verb->add_flag("--real", flags->real, "refuse to emulate")->excludes(emulate);
  verb->add_option("--read", flags->read,
                   "an existing profile.json instead of measuring, e.g. for --app-out");
  verb->add_option("command", flags->command, "the app's program and its arguments, after --");
}

}  // namespace xauto::cli
