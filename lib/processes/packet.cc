// SPDX-License-Identifier: Apache-2.0
#include "processes/packet.h"

#include "base/socket.h"

namespace xauto::runtime {

Status say(int socket, Word word, int index, const std::vector<int>& fds) {
  const Packet packet{.word = static_cast<std::uint32_t>(word),
                      .index = static_cast<std::uint32_t>(index)};
  return send_packet(socket, &packet, sizeof packet, fds);
}

}  // namespace xauto::runtime
