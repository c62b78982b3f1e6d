// SPDX-License-Identifier: Apache-2.0
#include "launch/supervisor.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/memory_file.h"
#include "base/rt.h"
#include "base/socket.h"
#include "emu/protocol.h"
#include "emu/state_memory.h"
#include "kernel/scx_scheduler.h"
#include "launch/cpu_run.h"
#include "launch/daemons.h"
#include "launch/desk.h"
#include "launch/system_lease.h"
#include "model/json.h"
#include "model/json_value.h"
#include "processes/marks.h"
#include "processes/packet.h"
#include "xpu/kind.h"

namespace xauto::launch {
namespace {

using namespace runtime;  // session, board: what the app is asked, and what it shows

constexpr int kDrainMs = 15'000;  ///< without progress: more than the app's own patience
constexpr std::int64_t kSilenceNs = 10'000'000'000;  ///< of an app that does not begin
constexpr int kProfileDrainMs = 3'000;  ///< an app that profiles answers with what it has

constexpr int kMostAtOnce = 64;         ///< of those who want to look; as many as wait
constexpr std::uint64_t kMaxDumps = 3;  ///< of misses, and of hangs
constexpr std::int64_t kAftermathNs = 300'000'000, kBeforeNs = 1'000'000'000;  ///< what they show

/// What was told of misses, or of hangs.
struct Dumps {
  std::uint64_t seen = 0, written = 0;
  std::int64_t due_ns = 0;     ///< when the next one is made; 0: nothing new
  std::uint64_t shown_ns = 0;  ///< what happened until then is in one
};

/// A process of the app that hosts modules.
struct ModuleProcess {
  int index = 0;
  std::string name;
  SpawnOptions options;
  Child child;
  std::int64_t restarts = 0;  ///< left
  bool noticed = false;
};

std::vector<bool> real_xpus(const Session& session) {
  std::vector<bool> real;
  for (std::size_t x = 0; x < session.platform.xpus.size(); ++x)
    real.push_back(session.presence_of(static_cast<int>(x)) == Presence::kReal);
  return real;
}

class Supervisor {
 public:
  explicit Supervisor(Supervision request) : request_(std::move(request)) {
    bin_ = request_.bin.empty() ? program_directory() : request_.bin;
    daemons_.emplace(bin_, outcome_.notes);
  }

  Result<Outcome> run() {
    XAUTO_TRY(start());
    const std::int64_t started = now_ns();
    watch();
    outcome_.wall_s = static_cast<double>(now_ns() - started) * 1e-9;
    outcome_.app = *app_.wait(0);
    for (ModuleProcess& process : processes_) end(process);
    daemons_->stop(kGraceMs);
    outcome_.deaths += daemons_->deaths() + (lease_lost_ ? 1 : 0);
    outcome_.dead_daemons = daemons_->who_died();
    if (lease_lost_) outcome_.dead_daemons.push_back("xauto-system ended, and its coordinators");
    outcome_.emulator_died = daemons_->emulator_died();
    if (no_start_) return tl::unexpected(*std::move(no_start_));
    return collect();
  }

