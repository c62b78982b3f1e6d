// SPDX-License-Identifier: Apache-2.0
#include "launch/daemons.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>

#include <fcntl.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/memory_file.h"
#include "base/socket.h"
#include "emu/state_memory.h"
#include "model/json.h"

namespace xauto::launch {
namespace {

constexpr int kReadyTimeoutMs = 10'000;
constexpr int kEarlyGraceMs = 2'000;
constexpr int kMaxSharedRestarts = 100'000;  ///< runs come and go
constexpr int kStartAttempts = 5;            ///< in a row

/// Starts a daemon and waits until it says that its socket is there.
Result<Child> start_daemon(const std::string& name, SpawnOptions options) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0)
    return fail(ErrorCode::kIo, std::string("pipe: ") + strerror(errno));
  const UniqueFd read_end(ends[0]);
  UniqueFd write_end(ends[1]);
  options.argv.push_back("--ready-fd");
  options.argv.push_back(std::to_string(write_end.get()));
  options.inherit.push_back(write_end.get());
  XAUTO_ASSIGN(Child child, Child::spawn(options));
  write_end.reset();
  const std::int64_t limit = now_ns() + std::int64_t{kReadyTimeoutMs} * 1'000'000;
  for (;;) {
    pollfd ready{read_end.get(), POLLIN, 0};
    const auto left = static_cast<int>(std::max<std::int64_t>(0, (limit - now_ns()) / 1'000'000));
    const int count = poll(&ready, 1, left);
    if (count < 0 && errno == EINTR) continue;
    if (count == 0) return fail(ErrorCode::kTimeout, "was not ready within 10 s", name);
    char byte;
    if (read(read_end.get(), &byte, 1) == 1) return child;
    const auto exit = child.wait(kEarlyGraceMs);
    return fail(ErrorCode::kUnavailable,
                "ended before it was ready" + (exit ? " (" + exit->to_string() + ")" : ""), name);
  }
}

/// CPU time that it has used so far.
std::int64_t cpu_us(const Child& child) {
  clockid_t clock;
  return clock_getcpuclockid(child.pid(), &clock) == 0 ? clock_ns(clock) / 1000 : 0;
}

std::string name_of_coordinator(const std::string& xpu) {
  return "xauto-coordinator of " + xpu;
}

}  // namespace

std::vector<std::string> socket_names(const runtime::Session& session) {
  std::vector<std::string> names;
  if (session.emulates()) names.emplace_back(kEmudName);
  if (session.mode == runtime::Mode::kRun && session.scheduling == runtime::Scheduling::kXAuto)
    for (std::size_t x = 0; x < session.platform.xpus.size(); ++x)
      if (const std::string& id = session.platform.xpus[x].id;
          !session.shares(id) && !session.elsewhere(x))
        names.push_back(id);
  return names;
}

/// What outlives it goes to it as arguments.
void Daemons::Daemon::hand_over(std::initializer_list<const char*> flags) {
  std::size_t i = 0;
  for (const char* flag : flags) {
    options.argv.emplace_back(flag);
    options.argv.push_back(std::to_string(kept[i].get()));
    options.inherit.push_back(kept[i++].get());
  }
}

