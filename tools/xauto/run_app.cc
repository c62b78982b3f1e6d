// SPDX-License-Identifier: Apache-2.0
#include "xauto/run_app.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <fmt/format.h>
#include <signal.h>

#include "base/clock.h"
#include "base/index.h"
#include "base/log.h"
#include "base/process.h"
#include "kernel/probe.h"
#include "launch/cpu_run.h"
#include "launch/system_lease.h"
#include "model/json.h"
#include "processes/marks.h"
#include "solver/keys/check.h"

#include "xauto/command.h"
#include "xauto/counts.h"
#include "xauto/parts.h"

namespace xauto::cli {
namespace {

/// timeout(1) and service managers send one to the tool and one to its process group: so near they
/// are one wish.
constexpr std::int64_t kOneWishNs = 500'000'000;

std::atomic<bool> g_stop{false};
std::atomic<std::int64_t> g_stopped_ns{0};  ///< 0: not yet

void on_signal(int number) {
  std::int64_t first_ns = 0;
  if (g_stopped_ns.compare_exchange_strong(first_ns, now_ns())) {
    g_stop.store(true);
  } else if (now_ns() - first_ns > kOneWishNs) {
    signal(number, SIG_DFL);
    raise(number);
  }
}

}  // namespace

StopOnSignal::StopOnSignal() {
  g_stop.store(false);
  g_stopped_ns.store(0);
  signal(SIGINT, on_signal);
  signal(SIGTERM, on_signal);
  // The terminal has gone. nohup(1) has it ignored.
  if (signal(SIGHUP, on_signal) == SIG_IGN) signal(SIGHUP, SIG_IGN);
}
StopOnSignal::~StopOnSignal() {
  signal(SIGINT, SIG_DFL);
  signal(SIGTERM, SIG_DFL);
  if (signal(SIGHUP, SIG_DFL) == SIG_IGN) signal(SIGHUP, SIG_IGN);
}
const std::atomic<bool>* StopOnSignal::flag() const {
  return &g_stop;
}

void RunFlags::declare(Verb verb) {
  verb.option("--app", app_path, "app.json: the XNodes and their WCETs").required();
  verb.option("--platform", platform, kPlatformNames)
      .shown_as("the policy's, if there is one; else small");
  verb.option("--activations", activations,
              "releases of the slowest sensor, the others as many as fit into "
              "that time; 0: until Ctrl-C or the input's end")
      .range(std::uint64_t{0}, runtime::kMaxActivations)
      .shown();
  verb.duration("--duration", seconds, Unit::kSeconds, 0.001, kYearS, "release for so long instead")
      .excludes("--activations");
  verb.duration("--period", period_us, Unit::kMicroseconds, 1, 3.6e9,
                "release period instead of the app's own");
  verb.option("--input", input, "recorded input to replay instead of the app's own messages");
  verb.flag("--lockstep", lockstep, "release the next message when the last one has drained");
  verb.flag("--phases", phases,
            "clocks of polled sources begin at random phases, and are as far off as app.json says; "
            "otherwise all of them begin at once")
      .excludes("--period")
      .excludes("--input")
      .excludes("--lockstep");
  verb.option("--seed", seed, "of --phases").needs("--phases").shown();
  verb.option("--rate", input_rate, "of --input: replay it so much faster than it was recorded")
      .range(0.001, 1000.0)
      .needs("--input")
      .excludes("--lockstep")
      .excludes("--period");
  verb.duration(
          "--max-gap", input_max_gap_s, Unit::kSeconds, 0.001, kYearS,
          "of --input: wait no longer than this between two of its messages, as where a clock "
          "was set while it was recorded")
      .needs("--input")
      .excludes("--lockstep")
      .excludes("--period");
  verb.option("--cpu-sched", cpu_sched,
              "threads of CPU XNodes on real cores: ext (sched_ext, else fifo), fifo or other")
      .one_of({"ext", "fifo", "other"})
      .shown();
  verb.option("--cpu-budget-pct", cpu_budget_pct,
              "with ext: a job that runs longer than this much of its WCET becomes an ordinary "
              "thread; 0: never")
      .range(std::int64_t{0}, std::int64_t{100'000})
      .shown();
  verb.option("--system", system,
              "socket of xauto-system, whose coordinators serve all runs of the machine; off: "
              "coordinators of the run's own")
      .shown_as("/run/xauto/coordinator.sock, if it is there");
  emulation.declare(verb);
  verb.option(
          "--emulate-script", script_path,
          "emulation.json: clocks, contention and stops of the emulated XPUs while the app runs")
      .excludes("--real");
  verb.flag("--emulator-modules", emulator_modules,
            "emulate GPUs and DLAs by the kernel modules of kmod/emu, suspended through xauto.ko");
  verb.option("--deployment", deployment_path,
              "deployment.json: processes, restarts, overload, budgets, chains (the flags "
              "--isolate, --restarts and --overload go before it)");
  verb.option("--overload", overload,
              "what a module that is not free does with further messages: newest, queue:N or "
              "skip, for all or as MODULE=POLICY");
  verb.flag("--isolate", isolate, "each XModule in a process of its own");
  verb.option("--restarts", restarts, "how often a module's process that died is started again")
      .range(0, 1'000'000)
      .shown();
  verb.duration("--trace-keep", trace_keep_s, Unit::kSeconds, 0.001, 1e6,
                "the trace keeps the newest events of so long, as far as 128 MiB go");
  verb.option("command", command, "the app's program and its arguments, after --").required();
}

std::vector<std::string> app_command(std::vector<std::string> command) {
  // Ours, and in no PATH where it is installed.
  if (!command.empty() && command.front() == "xauto-standin")
    command.front() = program_directory() + "/xauto-standin";
  return command;
}

Status RunFlags::prepare(const std::string& policy_path) {
  XAUTO_ASSIGN(app, load_app(app_path));
  XAUTO_ASSIGN(spec, load_platform_of(policy_path, platform));
  XAUTO_TRY(validate_on(app, spec));
  if (phases && app.clocks.size() < 2)
    return fail(
        ErrorCode::kInvalid, "has nothing to do: app '" + app.name + "' has one clock", "--phases",
        "give the sources that no common clock triggers a clock of their own (docs/clocks.md)");
  if (!part.empty()) XAUTO_TRY(put_first(spec, part));
  if (emulator_modules) {
    if (!kernel::module_is_loaded())
      return fail(
          ErrorCode::kUnavailable, "xauto.ko is not loaded", "--emulator-modules",
          "as root: insmod xauto.ko xauto_nvgpu_emu.ko xauto_nvdla_emu.ko (docs/kernel.md)");
    emulation.all_asked = true;
  }
  if (part.empty()) {
    XAUTO_ASSIGN(presence, emulation.decide(spec, &app));
  } else {
    XAUTO_ASSIGN(presence, presence_of_part(*this));
  }
  XAUTO_TRY(prepare_script());
  return prepare_deployment();
}

bool RunFlags::emulates() const {
  return std::find(presence.begin(), presence.end(), Presence::kEmulated) != presence.end();
}

Status RunFlags::prepare_script() {
  if (script_path.empty()) return {};
  if (emulator_modules)
    return fail(ErrorCode::kInvalid, "is for xauto-emud, not for the emulator modules",
                "--emulate-script", "leave out --emulator-modules");
  XAUTO_ASSIGN(script, load_script(script_path, spec, presence));
  return {};
}

bool RunFlags::kernel_schedules(std::size_t xpu) const {
  return xpu::discipline_of(spec.xpus[xpu], presence[xpu] == Presence::kEmulated) ==
         Discipline::kKernel;
}

Status RunFlags::prepare_deployment() {
  deployment.app = app.name;
  if (!deployment_path.empty()) {
    XAUTO_ASSIGN(deployment, load_deployment(deployment_path, app));
  }
  ModuleDeployment& all = deployment.defaults;
  if (isolate) {
    all.isolate = true;
    all.process.reset();
  }
  if (restarts > 0) all.restarts = restarts;
  for (const std::string& text : overload) {
    const std::size_t equals = text.find('=');
    const bool one = equals != std::string::npos;
    const std::string name = one ? text.substr(0, equals) : "";
    if (one && std::none_of(app.xnodes.begin(), app.xnodes.end(),
                            [&](const XNodeSpec& x) { return x.module == name; }))
      return fail(ErrorCode::kInvalid, "XModule '" + name + "' is not in the app", "--overload");
    auto parsed = Overload::parse(one ? text.substr(equals + 1) : text);
    if (!parsed) {
      parsed.error().where = "--overload";
      return tl::unexpected<Error>(std::move(parsed).error());
    }
    (one ? deployment.modules[name] : all).overload = *parsed;
  }
  return {};
}

Latency summarise(const runtime::Distribution& us) {
  return {us.quantile(0.5), us.quantile(0.99), us.max(),        us.mean(),
          us.count(),       us.quantile(0.1),  us.quantile(0.9)};
}

void PolicyRun::take(Policy made) {
  policy = assignment_of(made);
  if (!made.by_priority()) keys = std::move(made);
}

namespace {

/// What the run's account says later is worth knowing before. Runs that share are admitted to each other.
void warn_of_others(const launch::Supervision& request) {
  const std::vector<runtime::RealXpu> ours = runtime::real_xpus_of(request.session);
  for (const runtime::Holder& holder : runtime::holders({})) {
    if (std::ranges::find(ours, holder.hardware, &runtime::RealXpu::hardware) == ours.end() ||
        (holder.shared && request.joins))
      continue;
    log::warn(
        "{} has {}, too: nothing that is claimed of either run stands; xauto-system would "
        "ask whether both fit (docs/claims.md)",
        holder.words(), holder.hardware);
  }
}

/// Why nobody can say what the run takes at most; "": its policy says it.
std::string why_no_demand(const RunFlags& flags, const PolicyRun& run) {
  if (run.tables) return "nobody can say what tables demand";
  if (!run.keys || !run.keys->certified)
    return "a policy without a certificate does not say what it demands";
  if (flags.app.one_at_a_time) return "sources without a rate take all that they get";
  if (flags.lockstep || flags.period_us > 0 || flags.input_rate != 1)
    return "it releases at other rates than those of the app";
  return {};
}

/// What each XNode on one of these XPUs needs, for a service that does not trust this run.
Result<std::vector<launch::LeaseTask>> tasks_of(const runtime::Session& session,
                                                const std::vector<launch::JoinXpu>& xpus) {
  // Its threads are ordinary ones until they have a core: a START is heard so much later than it could be.
  constexpr std::int64_t kHeardNs = 200'000;
  XAUTO_ASSIGN(const auto needs,
               solver::keys::sporadic_needs_of(session.app, session.platform, *session.keys));
  std::vector<launch::LeaseTask> tasks;
  for (const solver::keys::SporadicNeed& need : needs) {
    const std::string& id = session.platform.xpus[at(need.xpu)].id;
    const auto on =
        std::ranges::find_if(xpus, [&](const launch::JoinXpu& xpu) { return xpu.id == id; });
    if (on == xpus.end()) continue;
    if (need.window_ns - kHeardNs < need.work_ns)
      return fail(
          ErrorCode::kInfeasible,
          fmt::format(
              "has {} us from when it is ready to its key, and needs {} us and 200 us to be heard",
              need.window_ns / 1000, need.work_ns / 1000),
          "XNode '" + session.app.xnodes[at(need.xnode)].name + "'",
          "it is not trusted there: solve it with --reserve, which leaves room");
    tasks.push_back({.xpu = static_cast<std::uint32_t>(on - xpus.begin()),
                     .task = {.xnode = static_cast<std::uint32_t>(need.xnode),
                              .period_ns = need.period_ns,
                              .window_ns = need.window_ns - kHeardNs,
                              .longest_ns = need.longest_ns,
                              .budget_ns = need.work_ns}});
  }
  return tasks;
}

/// Joins the machine's coordinators where there are some and the policy says what it demands.
Status join_machine(const RunFlags& flags, PolicyRun& run, launch::Supervision& request) {
  runtime::Session& session = request.session;
  const std::string path = flags.system.empty() ? launch::kSystemSocket : flags.system;
  std::error_code error;
  const bool asked = !flags.system.empty() && flags.system != "off";
  if (asked && run.scheduling != runtime::Scheduling::kXAuto)
    return fail(ErrorCode::kInvalid, "is for a run that XAuto schedules", "--system");
  if (flags.system == "off" || !flags.part.empty() ||
      run.scheduling != runtime::Scheduling::kXAuto ||
      (!asked && !std::filesystem::exists(path, error)))
    return {};
  session.cpu.regulated = launch::is_regulated(path);
  launch::decide_cpu_by_keys(session);
  launch::LeaseRequest joins{.path = path, .app = session.app.name, .xpus = {}, .demand = {}};
  joins.xpus = launch::shareable_xpus(session);
  if (joins.xpus.empty()) return {};
  if (const std::string why = why_no_demand(flags, run); !why.empty()) {
    if (asked) return fail(ErrorCode::kInvalid, "cannot be: " + why, "--system");
    log::warn("does not join {}: {}; it brings coordinators of its own", path, why);
    return {};
  }
  joins.num_xnodes = static_cast<std::uint32_t>(session.app.xnodes.size());
  session.keys = held_in_place_of_order(std::move(*session.keys), [&](int xpu) {
    return std::ranges::any_of(joins.xpus, [&](const launch::JoinXpu& one) {
      return one.id == session.platform.xpus[static_cast<std::size_t>(xpu)].id;
    });
  });
  session.policy = assignment_of(*session.keys);
  if (session.cpu.regulated) {
    XAUTO_ASSIGN(joins.tasks, tasks_of(session, joins.xpus));
  } else {
    XAUTO_ASSIGN(const Demand demand,
                 solver::keys::demand_of(session.app, session.platform, *session.keys));
    joins.demand = to_json(demand);
  }
  request.joins = std::move(joins);
  return {};
}

runtime::ReleaseRequest releases_of(const RunFlags& flags) {
  return {.activations = flags.activations,
          .duration_us = static_cast<std::int64_t>(std::llround(flags.seconds * 1e6)),
          .lockstep = flags.lockstep,
          .phases = flags.phases,
          .seed = flags.seed,
          .period_us = flags.period_us,
          .input = flags.input,
          .input_rate = flags.input_rate,
          .input_max_gap_us = static_cast<std::int64_t>(std::llround(flags.input_max_gap_s * 1e6)),
          .record = flags.record_path,
          .record_outputs = flags.record_outputs};
}

}  // namespace

Status execute(const RunFlags& flags, PolicyRun& run, const std::atomic<bool>* stop, Dump dump) {
  launch::Supervision request;
  runtime::Session& session = request.session;
  session.mode = runtime::Mode::kRun;
  session.app = flags.app;
  session.platform = flags.spec;
  session.scheduling = run.scheduling;
  if (run.policy) session.policy = *run.policy;
  session.keys = run.keys;
  if (run.tables) session.take_tables(*run.tables);
  session.cpu.sched = flags.cpu_sched == "ext"    ? runtime::CpuSched::kExt
                      : flags.cpu_sched == "fifo" ? runtime::CpuSched::kFifo
                                                  : runtime::CpuSched::kOther;
  request.cpu_budget_pct = flags.cpu_budget_pct;
  session.presence = flags.presence;
  XAUTO_TRY(join_machine(flags, run, request));
  if (run.scheduling == runtime::Scheduling::kXAuto) warn_of_others(request);
  session.emulator_modules = flags.emulator_modules;
  std::unique_ptr<launch::Meeting> meeting;
  if (!flags.part.empty()) {
    XAUTO_ASSIGN(meeting, meet(flags, run, stop));
    session.host = {flags.part, meeting->run()};
    request.meeting = meeting.get();
  }
  session.releases = releases_of(flags);
  session.deployment = flags.deployment;
  session.parts.modules = flags.deployment.processes(flags.app);
  request.emulation = flags.script;
  request.command = app_command(flags.command);
  request.stop = stop;
  request.trace_keep_s = flags.trace_keep_s;
  if (dump)
    request.on_incident = [&](const launch::Incident& incident) {
      if (meeting) run.tai_offset_ns = meeting->clock_offset_ns();
      dump(incident);
    };

  // With several rates there are no releases to count by, but the time is known.
  double length_s = flags.seconds;
  if (length_s <= 0 && flags.app.rates() > 1)
    for (const SourceSpec& source : flags.app.sources)
      length_s = std::max(length_s, 1e-6 * static_cast<double>(flags.activations) *
                                        static_cast<double>(source.period.floor_us()));
  Progress progress("run " + run.id, 1);
  Counts before;  // at least a second ago, so that the rate is one
  std::string words;
  request.on_tick = [&](double elapsed_s, const runtime::Board* board) {
    double done = -1;
    if (board != nullptr) {
      Counts now = counts_of(*board);
      done =
          length_s > 0 ? std::min(1.0, elapsed_s / length_s) : progress_of(now, flags.activations);
      if (before.at_ns == 0) before = now;
      if (now.at_ns - before.at_ns >= 1'000'000'000) {
        words = ", " + progress_words(now, before);
        before = std::move(now);
      }
    }
    progress.update(done, fmt::format("{:.0f} s{}", elapsed_s, words));
  };
  XAUTO_ASSIGN(run.outcome, launch::supervise(std::move(request)));
  if (!flags.script_path.empty())
    run.outcome.notes.push_back("emulated under " + flags.script_path +
                                "; what is predicted knows nothing of it");
  progress.finish();
  XAUTO_ASSIGN(run.report, runtime::parse_run_report(run.outcome.answer));
  if (meeting)
    join_reports(*meeting, stop != nullptr && stop->load(), run);
  else
    note_one_machine(flags, run);
  runtime::Account& account = run.report.account;
  account.add("daemon_death", run.outcome.dead_daemons.size(), run.outcome.dead_daemons);
  if (!run.untrue.empty())
    account.add("policy_refused", 1, "`xauto check` refuses the policy: " + run.untrue);
  runtime::Distribution latencies = run.report.latencies_us;
  if (run.report.several_rates)  // every sink's own latencies
    for (const runtime::ModuleReport& module : run.report.modules)
      latencies.merge(module.latencies_us);
  run.latency = summarise(latencies);
  run.story = story_of(flags.app, flags.spec, modules_of(run.report), run.outcome.trace);
  return {};
}

std::vector<story::ModuleInfo> modules_of(const runtime::RunReport& report) {
  std::vector<story::ModuleInfo> modules;
  for (const runtime::ModuleReport& module : report.modules)
    modules.push_back({module.name, module.sink});
  return modules;
}

Rows rows_of(const Platform& platform, runtime::Scheduling scheduling) {
  Rows rows;
  rows.of.assign(platform.xpus.size(), -1);
  for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
    const bool pooled = scheduling == runtime::Scheduling::kRos2 && platform.xpus[x].type == "cpu";
    const int first = pooled ? platform.instances_of("cpu").front() : static_cast<int>(x);
    if (first == static_cast<int>(x)) {
      rows.of[x] = static_cast<int>(rows.names.size());
      rows.names.push_back(pooled ? "CPU pool" : platform.xpus[x].id);
    } else {
      rows.of[x] = rows.of[static_cast<std::size_t>(first)];
    }
  }
  return rows;
}

}  // namespace xauto::cli
