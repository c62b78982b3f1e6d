// SPDX-License-Identifier: Apache-2.0
// xauto-coordinator: decides who may use one XPU instance. Started by the xauto tool, one per XPU of a run, or by
// xauto-system, one per XPU of the machine.
#include <string>

#include "base/daemon.h"
#include "base/log.h"
#include "base/memory_file.h"
#include "cli/cli.h"
#include "coord/server.h"
#include "session/session.h"
#include "xpu/kind.h"

namespace {

constexpr int kFifoCoordinator = 60;  ///< above every thread that waits for its decisions

int complain(const xauto::Error& error) {
  xauto::log::error("{}", error.to_string());
  return error.code == xauto::ErrorCode::kInvalid ? 2 : 1;
}

xauto::Result<xauto::coord::ServerOptions> options_for(const std::string& xpu, int session_fd) {
  XAUTO_ASSIGN(const std::string text, xauto::read_memory_file(session_fd));
  XAUTO_ASSIGN(const xauto::runtime::Session session, xauto::runtime::parse_session(text));
  const int index = session.platform.find(xpu);
  if (index < 0)
    return xauto::fail(xauto::ErrorCode::kInvalid, "is not an XPU of the platform", xpu);
  xauto::coord::ServerOptions options;
  options.xpu = xpu;
  const xauto::Xpu& instance = session.platform.xpus[static_cast<std::size_t>(index)];
  options.discipline =
      xauto::xpu::discipline_of(instance, session.emulated(index), session.cpu.by_keys);
  options.levels = xauto::xpu::levels_of(instance, session.emulated(index));
  options.by_keys = session.keys.has_value();
  for (std::size_t table = 0; table < session.num_tables(); ++table)
    for (const auto& xnode : session.app.xnodes) options.xnodes.push_back(xnode.name);
  options.order = session.order_on(index);
  return options;
}

xauto::Result<xauto::coord::ServerOptions> shared_options(const std::string& xpu, int discipline,
                                                          int levels) {
  xauto::coord::ServerOptions options;
  options.xpu = xpu;
  options.shared = true;
  options.discipline = static_cast<xauto::Discipline>(discipline);
  options.levels = levels;
  options.by_keys = true;
  return options;
}

}  // namespace

int main(int argc, char** argv) {
  xauto::cli::Program cli("Decides who may use one XPU instance; started by the xauto tool.",
                          "xauto-coordinator");
  std::string xpu, address;
  int session_fd = -1, ready_fd = -1, listen_fd = -1, memory_fd = -1, doorbell_fd = -1;
  int shared_as = -1, levels = 0, record_fd = -1;
  cli.option("--xpu", xpu, "XPU instance, e.g. gpu0").required();
  cli.option("--socket", address, "abstract socket to listen on");
  cli.option("--session-fd", session_fd, "descriptor of the session's text");
  cli.option("--shared-as", shared_as,
             "discipline of an XPU that several runs share, in place of these two")
      .range(0, 3);
  cli.option("--levels", levels, "of such an XPU, where the hardware has them");
  cli.option("--ready-fd", ready_fd, "descriptor that is told when the socket is there");
  cli.option("--listen-fd", listen_fd, "the socket, listening: it outlives a coordinator");
  cli.option("--memory-fd", memory_fd, "the shared memory, which outlives it, too");
  cli.option("--doorbell-fd", doorbell_fd, "and the doorbell");
  cli.option("--record-fd", record_fd, "of such an XPU, memory that says who has had it");
  if (const auto status = cli.parse(argc, argv)) return *status;
  if (shared_as < 0 && (session_fd < 0 || address.empty()))
    return complain(xauto::Error{
        xauto::ErrorCode::kInvalid, "needs --socket and --session-fd, or --shared-as", xpu, {}});

  const xauto::UniqueFd stop = xauto::daemon::stop_signals();

  auto options =
      shared_as < 0 ? options_for(xpu, session_fd) : shared_options(xpu, shared_as, levels);
  if (!options) return complain(options.error());
  options->address = address;
  options->listener_fd = listen_fd;
  options->memory_fd = memory_fd;
  options->doorbell_fd = doorbell_fd;
  options->record_fd = record_fd;
  auto server = xauto::coord::Server::create(std::move(*options));
  if (!server) return complain(server.error());

  xauto::daemon::settle(xpu, kFifoCoordinator);
  xauto::daemon::tell_ready(ready_fd);
  const auto status = (*server)->run(stop.get());
  return status ? 0 : complain(status.error());
}
