// SPDX-License-Identifier: Apache-2.0
// xauto whatif: what an imported app does now, and what it would do under XAuto; each as it would play, with the times
// that were seen.
#include <algorithm>
#include <cmath>
#include <iostream>
#include <map>
#include <memory>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/index.h"
#include "base/number.h"
#include "base/quantile.h"
#include "model/imported.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/executors.h"
#include "solver/keys/play.h"
#include "solver/keys/solve.h"
#include "story/what_if_page.h"

#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

namespace keys = solver::keys;

constexpr double kAgrees = 0.10;  ///< so far a play may be from the trace
constexpr double kMostTimes = 1000;
constexpr std::int64_t kGpuPreemptUs = 275, kDlaPreemptUs = 132;  ///< as of `small`
constexpr const char* kTrace = "in the trace";
constexpr const char* kNow = "as it runs now, played";

struct WhatIfFlags {
  std::string app, platform, out;
  std::vector<std::string> more, on;
  double time_limit_s = 5;
  int cores = 0;
};

/// The app as it would run: who may run where.
struct OtherWay {
  std::string name;
  AppSpec app;
  Platform platform;
};

/// Cores that let a callback run to its end, as an executor does, and one of each other type that the app has.
Platform usual_platform(const ImportedApp& imported, int cores) {
  Platform platform;
  platform.name = "as-seen";
  if (cores == 0) cores = std::max(1, imported.seen.cores);
  for (int c = 0; c < cores; ++c)
    platform.xpus.push_back({"cpu" + std::to_string(c), "cpu", false, 0});
  for (const XNodeSpec& x : imported.app.xnodes)
    for (const auto& [type, us] : x.wcet_us)
      if (platform.instances_of(type).empty())
        platform.xpus.push_back(
            {type + "0", type, true, type == "gpu" ? kGpuPreemptUs : kDlaPreemptUs});
  return platform;
}

Result<OtherWay> with_one_more(OtherWay way, const std::string& type) {
  const std::vector<int> there = way.platform.instances_of(type);
  const bool implemented = std::ranges::any_of(
      way.app.xnodes, [&](const XNodeSpec& x) { return x.wcet_us.contains(type); });
  if (there.empty() || !implemented)
    return fail(ErrorCode::kInvalid,
                there.empty() ? "the platform has no XPU of this type"
                              : "no XNode has an implementation for it",
                "--more " + type, "say what an XNode takes there: --on XNODE=" + type + ":TIMES");
  Xpu more = way.platform.xpus[at(there.front())];
  for (std::size_t n = there.size(); way.platform.find(more.id) >= 0; ++n)
    more.id = type + std::to_string(n);
  way.platform.xpus.push_back(more);
  way.name += (way.name.empty() ? "" : ", ") + std::string("one more ") + type;
  return way;
}

/// "XNODE=TYPE:TIMES": the XNode may also run on this type, in so many times its longest WCET.
Result<OtherWay> with_implementation(OtherWay way, const std::string& text) {
  const std::string option = "--on " + text;
  XAUTO_ASSIGN(const auto said, parse_assignment(text, "--on"));
  const std::size_t colon = said.second.rfind(':');
  const int x = way.app.find(said.first);
  if (x < 0) return fail(ErrorCode::kNotFound, "no such XNode: '" + said.first + "'", option);
  const std::string type = said.second.substr(0, colon);
  double times = 0;
  if (colon != std::string::npos) times = real_of(said.second.substr(colon + 1)).value_or(0);
  if (type.empty() || !(times > 0) || times > kMostTimes)
    return fail(ErrorCode::kInvalid, "is not XNODE=TYPE:TIMES", option,
                "as in --on detector=dla:1.8, above 0 and at most 1000 times");
  XNodeSpec& xnode = way.app.xnodes[at(x)];
  std::int64_t longest = 0;
  for (const auto& [other, us] : xnode.wcet_us) longest = std::max(longest, us);
  const double us = std::min(static_cast<double>(longest) * times, static_cast<double>(kMaxTimeUs));
  xnode.wcet_us[type] = std::max<std::int64_t>(1, std::llround(us));
  xnode.typical_us.erase(type);
  std::erase_if(xnode.beside, [&](const BesideSpec& beside) { return beside.on == type; });
  if (way.platform.instances_of(type).empty())
    way.platform.xpus.push_back(
        {type + "0", type, true, type == "gpu" ? kGpuPreemptUs : kDlaPreemptUs});
  way.name += fmt::format("{}{} on {} in {:g} times its time", way.name.empty() ? "" : ", ",
                          said.first, type, times);
  return way;
}