 private:
  Status start() {
    Session& session = request_.session;
    XAUTO_ASSIGN(answer_, make_memory_file("xauto-answer"));
    session.answer_fd = answer_.get();
    if (request_.trace_keep_s > 0) {
      XAUTO_ASSIGN(trace_, make_memory_file("xauto-trace"));
      session.trace_fd = trace_.get();
      session.trace_keep_s = request_.trace_keep_s;
    }
    const bool runs = session.mode == Mode::kRun;
    const bool scheduled = runs && session.scheduling == Scheduling::kXAuto;
    const bool has_hub = runs && !session.parts.modules.empty();
    XAUTO_TRY(join_machine());
    std::vector<std::string> names = socket_names(session);
    if (runs) names.insert(names.end(), {kLiveName, kDeskName});
    if (has_hub) names.emplace_back(kHubName);
    const std::vector<std::string> marks = runtime::marks_of(session);
    names.insert(names.end(), marks.begin(), marks.end());
    XAUTO_ASSIGN(Sockets sockets, Sockets::open(names));
    for (const std::string& mark : marks) marks_.push_back(sockets.take(mark));
    session.own_sockets = sockets.stem();
    XAUTO_TRY(daemons_->start_emulator(session, sockets, request_.emulation));
    if (runs) {
      board_fd_ = private_memfd("xauto-board", MFD_CLOEXEC | MFD_ALLOW_SEALING);
      if (!board_fd_)
        return fail(ErrorCode::kIo, std::string("cannot make shared memory: ") + strerror(errno));
      session.board_fd = board_fd_.get();
      live_ = sockets.take(kLiveName);
      desk_.emplace(sockets.take(kDeskName), board_fd_.get());
      prepare_cpus(sockets.run(), scheduled);
    }
    if (scheduled)
      for (const Xpu& xpu : session.platform.xpus)
        if (sockets.has(xpu.id)) session.coordinators[xpu.id] = sockets.address(xpu.id);
    UniqueFd hub;  // closed here once the app has it: its end must show
    if (has_hub) {
      session.parts.hub = sockets.address(kHubName);
      hub = sockets.take(kHubName);
      session.parts.hub_fd = hub.get();
    }
    XAUTO_ASSIGN(session_, make_memory_file("xauto-session"));
    XAUTO_ASSIGN(const std::string text, to_json(session));
    XAUTO_TRY(write_memory_file(session_.get(), text));
    if (scheduled) XAUTO_TRY(daemons_->start_coordinators(session, sockets, session_.get()));
    SpawnOptions options = app_options(session);
    if (hub) options.inherit.push_back(hub.get());
    XAUTO_ASSIGN(app_, Child::spawn(options));
    if (!hub) return {};
    std::erase(options.inherit, hub.get());
    std::erase(options.inherit, answer_.get());
    std::erase(options.inherit, board_fd_.get());  // they get it from the hub
    return start_modules(session, options);
  }

  Status join_machine() {
    if (!request_.joins) return {};
    XAUTO_ASSIGN(lease_, SystemLease::ask(*request_.joins));
    for (const JoinXpu& xpu : request_.joins->xpus)
      request_.session.coordinators[xpu.id] = lease_->address(xpu.hardware);
    return {};
  }

  /// What the app's process is, what it inherits, and what its environment says of the session.
  [[nodiscard]] SpawnOptions app_options(const Session& session) const {
    SpawnOptions options;
    options.argv = request_.command;
    options.inherit = {session_.get(), answer_.get()};
    if (trace_) options.inherit.push_back(trace_.get());
    if (board_fd_) options.inherit.push_back(board_fd_.get());
    options.environment = {{kSessionVariable, std::to_string(session_.get())}};
    if (!daemons_->emulator().empty())
      options.environment.emplace_back(emu::kEmudVariable, daemons_->emulator());
    const std::vector<bool> is_real = real_xpus(session);
    std::string real, by_modules;
    for (std::size_t x = 0; x < is_real.size(); ++x) {
      const Xpu& xpu = session.platform.xpus[x];
      if (is_real[x])
        real += xpu.id + "\n";
      else if (session.emulator_modules && xpu::is_by_modules(xpu))
        by_modules += xpu.id + "\n";
    }
    options.environment.emplace_back(emu::kRealVariable, real);
    options.environment.emplace_back(emu::kDriversVariable, by_modules);
    if (const std::string watch = watch_library(session); !watch.empty())
      options.environment.emplace_back("LD_PRELOAD", watch);
    if (session.scheduling == Scheduling::kRos2 && session.mode == Mode::kRun)
      options.environment.emplace_back("XAUTO_EMU_CPU_POOL", "1");
    return options;
  }

