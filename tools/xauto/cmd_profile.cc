// SPDX-License-Identifier: Apache-2.0
// xauto profile: times each XNode on each XPU, alone and beside loads of the others; profile.json, and the
// app.json that follows.
#include <algorithm>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/log.h"
#include "model/asked.h"
#include "model/json.h"

#include "xauto/command.h"
#include "xauto/emulation.h"
#include "xauto/outputs.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct ProfileFlags {
  std::string platform = "small", input, deployment, out, app_out, from = "wcet", read,
              machine_root, script;
  std::uint64_t warmup = 3, repetitions = 30;
  std::int64_t margin_pct = 20, exec_limit_s = 30;
  bool stable = false, contended = false, audit = false;
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
std::vector<std::string> remarks(const Profile& profile, const Platform& platform, WcetFrom from) {
  const bool of_maximum = from == WcetFrom::kMaxPlusMargin;
  std::vector<std::string> lines;
  const auto below = profile.conditions.repetitions;
  const auto remark = [&](const std::string& where, const Samples& s) {
    const double times =
        static_cast<double>(s.max_us) / static_cast<double>(std::max<std::int64_t>(1, s.p50_us));
    if (s.outlier)
      lines.push_back(fmt::format(
          "{}: outlier: repetition {} took {} us{}, and none of the {} after that more than twice "
          "the median{}",
          where, s.max_at, s.max_us,
          s.outlier->count > 1 ? fmt::format(" (one of {} so long)", s.outlier->count) : "",
          s.outlier->later_count,
          of_maximum
              ? fmt::format("; the WCET is from the others' maximum, {} us", s.outlier->max_us)
              : ""));
    else if (s.spread() && s.count > below)
      lines.push_back(
          fmt::format("{}: repetition {} took {} us, {:.1f} times the median, and such times came "
                      "back within {} repetitions{}",
                      where, s.max_at, s.max_us, times, s.count,
                      of_maximum ? ": the WCET is from the maximum of all" : ""));
    else if (s.spread())
      lines.push_back(
          fmt::format("{}: repetition {} of {} took {} us, {:.1f} times the median, {}; --stable "
                      "repeats until it "
                      "is seen whether that comes back",
                      where, s.max_at, s.count, s.max_us, times,
                      of_maximum ? "and becomes the WCET" : "and is longer than the WCET says"));
    if (!profile.incomplete.empty() && s.count < below)
      lines.push_back(fmt::format("{}: {} of {} repetitions", where, s.count, below));
  };
  for (const XNodeProfile& x : profile.xnodes) {
    for (const Xpu& xpu : platform.xpus) {
      const std::string where = x.name + " on " + xpu.id;
      if (const auto at = x.on.find(xpu.id); at != x.on.end()) remark(where, at->second);
      for (const auto& [type, on] : x.beside)
        if (const auto at = on.find(xpu.id); at != on.end())
          remark(where + " beside " + type, at->second);
    }
    for (const std::string& xpu : x.missing)
      lines.push_back(fmt::format("{} on {}: not measured", x.name, xpu));
  }
  return lines;
}

/// row(XNode, its name in the first of its rows, XPU, times alone) for all that was timed, an XNode's
/// in the platform's order.
template <class Row>
void each_row(const Profile& profile, const Platform& platform, Row row) {
  for (const XNodeProfile& x : profile.xnodes) {
    std::string title = x.name;
    for (const Xpu& xpu : platform.xpus) {
      const auto at = x.on.find(xpu.id);
      if (at == x.on.end()) continue;
      row(x, std::exchange(title, {}), xpu.id, at->second);
    }
  }
}

constexpr std::size_t kOfProfile = 20;

/// Of all co-run classes together.
std::int64_t wcet(const XNodeProfile& x, const std::string& xpu, std::int64_t margin_pct,
                  WcetFrom from) {
  std::int64_t us = statistic(x.on.at(xpu), from, margin_pct);
  for (const auto& [type, on] : x.beside)
    if (const auto at = on.find(xpu); at != on.end())
      us = std::max(us, statistic(at->second, from, margin_pct));
  return us;
}

