// SPDX-License-Identifier: Apache-2.0
// xauto top: runs that go on: what comes out per chain, what modules do, what each worker does. All
// from counts that a run keeps anyway, and from its coordinators. Of one run, with root and BPF, also
// what the kernel knows: load, and XNodes one by one.
#include <algorithm>
#include <chrono>
#include <iostream>
#include <map>
#include <optional>
#include <set>
#include <thread>

#include <fmt/format.h>
#include <unistd.h>

#include "base/clock.h"
#include "model/json_value.h"

#include "xauto/asking.h"
#include "xauto/columns.h"
#include "xauto/command.h"
#include "xauto/live.h"
#include "xauto/run_app.h"
#include "xauto/shown_run.h"
#include "xauto/unseen.h"

namespace xauto::cli {
namespace {

using Clock = std::chrono::steady_clock;

struct TopFlags {
  std::string run;
  int interval_ms = 1000, count = -1, wait_s = 0;
  bool once = false;
};

bool goes_on(const std::string& run) {
  const std::vector<std::string> runs = running();
  return std::find(runs.begin(), runs.end(), run) != runs.end();
}

/// Sleeps until `until`, or until `ends`.
template <class Ends>
void wait_until(Clock::time_point until, const Ends& ends) {
  while (Clock::now() < until && !ends())
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
}

void show(const std::vector<ShownRun>& runs, const std::vector<Unseen>& unseen) {
  Json shown = Json::array(), others = Json::array();
  for (const ShownRun& run : runs) shown.push_back(json_of(run));
  for (const Unseen& one : unseen)
    others.push_back({{"pid", one.pid}, {"user", user_name(one.uid)}, {"why", words_of(one)}});
  std::cout << Json{{"runs", std::move(shown)}, {"unseen", std::move(others)}}.dump() << std::endl;
}

/// One run, named or the only one, with what the kernel knows of it.
Result<int> show_one(const TopFlags& flags, int count, bool json, bool terminal) {
  const StopOnSignal stop;
  std::vector<ShownRun> shown(1);
  ShownRun& run = shown.front();
  XAUTO_ASSIGN(run.watched, watch(flags.run, flags.wait_s, *stop.flag()));
  run.run = run.watched->run;
  run.uid = run.watched->uid;
  kernel::TracerOptions tracer;
  tracer.events = false;
  tracer.pin = false;
  tracer.ring_bytes = 4096;
  std::optional<Live> live;
  if (auto observed = observe(run.run, 0, tracer, *stop.flag()))
    run.live = &live.emplace(std::move(*observed));
  else
    run.why_not = observed.error().what;
  const auto look = [&] {
    auto asked = ask_coordinators(run.run);
    Look now{counts_of(*run.watched->board), std::move(asked[run.run].xpus), {}};
    if (live) now.kernel = look_at(*live);
    return now;
  };
  const auto over = [&] { return stop.flag()->load() || !goes_on(run.run); };
  run.before = look();
  for (int times = 0; count == 0 || times < count; ++times) {
    wait_until(Clock::now() + std::chrono::milliseconds(flags.interval_ms), over);
    const bool last = over();
    if (last && times > 0) break;  // the first is shown in any case: its counts are there
    run.now = look();
    if (json)
      show(shown, {});
    else
      std::cout << (terminal && count != 1 ? "\x1b[H\x1b[2J" : "") << text_of(run, count == 1)
                << std::flush;
    if (last || !std::cout) break;
    run.before = std::move(run.now);
  }
  return kDone;
}

/// What there is to be seen of all runs, at one moment.
struct AllRuns {
  std::map<std::string, Watched> watched;
  std::map<std::string, Look> looks;
  std::map<std::string, Coordinated> coordinated;