  /// One process for each group of modules that has its own.
  Status start_modules(const Session& session, const SpawnOptions& options) {
    for (std::size_t p = 0; p < session.parts.modules.size(); ++p) {
      ModuleProcess process;
      process.index = static_cast<int>(p) + 1;
      for (const std::string& module : session.parts.modules[p]) {
        process.name += (process.name.empty() ? "" : "+") + module;
        process.restarts =
            std::max(process.restarts, session.deployment.of(module).restarts.value_or(0));
      }
      process.options = options;
      process.options.environment.emplace_back(kProcessVariable, std::to_string(process.index));
      XAUTO_ASSIGN(process.child, Child::spawn(process.options));
      processes_.push_back(std::move(process));
    }
    return {};
  }

  /// What the app must be watched with on some XPU, before what it is preloaded with anyway; or "".
  [[nodiscard]] std::string watch_library(const Session& session) const {
    const std::vector<Xpu>& xpus = session.platform.xpus;
    bool watched = false;
    for (std::size_t x = 0; x < xpus.size(); ++x)
      watched = watched || xpu::is_watched(xpus[x], session.emulated(static_cast<int>(x)));
    if (!watched) return {};
    const char* others = std::getenv("LD_PRELOAD");
    return bin_ + "/libxauto_watch.so" + (others != nullptr ? std::string(":") + others : "");
  }

  /// The run's BPF maps and, if asked for, the sched_ext scheduler; what cannot be had is noted.
  void prepare_cpus(const std::string& run, bool scheduled) {
    Session& session = request_.session;
    std::vector<const PriorityPlan*> tables;
    for (std::size_t t = 0; scheduled && t < session.num_tables(); ++t)
      tables.push_back(&session.of_table(t));
    cpus_ = launch::prepare_cpus({.run = run,
                                  .bin = bin_,
                                  .app = session.app,
                                  .platform = session.platform,
                                  .tables = std::move(tables),
                                  .keys = session.keys.has_value(),
                                  .real = real_xpus(session),
                                  .want_ext = session.cpu.sched == CpuSched::kExt,
                                  .budget_pct = request_.cpu_budget_pct});
    if (!cpus_.note.empty()) {
      log::warn("{}", cpus_.note);
      outcome_.notes.push_back(cpus_.note);
    }
    if (!cpus_.info.empty()) log::info("{}", cpus_.info);
    if (cpus_.maps) {
      session.cpu.run = cpus_.maps->run();
      session.cpu.first_xnode = cpus_.maps->first();
    }
    auto policy = deploy_policy(session, run, cpus_.maps ? &*cpus_.maps : nullptr);
    if (policy) {
      policy_.emplace(std::move(*policy));
      session.cpu.policy = run;
    } else {
      log::debug("the policy is in no BPF map: {}", policy.error().to_string());
    }
    if (cpus_.scheduler) {
      session.cpu.scheduler_pid = cpus_.scheduler->child.pid();
      session.cpu.partial = cpus_.partial;
    } else if (session.cpu.sched == CpuSched::kExt) {
      session.cpu.sched = CpuSched::kFifo;
    }
    decide_cpu_by_keys(session);
    outcome_.real_cpus = cpu_keeper(session);
  }

  /// A module process has ended: start it again, or tell the hub that it will not come back.
  void attend(ModuleProcess& process, const Exit& exit) {
    if (!exit.signalled && exit.value == 0) {  // the hub has told it to stop
      process.noticed = true;
      return;
    }
    ++outcome_.deaths;
    std::string note = "the process of " + process.name + " died (" + exit.to_string() + ")";
    if (process.restarts > 0) {
      --process.restarts;
      if (auto child = Child::spawn(process.options)) {
        process.child = std::move(*child);
        outcome_.notes.push_back(note + " and was started again");
        return;
      }
    }
    process.noticed = true;
    outcome_.gone.push_back(note);
    outcome_.notes.push_back(note);
    // Not connected yet: nobody else would tell the hub.
    if (const auto socket = connect_abstract(request_.session.parts.hub)) {
      const Packet gone{.word = static_cast<std::uint32_t>(Word::kGone),
                        .index = static_cast<std::uint32_t>(process.index)};
      (void)send_packet(socket->get(), &gone, sizeof gone);
    }
  }

