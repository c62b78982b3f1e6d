// SPDX-License-Identifier: Apache-2.0
// xauto-emud: emulates the XPUs of a platform for one session. Started by the xauto tool.
#include <string>

#include "base/daemon.h"
#include "base/log.h"
#include "cli/cli.h"
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
  xauto::cli::Program cli("Emulates the XPUs of a platform; started by the xauto tool.",
                          "xauto-emud");
  std::string platform_path, script_path;
  xauto::emu::ServerOptions options;
  int ready_fd = -1;
  cli.option("--platform", platform_path, xauto::kPlatformNames).required();
  cli.option("--script", script_path, "emulation.json: what happens to the XPUs meanwhile");
  cli.option("--socket", options.address, "abstract socket to listen on").required();
  cli.option("--listen-fd", options.listener_fd,
             "the listening socket, kept by who starts us again");
  cli.option("--memory-fd", options.memory_fd, "memory of the state, likewise");
  cli.option("--ready-fd", ready_fd, "descriptor that is told when the socket is there");
  if (const auto status = cli.parse(argc, argv)) return *status;

  const xauto::UniqueFd stop = xauto::daemon::stop_signals();

  const auto platform = xauto::load_platform(platform_path);
  if (!platform) return complain(platform.error());
  if (!script_path.empty()) {
    auto script = xauto::load_emulation_script(script_path, *platform);
    if (!script) return complain(script.error());
    options.script = std::move(*script);
  }
  auto server = xauto::emu::Server::create(*platform, options);
  if (!server) return complain(server.error());

  xauto::daemon::settle("xauto-emud", kFifoEmulator);
  xauto::daemon::tell_ready(ready_fd);
  const auto status = (*server)->run(stop.get());
  return status ? 0 : complain(status.error());
}
