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
#include <span>
#include <thread>

#include <unistd.h>

#include "base/clock.h"
#include "base/columns.h"
#include "base/utf8.h"
#include "launch/system_lease.h"
#include "model/json_value.h"

#include "xauto/asking.h"
#include "xauto/command.h"
#include "xauto/kernel_record.h"
#include "xauto/live.h"
#include "xauto/machine.h"
#include "xauto/outputs.h"
#include "xauto/run_app.h"
#include "xauto/shown_run.h"
#include "xauto/unseen.h"

namespace xauto::cli {
namespace {

using Clock = std::chrono::steady_clock;
constexpr int kPollMs = 20, kRecordMs = 3;

struct TopFlags {
  std::string run, record, timeline;
  int interval_ms = 1000, count = -1, wait_s = 0;
  bool once = false;
  std::string system = launch::kSystemSocket;
};

bool goes_on(const std::string& run) {
  const std::vector<std::string> runs = running();
  return std::find(runs.begin(), runs.end(), run) != runs.end();
}

/// Sleeps until `until`, or until `ends`.
template <class Ends>
void wait_until(Clock::time_point until, const Ends& ends) {
  while (Clock::now() < until && !ends())
    std::this_thread::sleep_for(std::chrono::milliseconds(kPollMs));
}

void show(std::span<const ShownRun> runs, const std::vector<Unseen>& unseen, const Json& machine) {
  Json shown = Json::array(), others = Json::array();
  for (const ShownRun& run : runs) shown.push_back(json_of(run));
  for (const Unseen& one : unseen)
    others.push_back({{"pid", one.pid}, {"user", user_name(one.uid)}, {"why", words_of(one)}});
  Json all{{"runs", std::move(shown)}, {"unseen", std::move(others)}};
  if (!machine.is_null()) all["machine"] = machine;
  std::cout << all.dump() << std::endl;
}

/// One run, named or the only one, with what the kernel knows of it.
class OneRun {
 public:
  OneRun(const TopFlags& flags, bool json) : flags_(flags), json_(json) {}

  Status open() {
    XAUTO_TRY(outputs_.expect("--record", flags_.record));
    XAUTO_ASSIGN(run_.watched, watch(flags_.run, flags_.wait_s, *stop_.flag()));
    run_.run = run_.watched->run;
    run_.uid = run_.watched->uid;
    kernel::TracerOptions tracer;
    if (flags_.record.empty()) {
      tracer.events = false;
      tracer.pin = false;
      tracer.ring_bytes = 4096;
    }
    auto live = observe(run_.run, tracer);
    if (!live && !flags_.record.empty()) return tl::unexpected<Error>(std::move(live).error());
    if (!live) {
      run_.why_not = live.error().what;
      return {};
    }
    run_.live = &live_.emplace(std::move(*live));
    if (!flags_.record.empty()) run_.record = &record_.emplace(*live_);
    return {};
  }

  /// `count` looks; 0: until the run ends.
  Status show(int count, bool terminal) {
    run_.before = look();
    for (int times = 0; count == 0 || times < count; ++times) {
      XAUTO_TRY(wait());
      const bool last = over();
      if (last && times > 0) break;  // the first is shown in any case: its counts are there
      run_.now = look();
      if (json_)
        cli::show({&run_, 1}, {}, {});
      else
        std::cout << (terminal && count != 1 ? "\x1b[H\x1b[2J" : "") << text_of(run_, count == 1)
                  << std::flush;
      if (last || !std::cout) break;
      run_.before = std::move(run_.now);
    }
    return {};
  }

  /// The record, if there is one. Returns the exit status.
  Result<int> close() {
    while (record_) {
      XAUTO_ASSIGN(const std::size_t more, record_->read(0));
      if (more == 0) break;
    }
    if (record_) outputs_.write(flags_.record, record_->file(flags_.record));
    return outputs_.status(kDone);
  }

 private:
  [[nodiscard]] bool over() const { return stop_.flag()->load() || !goes_on(run_.run); }

  [[nodiscard]] Look look() const {
    auto asked = ask_coordinators(run_.run);
    Look now{counts_of(*run_.watched->board), std::move(asked[run_.run].xpus), {}};
    if (live_) now.kernel = look_at(*live_);
    return now;
  }

  /// Until the next look.
  Status wait() {
    const auto until = Clock::now() + std::chrono::milliseconds(flags_.interval_ms);
    if (!record_) wait_until(until, [this] { return over(); });
    while (Clock::now() < until && !over()) XAUTO_TRY(record_->read(kPollMs));
    return {};
  }