  /// What the coordinators use while jobs run.
  void look_at_coordinators(std::int64_t now) {
    if (!board_ || board_->settled() == 0) return;
    const std::int64_t cpu_us = daemons_->coordinators_cpu_us();
    if (!first_look_)
      first_look_ = {now, cpu_us};
    else
      outcome_.coordinators_share = static_cast<double>(cpu_us - first_look_->second) * 1e3 /
                                    static_cast<double>(now - first_look_->first);
  }

  /// The run is over. Who crashes now loses nothing of it, and is no death, but it is a fault.
  void end(ModuleProcess& process) {
    const Exit exit = process.child.stop(kGraceMs);
    if (process.noticed || !exit.signalled || exit.value == SIGTERM || exit.value == SIGKILL)
      return;
    outcome_.notes.push_back("the process of " + process.name + " crashed after the run (" +
                             exit.to_string() + ")");
  }

  /// Sleeps until a child ends, at most 200 ms.
  void wait_for_children() {
    std::vector<pollfd> fds = {{app_.pidfd(), POLLIN, 0}};
    daemons_->add_to(fds);
    for (const ModuleProcess& process : processes_)
      if (!process.noticed) fds.push_back({process.child.pidfd(), POLLIN, 0});
    if (desk_) desk_->add_to(fds);
    if (live_) fds.push_back({live_.get(), POLLIN, 0});
    if (poll(fds.data(), fds.size(), 200) > 0 && live_ && fds.back().revents != 0)
      for (int i = 0; i < kMostAtOnce && wait_readable(live_.get(), 0); ++i) introduce();
    if (desk_) desk_->serve(now_ns());
  }

  /// To whoever wants to look at the run: the board, to be read and not to be written.
  void introduce() {
    const auto peer = accept_own(live_.get());
    if (!peer) return;
    const auto board = read_only(board_fd_.get());
    const Session& session = request_.session;
    const std::string text = Json{
        {"app", session.app.name},
        {"platform", session.platform.name},
        {"host", session.host.name},
        {"scheduling", to_string(session.scheduling)},
        {"activations", session.releases.activations},
        {"pid", getpid()}}.dump();
    if (board) (void)send_packet(peer->get(), text.data(), text.size(), {board->get()});
  }

  /// The machine's service ends no run; but without it nobody decides on the XPUs that it kept.
  void look_at_lease() {
    if (!lease_ || lease_lost_ || !wait_readable(lease_->fd(), 0)) return;
    lease_lost_ = true;
    outcome_.notes.push_back(
        "xauto-system ended: jobs on the XPUs that runs share went on unscheduled");
    log::warn("{}", outcome_.notes.back());
  }

  /// What the app and the other parts have to know of each other before its releases begin. False: there will be no
  /// start.
  bool look_at_meeting() {
    Meeting* meeting = request_.meeting;
    if (meeting == nullptr || started_ || no_start_) return !no_start_;
    if ((no_start_ = meeting->error())) return false;
    auto board = Board::steer(board_fd_.get());
    if (!board) return true;  // the app has not made it yet
    BoardHeader& header = (*board)->header();
    switch (static_cast<PartReady>(header.part_ready.load())) {
      case PartReady::kMet:
        meeting->reached(PartStage::kReady);
        break;
      case PartReady::kBuilt:
        meeting->reached(PartStage::kBuilt);
        break;
      default:
        return true;
    }
    const std::int64_t start_ns = meeting->start_ns();
    header.part_start_ns.store(start_ns);
    started_ = start_ns != 0;
    return true;
  }