/// The longest times beside each type of XPU, and what loaded it.
std::string contention_table(const Profile& profile, const Platform& platform) {
  const ProfileConditions& c = profile.conditions;
  std::string out = "\n" + row_of("max beside load of", kOfProfile) + left("XPU", 8) +
                    fmt::format("{:>8}", "nothing");
  for (const auto& [type, what] : c.beside) out += fmt::format("{:>8}", cut(type, 7));
  out += "\n";
  each_row(profile, platform,
           [&](const XNodeProfile& x, const std::string& title, const std::string& xpu,
               const Samples& alone) {
             out += row_of(title, kOfProfile) + left(xpu, 8) + fmt::format("{:>8}", alone.max_us);
             for (const auto& [type, what] : c.beside) {
               const auto on = x.beside.find(type);
               const bool there = on != x.beside.end() && on->second.contains(xpu);
               out += fmt::format("{:>8}", there ? std::to_string(on->second.at(xpu).max_us) : "-");
             }
             out += "\n";
           });
  out += "\n";
  for (const auto& [type, what] : c.beside)
    out += fmt::format("  beside {}: {} (all but the XNode's own)\n", type, what);
  for (const auto& [type, why] : c.not_beside)
    out += fmt::format("  not beside {}: {}\n", type, why);
  return out;
}

bool is_audited(const Profile& profile) {
  return std::any_of(profile.xnodes.begin(), profile.xnodes.end(), [](const XNodeProfile& x) {
    return std::any_of(x.on.begin(), x.on.end(),
                       [](const auto& on) { return !on.second.others.empty(); });
  });
}

/// "also on gpu0 (2103 us)", or "".
std::string used_by(const Samples& samples) {
  std::string used;
  for (const auto& [id, o] : samples.others)
    if (o.used)
      used +=
          fmt::format("{}{} ({} us)", used.empty() ? "also on " : ", ", id, o.busy_us - o.idle_us);
  return used;
}

/// A line for each XNode and XPU: how busy the others were meanwhile.
std::string audit_table(const Profile& profile, const Platform& platform) {
  std::vector<std::string> columns;
  for (const Xpu& xpu : platform.xpus)
    if (xpu.type != "cpu") columns.push_back(xpu.id);
  std::string out = "\n" + row_of("busy beside/without", kOfProfile) + left("XPU", 8) +
                    fmt::format("{:>8}", "itself");
  for (const std::string& id : columns) out += fmt::format("{:>13}", cut(id, 12));
  out += fmt::format("{:>13}\n", "CPUs");
  const auto cell = [](std::int64_t busy_us, std::int64_t idle_us) {
    return fmt::format("{:>13}", fmt::format("{}/{}", busy_us, idle_us));
  };
  each_row(
      profile, platform,
      [&](const XNodeProfile&, const std::string& title, const std::string& xpu, const Samples& s) {
        out += row_of(title, kOfProfile) + left(xpu, 8) + fmt::format("{:>8}", s.p50_us);
        bool all_seen = true;
        for (const std::string& id : columns) {
          const auto other = s.others.find(id);
          const bool seen = other != s.others.end();
          all_seen = all_seen && (seen || id == xpu);
          out += seen ? cell(other->second.busy_us, other->second.idle_us)
                      : fmt::format("{:>13}", "-");
        }
        std::int64_t busy_us = 0, idle_us = 0;
        for (const auto& [id, other] : s.others) {
          const int index = platform.find(id);
          if (index < 0 || platform.xpus[static_cast<std::size_t>(index)].type != "cpu") continue;
          busy_us += other.busy_us;
          idle_us += other.idle_us;
        }
        const std::string used = used_by(s);
        out += fmt::format("{}\n    {}\n", cell(busy_us, idle_us),
                           !used.empty() ? used
                           : all_seen    ? "on no other"
                                         : "on no other that is seen (-: is not)");
      });
  return out;
}