/// What keeps this way's groups from being what they are in ROS 2, or from where it lets them run. Empty: nothing.
std::string words_of_groups(const ImportedApp& imported, const OtherWay& way,
                            const Policy& policy) {
  std::string text;
  for (const std::vector<std::string>& group : imported.groups) {
    std::map<std::string, std::size_t> types;
    for (const std::string& name : group)
      if (const int x = way.app.find(name); x >= 0)
        for (const auto& [type, us] : way.app.xnodes[at(x)].wcet_us) ++types[type];
    for (const auto& [type, count] : types)
      if (count < group.size())
        text +=
            fmt::format(" The group of {} shares one XPU, so none of it goes to {} before all can.",
                        group.front(), type);
    const int first = way.app.find(group.front());
    if (first >= 0 && way.platform.xpus[at(policy.placements[at(first)].xpu)].preemptive)
      text += fmt::format(
          " The group of {} is on an XPU that may run one of it inside another: guard "
          "what they share.",
          group.front());
  }
  return text;
}

/// What the trace showed, as times on the XPU that the policy gives the XNode.
std::vector<std::vector<std::int64_t>> times_there(const ImportedApp& imported, const OtherWay& way,
                                                   const Policy& policy) {
  std::vector<std::vector<std::int64_t>> times(way.app.xnodes.size());
  for (std::size_t x = 0; x < times.size() && x < imported.seen.xnodes.size(); ++x) {
    const XNodeSpec& spec = way.app.xnodes[x];
    const std::string& type = way.platform.xpus[at(policy.placements[x].xpu)].type;
    const std::int64_t seen_on = spec.wcet_on("cpu").value_or(0), here = *spec.wcet_on(type);
    for (const std::int64_t us : imported.seen.xnodes[x].times_us)
      times[x].push_back(
          seen_on == 0
              ? here
              : std::max<std::int64_t>(1, static_cast<std::int64_t>(static_cast<double>(us) *
                                                                    static_cast<double>(here) /
                                                                    static_cast<double>(seen_on))));
  }
  return times;
}

/// -1: of so few it would be the longest.
std::int64_t p99_of(std::int64_t count, std::int64_t us) {
  return count < static_cast<std::int64_t>(kLeastOfP99) ? -1 : us;
}

std::int64_t whole_us(double us) {
  return std::llround(us);
}

/// Fills a page, way by way.
class Asking {
 public:
  Asking(const ImportedApp& imported, const WhatIfFlags& flags)
      : imported_(imported), flags_(flags) {
    page_.title = imported.app.name + ": what if";
    for (const ChainSpec& chain : imported.app.chains)
      page_.chains.push_back({chain.name, chain.deadline_us, {}});
    for (const Todo& todo : imported.todo) page_.todo.push_back(todo.what);
  }

  /// The executors, played, beside the trace.
  void now() {
    for (const SeenChain& seen : imported_.seen.chains)
      page_.chains[at(seen.chain)].rows.push_back(
          {kTrace, seen.count, seen.median_us, p99_of(seen.count, seen.p99_us), seen.longest_us});
    const solver::ExecutedRun run = solver::play_executors(imported_);
    auto times = reaction_times(imported_.app, run.jobs, run.releases);
    for (std::size_t k = 0; k < times.size(); ++k) {
      if (times[k].empty()) continue;
      std::ranges::sort(times[k]);
      const auto count = static_cast<std::int64_t>(times[k].size());
      page_.chains[k].rows.push_back({kNow, count, quantile_of_sorted(times[k], 0.5) / 1000,
                                      p99_of(count, quantile_of_sorted(times[k], 0.99) / 1000),
                                      times[k].back() / 1000});
    }
    story::WhatIfLoad load{kNow, {}};
    for (std::size_t e = 0; e < run.busy.size(); ++e) {
      const SeenExecutor& executor = imported_.seen.executors[e];
      load.parts.emplace_back(fmt::format("{} ({}, {} threads)", executor.name,
                                          name_of(executor.kind), executor.threads),
                              run.busy[e]);
    }
    page_.loads.push_back(std::move(load));
    hold_against_trace(run);
  }

