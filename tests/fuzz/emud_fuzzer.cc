// SPDX-License-Identifier: Apache-2.0
// Packets to the emulator: the input is cut into packets; the virtual clock moves on between them,
// and the emulator dies now and then: what it has saved, the next one must accept.
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>

#include <fcntl.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/socket.h"
#include "emu/server.h"
#include "model/platform.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const std::string address = "xauto-fuzz/emud-" + std::to_string(getpid());
  static const Platform platform = *Platform::builtin("small");
  const auto listener = listen_abstract(address);
  const auto memory = emu::StateMemory::make();
  if (!listener || !memory) std::abort();
  std::unique_ptr<emu::Server> server;
  const auto begin = [&] {
    auto next =
        emu::Server::create(platform, {.address = address,
                                       .listener_fd = fcntl(listener->get(), F_DUPFD_CLOEXEC, 3),
                                       .memory_fd = fcntl(memory->get(), F_DUPFD_CLOEXEC, 3)});
    if (!next) std::abort();
    server = std::move(*next);
  };
  begin();
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends) != 0)
    std::abort();
  // Virtual, and behind the real one, however short this machine is up: a restored state must not be
  // of the future.
  emu::Nanos now = 0;
  while (size > 0) {
    emu::Packet packet;
    const std::size_t take = std::min(size, sizeof packet);
    std::memcpy(&packet, data, take);
    packet.name[emu::kMaxDeviceName - 1] = '\0';
    if (data[0] % 8 == 0) packet.name[0] = "cgdx"[data[0] / 8 % 4];
    server->handle_packet(ends[0], &packet,
                          take == sizeof packet || data[0] % 16 != 1 ? sizeof packet : take, now);
    now += (data[take - 1] % 64) * 100'000;
    if (data[take / 2] % 4 != 0) server->settle(now);
    if (data[take / 2] % 16 == 1) begin();
    data += take;
    size -= take;
  }
  server->settle(now);
  begin();
  close(ends[0]);
  close(ends[1]);
  return 0;
}