/// What an audit found, a line each.
std::vector<std::string> findings(const Profile& profile) {
  std::vector<std::string> lines;
  for (const XNodeProfile& x : profile.xnodes)
    for (const auto& [id, samples] : x.on)
      if (const std::string used = used_by(samples); !used.empty())
        lines.push_back(
            fmt::format("XNode '{}' is said to run on {}, and is {}, of {} us in all: layers that "
                        "fall back? Build it "
                        "without fallback, split it, or declare it where it runs",
                        x.name, id, used, samples.p50_us));
  return lines;
}

/// For people: variants are rows as XNodes are.
Profile with_variants(Profile profile) {
  std::vector<XNodeProfile> all;
  for (const XNodeProfile& x : profile.xnodes) {
    all.push_back(x);
    for (const VariantProfile& v : x.variants) {
      XNodeProfile variant{fmt::format("{} ({})", x.name, v.name), x.module, v.on};
      variant.beside = v.beside;
      all.push_back(std::move(variant));
    }
  }
  profile.xnodes = std::move(all);
  return profile;
}

/// What becomes the WCET.
std::string words_of(WcetFrom from, std::int64_t margin_pct, bool contended) {
  const char* const of = contended ? " of all co-run classes" : "";
  if (from == WcetFrom::kMaxPlusMargin) return fmt::format("max{} + {} %", of, margin_pct);
  return fmt::format("the longest {}{}, as --from says: jobs may take longer",
                     from == WcetFrom::kP50 ? "median" : "p99", of);
}

std::string table(const Profile& measured, const Platform& platform, WcetFrom from) {
  const Profile profile = with_variants(measured);
  std::string out =
      fmt::format("{} on {}{}: execution times in us, {} repetitions after {} warm-up\n\n",
                  profile.app, platform.name, conditions_of(profile),
                  profile.conditions.repetitions, profile.conditions.warmup);
  out += row_of("XNode", kOfProfile) + left("XPU", 8) +
         fmt::format("{:>8}{:>8}{:>8}{:>8}{:>8}{:>5}\n", "min", "p50", "p99", "max", "WCET", "n");
  each_row(profile, platform,
           [&](const XNodeProfile& x, const std::string& title, const std::string& xpu,
               const Samples& s) {
             out += row_of(title, kOfProfile) + left(xpu, 8) +
                    fmt::format("{:>8}{:>8}{:>8}{:>8}{:>8}{:>5}{}\n", s.min_us, s.p50_us,
                                s.count < kP99Samples ? "-" : std::to_string(s.p99_us), s.max_us,
                                wcet(x, xpu, profile.margin_pct, from), s.count,
                                profile.conditions.emulated && !s.emulated ? " real" : "");
           });
  const bool contended =
      !profile.conditions.beside.empty() || !profile.conditions.not_beside.empty();
  out += fmt::format("\n  WCET: {}\n", words_of(from, profile.margin_pct, contended));
  for (const SourceSpec& source : profile.sources)
    if (source.jitter_us > 0) {
      out += fmt::format(
          "  jitter_us: {}, twice the latest wake-up of a thread like the one that releases, "
          "beside the measuring, without stalls; no bound\n",
          source.jitter_us);
      break;
    }
  if (contended) out += contention_table(profile, platform);
  if (is_audited(profile)) out += audit_table(profile, platform);
  for (const std::string& line : remarks(profile, platform, from)) out += "  " + line + "\n";
  if (!profile.incomplete.empty()) out += "  incomplete: " + profile.incomplete + "\n";
  return out;
}