  static AllRuns now() {
    AllRuns all;
    all.coordinated = ask_coordinators();
    for (Watched& run : introduced(running())) {
      const std::string name = run.run;
      all.looks[name] = {counts_of(*run.board), all.coordinated[name].xpus, {}};
      all.coordinated[name].uid = run.uid;
      all.watched.emplace(name, std::move(run));
    }
    return all;
  }
  /// Those of now; of one that was not there before only its workers are known.
  [[nodiscard]] std::vector<ShownRun> shown(const AllRuns& before) const {
    std::vector<ShownRun> list;
    for (const auto& [name, of] : coordinated) {
      ShownRun& run = list.emplace_back();
      run.run = name;
      run.uid = of.uid;
      run.why_not = "it is asked of one run, by --run";
      run.now.xpus = of.xpus;
      const auto at = before.looks.find(name);
      if (at == before.looks.end() || !watched.contains(name)) continue;
      run.watched = watched.at(name);
      run.before = at->second;
      run.now = looks.at(name);
    }
    return list;
  }
  /// Coordinators that did not answer.
  [[nodiscard]] std::vector<Unseen> unseen() const {
    std::set<int> answered;
    for (const auto& [name, of] : coordinated)
      for (const XpuStatus& xpu : of.xpus) answered.insert(static_cast<int>(xpu.pid));
    return coordinators_but(answered);
  }
};

void print(const std::vector<ShownRun>& runs, const std::vector<Unseen>& unseen) {
  if (runs.empty())
    std::cout << wrapped(unseen.empty()
                             ? "no app is running under XAuto, as far as can be seen from here: in "
                               "this network namespace and its processes\n"
                             : "no app that can be asked from here is running under XAuto\n",
                         0);
  for (const Unseen& one : unseen) std::cout << "  not seen: " << words_of(one) << "\n";
  const char* between = "";
  for (const ShownRun& run : runs) std::cout << std::exchange(between, "\n") << text_of(run, true);
  std::cout << std::flush;
}

Result<int> show_all(const TopFlags& flags, int count, bool json) {
  const StopOnSignal stop;
  const auto stopped = [&] { return stop.flag()->load(); };
  wait_until(Clock::now() + std::chrono::seconds(flags.wait_s),
             [&] { return stopped() || !running().empty(); });
  AllRuns before = AllRuns::now();
  for (int times = 0; (count == 0 || times < count) && std::cout; ++times) {
    wait_until(Clock::now() + std::chrono::milliseconds(flags.interval_ms), stopped);
    if (stopped() && times > 0) break;
    AllRuns now = AllRuns::now();
    if (json)
      show(now.shown(before), now.unseen());
    else
      print(now.shown(before), now.unseen());
    before = std::move(now);
  }
  return kDone;
}

Result<int> top(const TopFlags& flags, const Options& options) {
  const bool terminal = can_draw(STDOUT_FILENO);
  // A script gets one look, and does not wait for the run's end.
  const int count = flags.once ? 1 : flags.count >= 0 ? flags.count : terminal ? 0 : 1;
  if (flags.run.empty() && (options.json || count == 1))
    return show_all(flags, count, options.json);
  return show_one(flags, count, options.json, terminal);
}

}  // namespace

void add_top(Commands& commands) {
  auto flags = std::make_shared<TopFlags>();
  Verb verb = commands.add(
      "top",
      "Show a run live: rate, latency, age and losses per chain and module, who runs and who waits "
      "per XPU. --once: all runs, and what each of their workers does.",
      "xauto top\n  xauto top --once",
      [flags](const Options& options) { return top(*flags, options); });
  verb.option("--run", flags->run,
              "which run, if there are several; with BPF also what the kernel knows");
  verb.option("--interval-ms", flags->interval_ms, "between two looks").range(50, 60'000).shown();
  verb.option("--count", flags->count,
              "how many times; 0: until the run ends, or Ctrl-C; default: 0 on a "
              "terminal, else 1")
      .range(0, 1'000'000);
  verb.flag("--once", flags->once, "one look, without clearing the terminal").excludes("--count");
  verb.option("--wait-s", flags->wait_s, "how long to wait for a run to begin")
      .range(0, 86'400)
      .shown();
}

}  // namespace xauto::cli