Status Daemons::start_emulator(const runtime::Session& session, Sockets& sockets,
                               const EmulationScript& script) {
  thread_.check();
  if (!session.emulates()) return {};
  Platform emulated{session.platform.name, {}};
  for (std::size_t x = 0; x < session.platform.xpus.size(); ++x)
    if (session.presence[x] == xauto::Presence::kEmulated ||
        session.presence[x] == xauto::Presence::kEither)
      emulated.xpus.push_back(session.platform.xpus[x]);
  XAUTO_ASSIGN(platform_, make_memory_file("xauto-platform"));
  XAUTO_TRY(write_memory_file(platform_.get(), to_json(emulated)));
  emulator_ = sockets.address(kEmudName);
  Daemon daemon;
  daemon.name = "xauto-emud";
  daemon.kept[0] = sockets.take(kEmudName);
  XAUTO_ASSIGN(daemon.kept[1], emu::StateMemory::make());
  daemon.options.argv = {bin_ + "/xauto-emud", "--socket", emulator_, "--platform",
                         "/proc/self/fd/" + std::to_string(platform_.get())};
  daemon.options.inherit = {platform_.get()};
  if (!script.steps.empty()) {
    XAUTO_ASSIGN(script_, make_memory_file("xauto-emulation"));
    XAUTO_TRY(write_memory_file(script_.get(), to_json(script)));
    daemon.options.argv.insert(daemon.options.argv.end(),
                               {"--script", "/proc/self/fd/" + std::to_string(script_.get())});
    daemon.options.inherit.push_back(script_.get());
  }
  daemon.hand_over({"--listen-fd", "--memory-fd"});
  XAUTO_ASSIGN(daemon.child, start_daemon(daemon.name, daemon.options));
  daemon.ping.emplace(emulator_);
  daemons_.push_back(std::move(daemon));
  return {};
}

Status Daemons::start_coordinators(const runtime::Session& session, Sockets& sockets,
                                   int session_fd) {
  thread_.check();
  for (const auto& [xpu, address] : session.coordinators) {
    if (!sockets.has(xpu)) continue;  // the machine's
    Daemon daemon;
    daemon.options.argv = {bin_ + "/xauto-coordinator", "--socket", address, "--session-fd",
                           std::to_string(session_fd)};
    daemon.options.inherit = {session_fd};
    XAUTO_TRY(start_coordinator(std::move(daemon), xpu, sockets.take(xpu)));
  }
  return {};
}

Result<UniqueFd> Daemons::start_shared(const std::string& hardware, Discipline discipline,
                                       int levels, int record_fd) {
  thread_.check();
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0)
    return fail(ErrorCode::kIo, std::string("socketpair: ") + strerror(errno));
  UniqueFd ours(ends[0]), its(ends[1]);
  Daemon daemon;
  daemon.options.argv = {bin_ + "/xauto-coordinator",
                         "--shared-as",
                         std::to_string(static_cast<int>(discipline)),
                         "--levels",
                         std::to_string(levels),
                         "--record-fd",
                         std::to_string(record_fd)};
  daemon.options.inherit = {record_fd};
  daemon.most_restarts = kMaxSharedRestarts;
  XAUTO_TRY(start_coordinator(std::move(daemon), hardware, std::move(its)));
  return ours;
}

void Daemons::end_shared(const std::string& hardware) {
  thread_.check();
  const auto found = std::find_if(daemons_.begin(), daemons_.end(), [&](const Daemon& daemon) {
    return daemon.name == name_of_coordinator(hardware);
  });
  if (found == daemons_.end()) return;
  (void)found->child.stop(kGraceMs);
  daemons_.erase(found);
}

pid_t Daemons::pid_of(const std::string& hardware) const {
  for (const Daemon& daemon : daemons_)
    if (daemon.name == name_of_coordinator(hardware)) return daemon.child.pid();
  return 0;
}

bool Daemons::idle(const std::string& hardware, int but) const {
  const auto found = std::find_if(daemons_.begin(), daemons_.end(), [&](const Daemon& daemon) {
    return daemon.name == name_of_coordinator(hardware);
  });
  return found == daemons_.end() || found->pulse.idle(but);
}

/// `door`: where who wants it comes in; it outlives the coordinator, as its memory and its doorbell do.
Status Daemons::start_coordinator(Daemon daemon, const std::string& xpu, UniqueFd door) {
  daemon.name = name_of_coordinator(xpu);
  daemon.coordinator = true;
  daemon.kept[0] = std::move(door);
  daemon.kept[1] = private_memfd("xauto-coordinator", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  daemon.kept[2] = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!daemon.kept[1] || !daemon.kept[2])
    return fail(ErrorCode::kIo, std::string("cannot make shared memory: ") + strerror(errno));
  daemon.options.argv.insert(daemon.options.argv.end(), {"--xpu", xpu});
  daemon.hand_over({"--listen-fd", "--memory-fd", "--doorbell-fd"});
  XAUTO_ASSIGN(daemon.child, start_daemon(daemon.name, daemon.options));
  XAUTO_ASSIGN(daemon.pulse, Pulse::of(daemon.kept[1].get(), daemon.kept[0].get()));
  daemons_.push_back(std::move(daemon));
  return {};
}

