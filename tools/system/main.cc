// SPDX-License-Identifier: Apache-2.0
// xauto-system: one coordinator per XPU instance of the machine, for all runs that ask (docs/claims.md). Started by
// systemd, which has its socket; or by hand, with --socket. A program of its own beside xauto-coordinator, which keeps
// all of its memory resident: the test of who may come is the checker's.
#include <cstdlib>
#include <string>
#include <utility>

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "base/daemon.h"
#include "base/log.h"
#include "base/process.h"
#include "base/socket.h"
#include "cli/cli.h"
#include "launch/system_service.h"
#include "solver/keys/check.h"

namespace {

constexpr int kFirstPassed = 3;  ///< sd_listen_fds(3): where systemd's descriptors begin

int complain(const xauto::Error& error) {
  xauto::log::error("{}", error.to_string());
  return error.code == xauto::ErrorCode::kInvalid ? 2 : 1;
}

/// As systemd hands it over, and then `path` becomes that one's; else one of our own.
xauto::Result<xauto::UniqueFd> listener(std::string& path) {
  const char* pid = std::getenv("LISTEN_PID");
  const char* count = std::getenv("LISTEN_FDS");
  const bool passed = pid != nullptr && count != nullptr && std::to_string(getpid()) == pid &&
                      std::string(count) == "1";
  if (passed) {
    // Coordinators are no business of systemd's.
    unsetenv("LISTEN_PID");
    unsetenv("LISTEN_FDS");
    sockaddr_un name{};
    socklen_t bytes = sizeof name;
    if (getsockname(kFirstPassed, reinterpret_cast<sockaddr*>(&name), &bytes) != 0)
      return xauto::fail(xauto::ErrorCode::kInvalid,
                         "the descriptor that systemd passed is no socket", "LISTEN_FDS");
    path = name.sun_path;
    return xauto::UniqueFd(kFirstPassed);
  }
  return xauto::listen_path(path, 0660);
}

}  // namespace

int main(int argc, char** argv) {
  xauto::open_standard_streams();
  xauto::cli::Program cli("One coordinator per XPU instance of the machine, for all runs that ask.",
                          "xauto-system");
  std::string path = xauto::launch::kSystemSocket, trusted = "all";
  bool suspend_foreign = false;
  cli.option("--socket", path, "where to listen, unless systemd has the socket").shown();
  cli.option("--trust", trusted,
             "whose runs keep what they state: all who may connect, nobody, or names of users with "
             "commas between "
             "them, beside root and the service's own user. What others ask for is enforced")
      .shown();
  cli.flag(
         "--suspend-foreign", suspend_foreign,
         "on a Jetson's GPU and DLAs: suspend work of processes that know nothing of XAuto while a "
         "job of a run that has joined has the XPU. Needs xauto.ko, CAP_SYS_NICE and "
         "CAP_SYS_PTRACE")
      .shown();
  cli.version("xauto-system " XAUTO_VERSION);
  if (const auto status = cli.parse(argc, argv)) return *status;
  const xauto::UniqueFd stop = xauto::daemon::stop_signals();
  auto trust = xauto::launch::Trust::parse(trusted);
  if (!trust) return complain(trust.error());
  auto socket = listener(path);
  if (!socket) return complain(socket.error());
  xauto::launch::SystemService service({.bin = xauto::program_directory(),
                                        .listener = std::move(*socket),
                                        .path = path,
                                        .admission = xauto::solver::keys::check_together,
                                        .slack = xauto::solver::keys::slack_together,
                                        .trust = std::move(*trust),
                                        .suspend_foreign = suspend_foreign});
  service.run(stop.get());
  return 0;
}