  /// False: nothing was certified.
  Result<bool> plan(const OtherWay& way, const solver::Objectives& wishes) {
    keys::Options options;
    options.aim = keys::usual_aim(way.app);
    options.time_limit_s = flags_.time_limit_s;
    options.threads = 2;
    options.wishes = wishes;
    XAUTO_ASSIGN(const keys::Answer answer, keys::solve(way.app, way.platform, options));
    if (answer.outcome != keys::Outcome::kPolicy || !answer.policy.certified) {
      page_.verdict.push_back(
          way.name + ": " +
          (answer.outcome == keys::Outcome::kUnsustainable
               ? "no policy keeps up: " + answer.overload.text
               : "no policy was certified; `xauto solve` on this app.json says what would help") +
          ".");
      return false;
    }
    if (const std::string words = words_of_groups(imported_, way, answer.policy); !words.empty())
      page_.verdict.push_back(way.name + ":" + words);
    keys::PlayOptions play;
    play.seconds = std::max<std::int64_t>(1, (imported_.seen.duration_us + 999'999) / 1'000'000);
    if (imported_.seen.from.empty()) play.seconds = 10;
    play.times_us = times_there(imported_, way, answer.policy);
    play.jitter = true;
    play.phases = true;
    XAUTO_ASSIGN(const keys::PlayReport played,
                 keys::play(way.app, way.platform, answer.policy, play));
    for (std::size_t k = 0; k < played.chains.size(); ++k) {
      const keys::PlayedChain& c = played.chains[k];
      page_.chains[k].rows.push_back({way.name, c.releases, whole_us(c.median_us),
                                      p99_of(c.releases, whole_us(c.p99_us)),
                                      whole_us(c.longest_us), c.claimed_us});
    }
    story::WhatIfLoad load{way.name, {}};
    for (std::size_t x = 0; x < played.busy.size(); ++x)
      if (played.busy[x] > 0) load.parts.emplace_back(way.platform.xpus[x].id, played.busy[x]);
    page_.loads.push_back(std::move(load));
    return true;
  }

  story::WhatIfPage& finish() {
    gain();
    page_.assumes =
        "A claim holds while each job stays within its WCET (which app.json's TODO "
        "says how they were found), each release within its jitter, and each XPU serves this app "
        "alone. XPUs are taken "
        "for independent: nobody has measured here how much slower one is beside another. What is "
        "played has the execution times of the trace, in their order, and timers with the phases "
        "of "
        "the trace.";
    return page_;
  }

 private:
  [[nodiscard]] static const story::WhatIfRow* row(const story::WhatIfChain& chain,
                                                   std::string_view name) {
    const auto found = std::ranges::find(chain.rows, name, &story::WhatIfRow::name);
    return found == chain.rows.end() ? nullptr : &*found;
  }

  static double apart(std::int64_t played, std::int64_t seen) {
    return seen == 0 ? 0 : static_cast<double>(played - seen) / static_cast<double>(seen);
  }

  void hold_against_trace(const solver::ExecutedRun& run) {
    bool all = true, any = false;
    for (const story::WhatIfChain& chain : page_.chains) {
      const story::WhatIfRow *seen = row(chain, kTrace), *played = row(chain, kNow);
      if (seen == nullptr || played == nullptr) continue;
      any = true;
      const bool many = seen->p99_us >= 0 && played->p99_us >= 0;
      const double p50 = apart(played->median_us, seen->median_us),
                   p99 = many ? apart(played->p99_us, seen->p99_us) : 0,
                   longest = apart(played->longest_us, seen->longest_us);
      const bool agrees = std::max({std::abs(p50), std::abs(p99), std::abs(longest)}) <= kAgrees;
      all = all && agrees;
      page_.verdict.push_back(fmt::format(
          "{}: the play of its executors {} 10 % of the trace: p50 {:+.1f} %{}, max {:+.1f} %.",
          chain.name, agrees ? "is within" : "is NOT within", 100 * p50,
          many ? fmt::format(", p99 {:+.1f} %", 100 * p99) : "", 100 * longest));
    }
    if (!any)
      page_.verdict.emplace_back(
          "No chain of the trace came to its end: nothing to hold the play against.");
    if (any && !all) why_not(run);
  }

  /// What is known of why a play is not as the trace.
  void why_not(const solver::ExecutedRun& run) {
    const auto say = [&](std::string text) {
      page_.verdict.push_back("Why it may differ: " + std::move(text));
    };
    const auto approximated =
        std::ranges::count_if(imported_.todo, [](const Todo& todo) { return todo.at.empty(); });
    if (approximated > 0)
      say(fmt::format("app.json names {} things that it could not say exactly.", approximated));
    if (run.lost > 0) say(fmt::format("full queues lost {} messages in the play.", run.lost));
    if (run.skipped > 0)
      say(fmt::format("timers were called too late in the play, and skipped {} releases.",
                      run.skipped));
    if (run.gave_up) say("the play was given up, at its limit of callbacks.");
    for (const SeenXNode& x : imported_.seen.xnodes)
      if (x.times_us.size() >= kMaxSeenTimes) {
        say("of each callback the file keeps its first 1000 times, which the play repeats.");
        break;
      }
    say("what else ran on the machine, calls of services, and in which order rclcpp looks at "
        "callbacks of one kind are not in the play; a callback's times depend on what it got, and "
        "are "
        "played in their order whatever it gets.");
  }

  void gain() {
    for (const story::WhatIfChain& chain : page_.chains) {
      const story::WhatIfRow* before = row(chain, kNow);
      if (before == nullptr) before = row(chain, kTrace);
      for (const story::WhatIfRow& after : chain.rows) {
        if (before == nullptr || !after.claim_us || before->median_us == 0) continue;
        page_.verdict.push_back(fmt::format(
            "{}, {}: p50 {} ms instead of {} ms ({:+.0f} %), max {} ms instead of {} ms; claimed "
            "{} ms.",
            chain.name, after.name, ms_in_row(after.median_us), ms_in_row(before->median_us),
            100 * apart(after.median_us, before->median_us), ms_in_row(after.longest_us),
            ms_in_row(before->longest_us), ms_in_row(*after.claim_us)));
      }
    }
  }

  const ImportedApp& imported_;
  const WhatIfFlags& flags_;
  story::WhatIfPage page_;
};

void print(const story::WhatIfPage& page) {
  for (const story::WhatIfChain& chain : page.chains) {
    std::cout << row_of("chain " + chain.name, 40)
              << fmt::format("{:>8}{:>8}{:>8}{:>9}\n", "p50", "p99", "max", "claimed");
    for (const story::WhatIfRow& row : chain.rows)
      std::cout << row_of("  " + row.name, 40)
                << fmt::format("{:>8}{:>8}{:>8}{:>9}\n", ms_in_row(row.median_us),
                               ms_in_row(row.p99_us), ms_in_row(row.longest_us),
                               row.claim_us ? ms_in_row(*row.claim_us) : "-");
    if (chain.deadline_us)
      std::cout << row_of("  deadline", 40)
                << fmt::format("{:>24}\n", ms_in_row(*chain.deadline_us));
  }
  std::cout << "\n";
  for (const story::WhatIfLoad& load : page.loads) {
    std::string line = "  busy, " + load.name + ":";
    for (const auto& [name, part] : load.parts)
      line += fmt::format(" {} {:.1f} %", name, 100 * part);
    std::cout << wrapped(line, 4) << "\n";
  }
  std::cout << "\n";
  for (const std::string& sentence : page.verdict) std::cout << wrapped("  " + sentence, 4) << "\n";
  std::cout << wrapped("  " + page.assumes, 4) << "\n";
}

Json to_json(const story::WhatIfPage& page, const ImportedApp& imported) {
  Json root = {{"schema", "xauto.whatif"}, {"version", 1}, {"app", imported.app.name}};
  root["chains"] = Json::array();
  for (const story::WhatIfChain& chain : page.chains) {
    Json rows = Json::array();
    for (const story::WhatIfRow& row : chain.rows)
      rows.push_back({{"way", row.name},
                      {"count", row.count},
                      {"p50_us", row.median_us},
                      {"p99_us", row.p99_us < 0 ? Json() : Json(row.p99_us)},
                      {"max_us", row.longest_us},
                      {"claimed_us", row.claim_us}});
    root["chains"].push_back(
        {{"name", chain.name}, {"deadline_us", chain.deadline_us}, {"ways", std::move(rows)}});
  }
  root["busy"] = Json::array();
  for (const story::WhatIfLoad& load : page.loads)
    for (const auto& [name, part] : load.parts)
      root["busy"].push_back({{"way", load.name}, {"what", name}, {"part", part}});
  root["verdict"] = Json(page.verdict);
  root["todo"] = Json(page.todo);
  return root;
}

Result<std::vector<OtherWay>> ways_of(const ImportedApp& imported, const WhatIfFlags& flags) {
  OtherWay base{"with XAuto's keys", imported.app, {}};
  base.platform = usual_platform(imported, flags.cores);
  if (!flags.platform.empty()) {
    XAUTO_ASSIGN(base.platform, load_platform(flags.platform));
  }
  std::vector<OtherWay> ways = {base};
  OtherWay changed = base;
  changed.name.clear();
  for (const std::string& text : flags.on) {
    XAUTO_ASSIGN(changed, with_implementation(std::move(changed), text));
    ways.push_back(changed);
  }
  for (const std::string& type : flags.more) {
    XAUTO_ASSIGN(changed, with_one_more(std::move(changed), type));
    ways.push_back(changed);
  }
  return ways;
}

Result<int> what_if(const WhatIfFlags& flags, const Options& options) {
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--out", flags.out));
  XAUTO_ASSIGN(const ImportedApp imported, load_imported(flags.app));
  XAUTO_ASSIGN(const solver::Objectives wishes, load_objectives(flags.app));
  XAUTO_ASSIGN(const std::vector<OtherWay> ways, ways_of(imported, flags));
  Asking asking(imported, flags);
  if (!imported.seen.executors.empty()) asking.now();
  bool good = true;
  for (const OtherWay& way : ways) {
    XAUTO_ASSIGN(const bool planned, asking.plan(way, wishes));
    good = good && planned;
  }
  const story::WhatIfPage& page = asking.finish();
  if (options.json)
    std::cout << to_json(page, imported).dump(2) << "\n";
  else
    print(page);
  if (!flags.out.empty()) outputs.write(flags.out, story::what_if_html(page));
  return outputs.status(good ? kDone : kAnswerIsNo);
}

}  // namespace

void add_whatif(Commands& commands) {
  auto flags = std::make_shared<WhatIfFlags>();
  Verb verb = commands.add(
      "whatif",
      "What an imported app does now, under its executors, and would do with XAuto's keys, or on "
      "other XPUs.",
      "xauto whatif app.json --on detector=dla:1.8 --out whatif.html",
      [flags](const Options& options) { return what_if(*flags, options); });
  verb.option("app", flags->app, "app.json, of `xauto import`").required();
  verb.option("--platform", flags->platform, kPlatformNames)
      .shown_as("the trace's cores, which let a callback run to its end");
  verb.option("--cores", flags->cores, "so many of these, not as many as the trace shows")
      .range(1, kMaxSeenThreads)
      .excludes("--platform");
  verb.option("--on", flags->on,
              "XNODE=TYPE:TIMES: it may also run on this type, in so many times its WCET; one way "
              "more, and each way has the changes of those before it");
  verb.option("--more", flags->more, "TYPE: one more XPU of it; one way more, likewise");
  verb.duration("--time-limit", flags->time_limit_s, Unit::kSeconds, 0, kYearS,
                "for the plan of each way");
  verb.option("--out", flags->out, "where the page goes");
}

}  // namespace xauto::cli