/// What was not one and the same while it was measured, and what to do; empty: nothing.
std::string changes(const Profile& profile) {
  std::vector<std::string> what;
  bool clock = false;
  for (const Reading& r : profile.conditions.readings) {
    if (!r.changed()) continue;
    clock = clock || r.of == Reading::Of::kClock;
    what.push_back(r.is_number()
                       ? fmt::format("{} from {} to {}", r.file, r.min, r.max)
                       : fmt::format("{} from '{}' to '{}'", r.file, r.texts[0], r.texts[1]));
  }
  if (what.empty()) return {};
  return fmt::format(
      "conditions changed while it was measured: {}{}; the times are of no one condition: {}, "
      "then profile again",
      what.front(), what.size() > 1 ? fmt::format(" (and {} more)", what.size() - 1) : "",
      clock ? "fix the clocks (on a Jetson: jetson_clocks; elsewhere: governor 'performance')"
            : "leave power mode and governors alone meanwhile");
}

/// Runs the app and times it.
Result<Profile> measure(const ProfileFlags& flags, const Platform& platform) {
  launch::Supervision request;
  runtime::Session& session = request.session;
  session.mode = runtime::Mode::kProfile;
  session.platform = platform;
  XAUTO_ASSIGN(session.presence, flags.emulation.decide(platform, nullptr));
  session.releases.input = flags.input;
  if (!flags.deployment.empty()) {
    XAUTO_ASSIGN(session.deployment, load_deployment(flags.deployment));
  }
  session.profile.warmup = flags.warmup;
  session.profile.repetitions = flags.repetitions;
  session.profile.margin_pct = flags.margin_pct;
  session.profile.exec_limit_s = flags.exec_limit_s;
  session.profile.stable_rounds = flags.stable ? kStableRounds : 0;
  session.profile.machine_root = flags.machine_root;
  session.profile.contended = flags.contended;
  session.profile.audit = flags.audit;
  if (!flags.script.empty()) {
    XAUTO_ASSIGN(request.emulation, load_script(flags.script, platform, session.presence));
  }
  request.command = app_command(flags.command);
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
    const std::string name = std::filesystem::path(path).stem().string();
    if (std::any_of(profiles.begin(), profiles.end(),
                    [&](const NamedProfile& other) { return other.name == name; }))
      return fail(ErrorCode::kInvalid, "another file gives the scenario '" + name + "' its name",
                  path, "rename one of them");
    profiles.push_back({name, std::move(one)});
    const ProfileConditions &c = profiles.back().profile.conditions,
                            &first = profiles.front().profile.conditions;
    if (c.machine != first.machine || c.input != first.input)
      log::warn("{}: measured on '{}' with input '{}', the first one on '{}' with '{}'", path,
                c.machine, c.input, first.machine, first.input);
  }
  const auto is_contended = [](const NamedProfile& one) {
    return !one.profile.conditions.beside.empty();
  };
  const auto contended = std::count_if(profiles.begin(), profiles.end(), is_contended);
  if (contended > 0 && contended < static_cast<std::ptrdiff_t>(profiles.size()))
    log::warn(
        "{} of {} profiles are --contended: the others' times are of XPUs with nothing beside",
        contended, profiles.size());
  XAUTO_ASSIGN(Scenarios scenarios, scenarios_of(profiles, platform, from_of(flags)));
  if (const std::string why = set_conditions(scenarios, profiles); !why.empty())
    log::warn(
        "no scenario has conditions (`when`), so a run is not told by the machine in which it is: "
        "{}",
        why);
  const std::string text = to_json(scenarios);
  if (options.json || flags.out.empty()) std::cout << text;
  outputs.write(flags.out, text);
  if (!options.json && !flags.out.empty() && outputs.good())
    std::cout << fmt::format(
        "{}: {} scenarios of app '{}'; `xauto solve --scenarios {}` plans for them\n", flags.out,
        scenarios.list.size(), scenarios.app, flags.out);
  return outputs.status(kDone);
}

/// A source whose period is a rate's, cut to whole microseconds: then the plan of all sources repeats after hours.
void warn_of_cut_rates(const AppSpec& app, const std::string& path) {
  for (const SourceSpec& source : app.sources) {
    const std::int64_t us = source.period.num;
    if (source.period.den != 1 || us < 2 || us > 1'000'000 || 1'000'000 % us == 0) continue;
    const std::int64_t hz = (1'000'000 + us / 2) / us;
    if (us != 1'000'000 / hz && us != 1'000'000 / hz + 1) continue;
    log::warn(
        "{}: source '{}' has period_us {}, and {} Hz is none of whole us: with other rates the "
        "plan then repeats "
        "after hours; say {}_hz in the program, or rate_hz {} here",
        path, source.name, us, hz, hz, hz);
  }
}

