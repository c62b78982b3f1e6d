// SPDX-License-Identifier: Apache-2.0
// Packets to the emulator: the input is cut into packets; the virtual clock moves on between them.
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>

#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "emu/server.h"
#include "model/platform.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const std::string address = "xauto-fuzz/emud-" + std::to_string(getpid());
  auto server = emu::Server::create(*Platform::builtin("small"), {.address = address});
  if (!server) std::abort();
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends) != 0)
    std::abort();
  emu::Nanos now = 0;
  while (size > 0) {
    emu::Packet packet;
    const std::size_t take = std::min(size, sizeof packet);
    std::memcpy(&packet, data, take);
    packet.name[emu::kMaxDeviceName - 1] = '\0';
    if (data[0] % 8 == 0) packet.name[0] = "cgdx"[data[0] / 8 % 4];
    (*server)->handle_packet(
        ends[0], &packet, take == sizeof packet || data[0] % 16 != 1 ? sizeof packet : take, now);
    now += (data[take - 1] % 64) * 100'000;
    data += take;
    size -= take;
  }
  close(ends[0]);
  close(ends[1]);
  return 0;
}