  /// Of daemons, to whoever looks at the run.
  void show_deaths() {
    if (daemons_->deaths() == shown_deaths_ || !board_fd_) return;
    auto board = Board::steer(board_fd_.get());
    if (!board) return;  // the app has not made it yet
    shown_deaths_ = daemons_->deaths();
    (*board)->header().daemon_deaths.store(shown_deaths_);
  }

  /// The trace says by two counters that there is something new; what it was is among its events.
  /// `now` is INT64_MAX when the app has ended: no aftermath will come.
  void look_for_incidents(std::int64_t now) {
    if (!trace_ || !request_.on_incident) return;
    const trace::Alarms alarms = trace::alarms(trace_.get());
    const std::uint64_t seen[] = {alarms.misses, alarms.hangs};
    for (const bool hang : {false, true}) {
      Dumps& dumps = dumps_[hang ? 1 : 0];
      const std::uint64_t count = seen[hang ? 1 : 0];
      if (count == dumps.seen || dumps.written == kMaxDumps) continue;
      if (dumps.due_ns == 0) dumps.due_ns = now == INT64_MAX ? now : now + kAftermathNs;
      if (now < dumps.due_ns) continue;
      dumps.due_ns = 0;
      dumps.seen = count;
      if (auto trace = trace::read(trace_.get())) dump(hang, dumps, std::move(*trace));
    }
  }

