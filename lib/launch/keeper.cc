// SPDX-License-Identifier: Apache-2.0
#include "launch/keeper.h"

#include <cerrno>
#include <climits>
#include <cstdlib>
#include <cstring>
#include <optional>

#include <dlfcn.h>
#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/memory_file.h"
#include "base/rt.h"
#include "base/socket.h"
#include "base/thread.h"
#include "launch/cpu_run.h"
#include "processes/marks.h"

namespace xauto::launch {
namespace {

constexpr int kLookMs = 200;

/// The folder of the program or library that this code is in.
std::string own_folder() {
  Dl_info info{};
  char path[PATH_MAX];
  if (dladdr(reinterpret_cast<const void*>(&find_programs), &info) == 0 ||
      realpath(info.dli_fname, path) == nullptr)
    return program_directory();
  const std::string file = path;
  return file.substr(0, file.rfind('/'));
}

bool has_programs(const std::string& folder) {
  return access((folder + "/xauto-coordinator").c_str(), X_OK) == 0 &&
         access((folder + "/xauto-emud").c_str(), X_OK) == 0;
}

}  // namespace

Result<std::string> find_programs(const std::string& given) {
  const char* variable = std::getenv("XAUTO_PROGRAMS");
  const std::string named = !given.empty() ? given : variable != nullptr ? variable : "";
  if (!named.empty()) {
    if (has_programs(named)) return named;
    return fail(ErrorCode::kNotFound, "xauto-coordinator and xauto-emud are not there", named,
                given.empty() ? "XAUTO_PROGRAMS names this folder"
                              : "RunOptions::programs names this folder");
  }
  // Beside a program of the build folder, beside its library; lib/ or lib/<triplet>/, installed.
  const std::string here = own_folder();
  for (const char* relative : {"", "/../bin", "/../libexec/xauto", "/../../libexec/xauto"})
    if (has_programs(here + relative)) return here + relative;
  if (has_programs("/usr/libexec/xauto")) return std::string("/usr/libexec/xauto");
  return fail(ErrorCode::kNotFound, "xauto-coordinator and xauto-emud are not to be found", here,
              "install xauto-tools, or name their folder with RunOptions::programs or in "
              "XAUTO_PROGRAMS");
}

Result<std::unique_ptr<Keeper>> Keeper::start(runtime::Session& session, const std::string& bin,
                                              std::function<void()> lost) {
  auto keeper = std::unique_ptr<Keeper>(new Keeper);
  keeper->lost_ = std::move(lost);
  keeper->quit_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!keeper->quit_) return fail(ErrorCode::kIo, std::string("eventfd: ") + strerror(errno));
  std::promise<Status> promise;
  std::future<Status> started = promise.get_future();
  sigset_t all, before;  // the host's signals are handled on the host's threads
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  auto thread = start_thread([&, k = keeper.get(), p = std::move(promise)]() mutable {
    k->keep(session, bin, std::move(p));
  });
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  XAUTO_ASSIGN(keeper->thread_, std::move(thread));
  XAUTO_TRY(started.get());
  return keeper;
}

Keeper::~Keeper() {
  stop();
}

const std::vector<std::string>& Keeper::who_died() const {
  owner_.check();
  return died_;
}

const std::vector<std::string>& Keeper::stop() {
  owner_.check();
  if (thread_.joinable()) {
    signal_eventfd(quit_.get());
    thread_.join();
  }
  return notes_;
}

/// `session` and `bin` are the starter's, until `started` is set.
void Keeper::keep(runtime::Session& session, const std::string& bin, std::promise<Status> started) {
  rt::set_thread_name("xauto/daemons");
  Daemons daemons(bin, notes_);
  UniqueFd file;
  std::vector<UniqueFd> marks;
  std::optional<DeployedPolicy> policy;
  const auto begin = [&]() -> Status {
    std::vector<std::string> names = socket_names(session);
    const std::vector<std::string> of_xpus = runtime::marks_of(session);
    names.insert(names.end(), of_xpus.begin(), of_xpus.end());
    XAUTO_ASSIGN(Sockets sockets, Sockets::open(names));
    for (const std::string& mark : of_xpus) marks.push_back(sockets.take(mark));
    session.own_sockets = sockets.stem();
    XAUTO_TRY(daemons.start_emulator(session, sockets));
    emulator_ = daemons.emulator();
    if (auto deployed = deploy_policy(session, sockets.run(), nullptr)) {
      policy.emplace(std::move(*deployed));
      session.cpu.policy = sockets.run();
    } else {
      log::info("the policy is in no BPF map, for bpftool to show: {}",
                deployed.error().to_string());
    }
    if (session.scheduling != runtime::Scheduling::kXAuto) return {};
    decide_cpu_by_keys(session);  // App::run has no sched_ext to ask for
    for (const Xpu& xpu : session.platform.xpus)
      session.coordinators[xpu.id] = sockets.address(xpu.id);
    XAUTO_ASSIGN(file, make_memory_file("xauto-session"));
    XAUTO_ASSIGN(const std::string text, to_json(session));
    XAUTO_TRY(write_memory_file(file.get(), text));
    return daemons.start_coordinators(session, sockets, file.get());
  };
  Status begun = begin();
  const bool good = begun.has_value();
  started.set_value(std::move(begun));
  while (good) {
    std::vector<pollfd> fds = {{quit_.get(), POLLIN, 0}};
    daemons.add_to(fds);
    poll(fds.data(), fds.size(), kLookMs);
    if (fds.front().revents != 0) break;
    if (!daemons.look_after(now_ns())) lost_();
  }
  died_ = daemons.who_died();
  daemons.stop(kGraceMs);
}

}  // namespace xauto::launch
