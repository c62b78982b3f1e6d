// SPDX-License-Identifier: Apache-2.0
// xauto-emud: emulates the XPUs of a platform for one session. Started by the xauto tool.
#include <string>

#include <CLI/CLI.hpp>
#include <signal.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "base/log.h"
#include "base/rt.h"
#include "emu/server.h"
#include "model/json.h"

namespace {

constexpr int kFifoEmulator = 70;  ///< hardware does not wait for threads: above all that we run

int complain(const xauto::Error& error) {
  xauto::log::error("{}", error.to_string());
  return error.code == xauto::ErrorCode::kInvalid || error.code == xauto::ErrorCode::kNotFound ? 2
                                                                                               : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App cli("Emulates the XPUs of a platform; started by the xauto tool.", "xauto-emud");
  std::string platform_path, address;
  int ready_fd = -1;
  cli.add_option("--platform", platform_path, "small, large, or a platform.json")->required();
  cli.add_option("--socket", address, "abstract socket to listen on")->required();
  cli.add_option("--ready-fd", ready_fd, "descriptor that is told when the socket is there");
  try {
    cli.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return cli.exit(e) == 0 ? 0 : 2;
  }

  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  sigprocmask(SIG_BLOCK, &signals, nullptr);
  const xauto::UniqueFd stop(signalfd(-1, &signals, SFD_CLOEXEC));

  const auto platform = xauto::load_platform(platform_path);
  if (!platform) return complain(platform.error());
  auto server = xauto::emu::Server::create(*platform, address);
  if (!server) return complain(server.error());

  xauto::rt::set_timer_slack_1ns();
  xauto::rt::lock_memory();
  if (const auto status = xauto::rt::set_fifo(kFifoEmulator); !status)
    xauto::log::debug("{}", status.error().to_string());
  if (ready_fd >= 0) {
    [[maybe_unused]] const ssize_t told = write(ready_fd, "ready\n", 6);
    close(ready_fd);
  }
  const auto status = (*server)->run(stop.get());
  return status ? 0 : complain(status.error());
}