  void dump(bool hang, Dumps& dumps, trace::Recording trace) {
    const std::uint16_t kind = hang ? XAUTO_EV_HANG : XAUTO_EV_MISS;
    auto& events = trace.events;
    // What an earlier dump shows needs none of its own.
    const auto first = std::find_if(events.begin(), events.end(), [&](const trace::Event& e) {
      return e.kind == kind && e.ts_ns > dumps.shown_ns;
    });
    if (first == events.end()) return;
    Incident incident{hang, *first, {}, {}};
    for (std::uint32_t m = 0; board_ && m < board_->shape().modules; ++m)
      incident.modules.push_back(line_name(board_->module(static_cast<int>(m)).name));
    // From before the release that it is about: a miss tells its latency, a hang its limit.
    const std::uint64_t took = std::uint64_t{first->arg} * (hang ? 1'000'000 : 1'000);
    const std::uint64_t before = took + kBeforeNs;
    const std::uint64_t begin = first->ts_ns > before ? first->ts_ns - before : 0;
    const std::uint64_t end = first->ts_ns + std::uint64_t{2 * kAftermathNs};
    dumps.shown_ns = std::min<std::uint64_t>(end, events.back().ts_ns);
    ++dumps.written;
    for (const trace::Event& e : events)
      if (e.ts_ns >= begin && e.ts_ns <= end) incident.trace.events.push_back(e);
    incident.trace.lost = trace.lost;
    // Only what this window lacks is missing in it.
    if (events.front().ts_ns > begin) incident.trace.overwritten = trace.overwritten;
    request_.on_incident(incident);
  }

  /// Until the app has ended.
  void watch() {
    const std::int64_t started = now_ns();
    std::int64_t told_to_stop = 0;
    std::uint64_t settled = 0;
    const auto tell = [&](const char* why) {
      if (told_to_stop != 0) return;
      if (why != nullptr) outcome_.notes.emplace_back(why);
      app_.signal(SIGTERM);
      told_to_stop = now_ns();
    };
    for (;;) {
      wait_for_children();
      if (app_.poll()) return;
      const std::int64_t now = now_ns();
      if (!board_ && board_fd_) {
        if (auto board = Board::observe(board_fd_.get())) board_ = std::move(*board);
        if (!board_ && !silence_told_ && now - started > kSilenceNs) {
          silence_told_ = true;
          log::warn(
              "{} has not begun after {} s: an init takes long, or it is no program of XAuto "
              "(App::main)",
              request_.command.front(), kSilenceNs / 1'000'000'000);
        }
      }
      if (request_.on_tick)
        request_.on_tick(static_cast<double>(now - started) * 1e-9, board_.get());
      look_for_incidents(now);
      if (!daemons_->look_after(now)) tell(nullptr);
      if (!look_at_meeting()) tell(nullptr);
      look_at_coordinators(now);
      look_at_lease();
      show_deaths();
      if (cpus_.scheduler)
        if (const auto exit = cpus_.scheduler->child.poll()) {
          outcome_.notes.push_back("xauto-cpusched ended (" + exit->to_string() + ")");
          if (const auto dump = kernel::kept_scx_dump("", cpus_.maps->run()))
            outcome_.notes.push_back("the kernel's dump of " + dump->about + ": " + dump->path);
          outcome_.real_cpus += ", until it ended";
          cpus_.scheduler.reset();
        }
      for (ModuleProcess& process : processes_)
        if (!process.noticed)
          if (const auto exit = process.child.poll()) {
            // Its hub's end shows in both at once; then it is no death of its own.
            if (app_.wait(told_to_stop != 0 ? kGraceMs : 20)) return;
            attend(process, *exit);
          }
      if (request_.stop != nullptr && request_.stop->load()) {
        tell("stopped by the user");
        stopped_ = true;
      }
      if (request_.time_limit_s > 0 && now - started > request_.time_limit_s * 1'000'000'000)
        tell("stopped at its time limit");
      // Its queues may hold more than it can do in that time: as long as it gets on it may.
      if (told_to_stop != 0 && board_)
        if (const std::uint64_t done = board_->settled(); std::exchange(settled, done) != done)
          told_to_stop = now;
      const std::int64_t drain_ms =
          request_.session.mode == Mode::kProfile ? kProfileDrainMs : kDrainMs;
      if (told_to_stop != 0 && now - told_to_stop > drain_ms * 1'000'000) {
        outcome_.notes.emplace_back("the app did not end when asked and was killed");
        app_.stop(0);
      }
    }
  }

  Result<Outcome> collect() {
    XAUTO_ASSIGN(outcome_.answer, read_memory_file(answer_.get()));
    look_for_incidents(INT64_MAX);
    if (trace_) {
      auto trace = trace::read(trace_.get());
      if (trace)
        outcome_.trace = std::move(*trace);
      else
        outcome_.notes.push_back("no trace: " + trace.error().what);
    }
    if (outcome_.answer.empty()) {
      std::string why;
      for (const std::string& note : outcome_.notes) why += "; " + note;
      return fail(ErrorCode::kUnavailable,
                  "ended without an answer (" + outcome_.app.to_string() + ")" + why,
                  request_.command.front(),
                  stopped_ ? "" : "it must call xauto::App::main; a crash of it shows as a signal");
    }
    return std::move(outcome_);
  }

  Supervision request_;
  std::string bin_;
  UniqueFd answer_, trace_, session_, board_fd_, live_;
  std::optional<SystemLease> lease_;
  bool lease_lost_ = false;
  std::shared_ptr<const Board> board_;
  std::uint64_t shown_deaths_ = 0;
  std::optional<Desk> desk_;     ///< none: it is no run
  std::vector<UniqueFd> marks_;  ///< of real XPUs, until the run is over
  std::optional<Daemons> daemons_;
  std::vector<ModuleProcess> processes_;
  Child app_;
  CpuRun cpus_;
  std::optional<DeployedPolicy> policy_;
  bool stopped_ = false;  ///< by the user
  bool silence_told_ = false;
  bool started_ = false;           ///< of a part: its app knows the start
  std::optional<Error> no_start_;  ///< of a part
  std::optional<std::pair<std::int64_t, std::int64_t>>
      first_look_;  ///< at the coordinators: when; CPU time in us
  Dumps dumps_[2];  ///< misses, hangs
  Outcome outcome_;
};

}  // namespace

Result<Outcome> supervise(Supervision request) {
  return Supervisor(std::move(request)).run();
}

}  // namespace xauto::launch