Status write_app(const ProfileFlags& flags, const Profile& profile, const Platform& platform,
                 Outputs& outputs) {
  const std::string& path = flags.app_out;
  if (!profile.incomplete.empty() && flags.read.empty()) {
    log::error(
        "{} is not written: the profile is incomplete; `xauto profile --read` writes it all the "
        "same",
        path);
    return {};
  }
  XAUTO_ASSIGN(AppSpec app, to_app(profile, platform, from_of(flags)));
  std::string text = to_json(app);
  if (const auto old = read_file(path)) {
    std::vector<std::string> lines;
    XAUTO_ASSIGN(text, with_what_was_asked(app, *old, path, lines));
    for (const std::string& line : lines) log::info("{}: {}", path, line);
    XAUTO_ASSIGN(app, parse_app(text, path));
  }
  for (const SourceSpec& source : profile.sources)
    if (source.pushed)
      log::warn(
          "{}: source '{}' is pushed, and its grid was not measured: period_us {} is the "
          "least distance that the app states, offset_us and jitter_us are taken as 0; a "
          "worst case holds only if release k comes at offset + k period, at most jitter "
          "later: write there what the driver does",
          path, source.name, source.period.num);
  warn_of_cut_rates(app, path);
  outputs.write(path, text);
  return {};
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
    for (const std::string& line : remarks(with_variants(*result), platform, from_of(flags)))
      log::warn("{}", line);
  } else {
    std::cout << table(*result, platform, from_of(flags));
  }
  if (const std::string changed = changes(*result); !changed.empty()) log::warn("{}", changed);
  outputs.write(flags.out, text);
  if (!flags.app_out.empty()) XAUTO_TRY(write_app(flags, *result, platform, outputs));
  const std::vector<std::string> found = findings(with_variants(*result));
  for (const std::string& line : found) log::error("{}", line);
  if (result->incomplete.empty()) return outputs.status(found.empty() ? kDone : kAnswerIsNo);
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
  verb.duration("--exec-limit", flags->exec_limit_s, Unit::kSeconds, 1, 1e6,
                "an exec that takes longer ends the profile; what was measured is written");
  verb.option("--margin-pct", flags->margin_pct, "WCET = max + this much").range(0, 1000).shown();
  verb.option("--from", flags->from,
              "what becomes the WCET in app.json: wcet (max + margin), p99, p50")
      .one_of({"wcet", "p99", "p50"})
      .shown();
  verb.option("--out", flags->out, "write profile.json here");
  verb.option("--app-out", flags->app_out, "write the app.json that follows here");
  verb.flag(
      "--contended", flags->contended,
      "once more beside a load of each type of XPU, the memory of which all share, and of all "
      "types at once: app.json states what each XNode takes alone and beside each");
  verb.flag("--audit", flags->audit,
            "show how busy other XPUs are while an XNode runs: status 1 where it uses another than "
            "it "
            "is said to run on")
      .excludes("--contended");
  flags->emulation.declare(verb);
  verb.option("--emulate-script", flags->script,
              "emulation.json: clocks and contention of the emulated XPUs while it is profiled")
      .excludes("--real");
  verb.option("--machine-root", flags->machine_root,
              "folder in which the machine's /sys, /proc and /var are, where a container has them "
              "elsewhere: clocks, power mode and temperatures are read there");
  verb.option("--read", flags->read,
              "an existing profile.json instead of measuring, e.g. for --app-out");
  verb.option(
      "--merge", flags->merge,
      "profiles of one app, made under different conditions: write scenarios.json to --out, "
      "a scenario for each, named as its file");
  verb.option("command", flags->command, "the app's program and its arguments, after --");
}

}  // namespace xauto::cli
