// SPDX-License-Identifier: Apache-2.0
// xauto-cpusched: holds the sched_ext scheduler of one run. A process of its own, so that whatever
// happens to it, the app goes on: when it ends, in whatever way, the kernel goes back to its own
// scheduler. Started by the xauto tool (lib/kernel/scx_process.cc).
//
// Tells on --ready-fd, in one line, "ok WHY" or "no WHY" (a second line: what to do); then runs
// until it is told to stop (status 0) or the kernel ends the scheduler (status 1, the reason on
// stderr).
#include <optional>
#include <string>

#include <poll.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "base/daemon.h"
#include "base/log.h"
#include "cli/cli.h"
#include "kernel/run_maps.h"
#include "kernel/scx_scheduler.h"

namespace {

constexpr int kLookMs = 100;  ///< how soon an ejection is noticed

void tell(int fd, const std::string& text) {
  if (fd < 0) {
    xauto::log::info("{}", text);
    return;
  }
  (void)!write(fd, text.data(), text.size());
  close(fd);
}

/// Beside another process's scheduler, for an app that joined its run: ends when that one does.
int follow(const xauto::kernel::RunMaps& maps, int ready_fd) {
  const xauto::UniqueFd stop = xauto::daemon::stop_signals();
  const volatile std::uint32_t& running = maps.sched().running;
  constexpr int kReloadLooks = 50;  ///< a scheduler that is loaded again is away for seconds
  if (running == 0) {
    tell(ready_fd, "no the sched_ext scheduler of run " + maps.run() + " has ended");
    return 1;
  }
  tell(ready_fd, "ok " +
                     std::string(maps.sched().mode == XAUTO_BPF_MODE_PARTIAL ? "partial" : "full") +
                     " mode, beside run " + maps.run());
  for (int away = 0; away < kReloadLooks;) {
    pollfd wait{stop.get(), POLLIN, 0};
    if (poll(&wait, 1, kLookMs) > 0) return 0;
    if (running != 0)
      away = 0;
    else if (!xauto::kernel::scx_asks_restart(maps.sched()))
      break;
    else
      ++away;
  }
  xauto::log::error("the sched_ext scheduler of run {} has ended", maps.run());
  return 1;
}

int serve(const std::string& run, const xauto::kernel::ScxOptions& options, bool join,
          int ready_fd) {
  const xauto::UniqueFd stop = xauto::daemon::stop_signals();
  const auto refuse = [&](const xauto::Error& error) {
    tell(ready_fd, "no " + error.what + (error.hint.empty() ? "" : "\n" + error.hint));
    return error.code == xauto::ErrorCode::kInvalid ? 2 : 1;
  };
  auto maps = xauto::kernel::RunMaps::open(run);
  if (!maps) return refuse(maps.error());
  if (join) return follow(*maps, ready_fd);
  std::optional<xauto::kernel::ScxScheduler> scheduler;
  const auto load = [&]() -> xauto::Status {
    scheduler.reset();
    XAUTO_ASSIGN(auto loaded, xauto::kernel::ScxScheduler::load(*maps, options));
    scheduler.emplace(std::move(loaded));
    return {};
  };
  if (const auto loaded = load(); !loaded) return refuse(loaded.error());
  tell(ready_fd, "ok " + scheduler->choice().why);
  for (;;) {
    pollfd wait{stop.get(), POLLIN, 0};
    if (poll(&wait, 1, kLookMs) > 0) return 0;
    if (const auto exit = xauto::kernel::scx_exit_of(maps->sched())) {
      if (xauto::kernel::scx_asks_restart(maps->sched()) && load()) {
        xauto::log::warn("the sched_ext scheduler was loaded again: {}", *exit);
        continue;
      }
      xauto::log::error("the kernel ended the sched_ext scheduler: {}", *exit);
      const std::string dump = scheduler ? scheduler->dump() : std::string();
      if (dump.empty()) return 1;
      const xauto::Status kept = xauto::kernel::keep_scx_dump("", run, *exit, dump);
      if (!kept) xauto::log::error("its dump is lost: {}", kept.error().to_string());
      return 1;
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  xauto::cli::Program root("Holds XAuto's sched_ext scheduler for one run. Started by `xauto run`.",
                           "xauto-cpusched");
  std::string run, mode = "auto", cpus;
  int ready_fd = -1;
  bool join = false;
  xauto::kernel::ScxOptions options;
  root.version(XAUTO_VERSION);
  root.option("--run", run, "name of the run below /sys/fs/bpf/xauto").required();
  root.option("--cpus", cpus, "CPUs of the policy: \"2-3\"; partial mode if all are isolated");
  root.option("--mode", mode, "auto, full: all threads are ours; partial: SCHED_EXT ones only")
      .one_of({"auto", "full", "partial"})
      .shown();
  root.duration("--timeout", options.timeout_ms, xauto::cli::Unit::kMilliseconds, 100, 30'000,
                "the kernel's watchdog");
  root.option("--floor-permille", options.floor_permille, "CPU share kept for everybody else")
      .range(0u, 500u)
      .shown();
  root.duration("--floor-burst", options.floor_burst_us, xauto::cli::Unit::kMicroseconds, 1000, 1e6,
                "how much of it may be saved up");
  root.duration("--slice", options.xnode_slice_us, xauto::cli::Unit::kMicroseconds, 500, 100'000,
                "how often floor and budgets are looked at");
  root.duration("--age", options.age_ms, xauto::cli::Unit::kMilliseconds, 10, 20'000,
                "after which an XNode that waits gets a turn");
  root.flag("--join", join, "load nothing: follow the run's scheduler, which is there already");
  root.option("--ready-fd", ready_fd, "tell here when the scheduler is enabled, or why not");
  if (const auto status = root.parse(argc, argv)) return *status;
  options.mode = mode == "full"      ? xauto::kernel::ScxMode::kFull
                 : mode == "partial" ? xauto::kernel::ScxMode::kPartial
                                     : xauto::kernel::ScxMode::kAuto;
  options.cpus = xauto::kernel::parse_cpu_list(cpus);
  prctl(PR_SET_NAME, "xauto-cpusched");
  return serve(run, options, join, ready_fd);
}