  const TopFlags& flags_;
  const bool json_;
  const StopOnSignal stop_;
  Outputs outputs_;
  ShownRun run_;
  std::optional<Live> live_;
  std::optional<KernelRecord> record_;
};

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
  [[nodiscard]] std::vector<Unseen> unseen(const Json& machine) const {
    std::set<int> answered;
    for (const Json& one : machine.at("coordinators").elements())
      answered.insert(static_cast<int>(one.at("pid").integer().value_or(0)));
    for (const auto& [name, of] : coordinated)
      for (const XpuStatus& xpu : of.xpus) answered.insert(static_cast<int>(xpu.pid));
    return coordinators_but(answered);
  }
};

void print(const std::vector<ShownRun>& runs, const std::vector<Unseen>& unseen,
           const std::string& machine) {
  std::cout << machine;
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
  Outputs outputs;
  XAUTO_TRY(outputs.expect("--timeline", flags.timeline));
  std::optional<MachineRecord> record;
  AllRuns before = AllRuns::now();
  Json there_before = ask_machine(flags.system);
  if (!flags.timeline.empty()) {
    record.emplace(flags.system);
    XAUTO_TRY(record->follow(there_before));
  }
  for (int times = 0; (count == 0 || times < count) && std::cout; ++times) {
    const auto until = Clock::now() + std::chrono::milliseconds(flags.interval_ms);
    while (record && Clock::now() < until && !stopped()) {
      record->look();
      std::this_thread::sleep_for(std::chrono::milliseconds(kRecordMs));
    }
    wait_until(until, stopped);
    if (stopped() && times > 0) break;
    AllRuns now = AllRuns::now();
    Json there = ask_machine(flags.system);
    if (json)
      show(now.shown(before), now.unseen(there), machine_json(there, there_before));
    else
      print(now.shown(before), now.unseen(there), machine_text(there, there_before));
    if (record && !there.is_null()) XAUTO_TRY(record->follow(there));
    before = std::move(now);
    there_before = std::move(there);
  }
  if (record) {
    record->look();
    outputs.write(flags.timeline, record->perfetto());
  }
  return outputs.status(kDone);
}

Result<int> top(const TopFlags& flags, const Options& options) {
  const bool terminal = can_draw(STDOUT_FILENO);
  // A script gets one look, and does not wait for the run's end.
  const int count = flags.once ? 1 : flags.count >= 0 ? flags.count : terminal ? 0 : 1;
  if (!flags.timeline.empty() && (!flags.run.empty() || !flags.record.empty()))
    return fail(ErrorCode::kInvalid, "is of all runs: leave --run and --record out", "--timeline");
  if (flags.run.empty() && flags.record.empty() &&
      (options.json || count == 1 || !flags.timeline.empty()))
    return show_all(flags, count, options.json);
  OneRun run(flags, options.json);
  XAUTO_TRY(run.open());
  XAUTO_TRY(run.show(count, terminal));
  return run.close();
}

}  // namespace

void add_top(Commands& commands) {
  auto flags = std::make_shared<TopFlags>();
  Verb verb = commands.add(
      "top",
      "Show a run live: rate, latency, age and losses per chain and module, who runs and who waits "
      "per XPU. --once: all runs, and what each of their workers does.",
      "xauto top\n  xauto top --once\n  xauto top --once --interval 5s --record cpus.pftrace",
      [flags](const Options& options) { return top(*flags, options); });
  verb.option("--run", flags->run,
              "which run, if there are several; with BPF also what the kernel knows");
  verb.duration("--interval", flags->interval_ms, Unit::kMilliseconds, 50, 60'000,
                "between two looks");
  verb.option("--count", flags->count,
              "how many times; 0: until the run ends, or Ctrl-C; default: 0 on a "
              "terminal, else 1")
      .range(0, 1'000'000);
  verb.flag("--once", flags->once, "one look, without clearing the terminal").excludes("--count");
  verb.option(
      "--record", flags->record,
      "meanwhile record what the kernel does with the run's threads, with BPF: FILE.pftrace for "
      "Perfetto's viewers, else a JSON object per line");
  verb.option("--system", flags->system, "of all runs: the socket of xauto-system").shown();
  verb.option("--timeline", flags->timeline,
              "meanwhile record which app had which XPU of the machine, of all that have joined "
              "xauto-system: FILE.pftrace, for Perfetto's viewers");
  verb.duration("--wait", flags->wait_s, Unit::kSeconds, 0, kYearS,
                "how long to wait for a run to begin");
}

}  // namespace xauto::cli
