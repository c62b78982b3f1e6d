// SPDX-License-Identifier: Apache-2.0
#include "launch/desk.h"

#include <utility>

#include "base/socket.h"
#include "processes/mode.h"
#include "processes/parameters.h"

namespace xauto::launch {

void Desk::add_to(std::vector<pollfd>& fds) const {
  thread_.check();
  fds.push_back({listener_.get(), POLLIN, 0});
  for (const Client& client : clients_) fds.push_back({client.socket.get(), POLLIN, 0});
}

void Desk::serve(std::int64_t now_ns) {
  thread_.check();
  constexpr int kMostAtOnce = 64;  // as many as wait: strangers could go on for ever
  for (int i = 0; i < kMostAtOnce && wait_readable(listener_.get(), 0); ++i) {
    auto peer = accept_own(listener_.get());
    if (!peer && peer.error().code != ErrorCode::kPermission) break;
    if (!peer) continue;
    if (clients_.size() == kMaxClients) clients_.erase(clients_.begin());
    clients_.push_back({std::move(*peer), now_ns});
  }
  std::erase_if(clients_, [&](const Client& client) {
    return answer(client.socket.get()) || now_ns - client.since_ns > kPatienceNs;
  });
}

bool Desk::answer(int client) {
  if (!wait_readable(client, 0)) return false;
  std::string request(runtime::kMaxParameterRequest, '\0');
  const auto size = receive_packet(client, request.data(), request.size());
  if (!size) return true;
  if (board_ == nullptr)
    if (auto board = runtime::Board::steer(board_fd_)) board_ = std::move(*board);
  const std::string text =
      runtime::answer_request(std::string_view(request).substr(0, *size), board_.get());
  (void)send_packet(client, text.data(), text.size());  // who does not read needs no answer
  return true;
}

}  // namespace xauto::launch