/// A daemon has died: the next one goes on with what it left, and no job notices.
bool Daemons::restart(Daemon& daemon, const Exit& exit) {
  if (daemon.coordinator) ended_cpu_us_ += exit.cpu_us;
  ++deaths_;
  Result<Child> child = fail(ErrorCode::kUnavailable, "died too often");
  // One that dies while it starts is followed, too, but not for ever.
  for (int attempt = 0; attempt < kStartAttempts && daemon.starts <= daemon.most_restarts;
       ++attempt) {
    ++daemon.starts;
    child = start_daemon(daemon.name, daemon.options);
    if (child || child.error().code != ErrorCode::kUnavailable) break;
  }
  if (!child) {
    log::warn("{}: not started again: {}", daemon.name, child.error().what);
    daemon.kept[0].reset();  // nobody listens any more: who waits for it need not
    return false;
  }
  daemon.child = std::move(*child);
  const std::string what = daemon.name + " died (" + exit.to_string() + ")";
  log::warn("{} and was started again", what);
  if (++daemon.deaths == 1) {
    daemon.note = notes_.size();
    notes_.push_back(what + " and was started again");
  } else {
    notes_[daemon.note] =
        what + " and was started again, " + std::to_string(daemon.deaths) + " times";
  }
  return true;
}

std::vector<std::string> Daemons::who_died() const {
  thread_.check();
  std::vector<std::string> lines;
  for (const Daemon& daemon : daemons_) {
    if (daemon.deaths > 0)
      lines.push_back(daemon.name + " died and was restarted" +
                      (daemon.deaths > 1 ? ", " + std::to_string(daemon.deaths) + " times" : ""));
    if (daemon.noticed) lines.push_back(daemon.name + " died, and was not restarted");
  }
  return lines;
}

void Daemons::add_to(std::vector<pollfd>& fds) const {
  thread_.check();
  for (const Daemon& daemon : daemons_)
    if (!daemon.noticed) fds.push_back({daemon.child.pidfd(), POLLIN, 0});
}

bool Daemons::look_after(std::int64_t now) {
  thread_.check();
  bool emulator_goes_on = true;
  const bool look = now >= next_look_ns_;
  if (look) next_look_ns_ = now + kLookEveryNs;
  for (Daemon& daemon : daemons_) {
    if (daemon.noticed) continue;
    if (look &&
        (daemon.pulse.hangs(daemon.child.pid(), now) || (daemon.ping && daemon.ping->hangs(now)))) {
      log::warn("{} has hung for {} s and is killed", daemon.name, kHungNs / 1'000'000'000);
      daemon.child.signal(SIGKILL);
    }
    const auto exit = daemon.child.poll();
    if (!exit) continue;
    if (restart(daemon, *exit)) continue;
    daemon.noticed = true;
    notes_.push_back(daemon.name + " died (" + exit->to_string() + ")" +
                     (daemon.coordinator ? ": its XPU's jobs went on unscheduled"
                                         : ": the emulated XPUs are gone"));
    log::warn("{}", notes_.back());
    if (!daemon.coordinator) {
      emulator_died_ = true;
      emulator_goes_on = false;
    }
  }
  return emulator_goes_on;
}

void Daemons::stop(int grace_ms) {
  thread_.check();
  for (Daemon& daemon : daemons_) (void)daemon.child.stop(grace_ms);
}

std::int64_t Daemons::coordinators_cpu_us() const {
  thread_.check();
  std::int64_t sum_us = ended_cpu_us_;
  for (const Daemon& daemon : daemons_)
    if (daemon.coordinator && !daemon.noticed) sum_us += cpu_us(daemon.child);
  return sum_us;
}

}  // namespace xauto::launch
