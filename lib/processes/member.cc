// SPDX-License-Identifier: Apache-2.0
#include "processes/member.h"

#include <algorithm>
#include <cstring>

#include <poll.h>

#include "base/socket.h"

namespace xauto::runtime {

Result<std::unique_ptr<Member>> Member::join(const Plan& plan, const Graph& graph,
                                             const Session& session, std::size_t flows) {
  auto member = std::unique_ptr<Member>(new Member);
  XAUTO_ASSIGN(member->socket_, connect_abstract(session.parts.hub));
  const int socket = member->socket_.get();
  XAUTO_TRY(say(socket, Word::kHello, session.parts.process));
  member->topics_.resize(graph.topics.size());
  for (;;) {
    Packet packet;
    std::vector<UniqueFd> fds;
    XAUTO_ASSIGN(const std::size_t size, receive_packet(socket, &packet, sizeof packet, &fds));
    const Word word = static_cast<Word>(packet.word);
    if (size == sizeof packet && word == Word::kTopic && packet.index < graph.topics.size()) {
      XAUTO_ASSIGN(member->topics_[packet.index], transport::join_link(std::move(fds)));
    } else if (size == sizeof packet && word == Word::kBoard && fds.size() == 1) {
      XAUTO_ASSIGN(member->board_, Board::map(fds[0].get(), shape_of(plan, graph, session, flows)));
    } else if (size == sizeof packet && word == Word::kBegin && member->board_ != nullptr) {
      for (std::size_t t = 0; t < graph.topics.size(); ++t) {
        const Plan::Remote& remote = plan.topics[t];
        const bool ours = remote.publisher == session.parts.process
                              ? !remote.readers.empty()
                              : remote.reader(session.parts.process) >= 0;
        if (ours && member->topics_[t] == nullptr)
          return fail(ErrorCode::kUnavailable, "the app's hub did not share it",
                      "topic '" + graph.topics[t].spec.name + "'");
      }
      return member;
    } else {
      return fail(ErrorCode::kUnavailable, "the app's hub answered with an unknown message");
    }
  }
}

/// Waits for `wanted`; false: Stop came, the hub is gone, or `stop` was set.
Result<bool> Member::hear(Word wanted, const std::atomic<bool>& stop) {
  while (!stop.load()) {
    pollfd ready{socket_.get(), POLLIN, 0};
    if (poll(&ready, 1, 200) <= 0) continue;
    Packet packet;
    const auto size = receive_packet(socket_.get(), &packet, sizeof packet);
    if (!size) return tl::unexpected<Error>(size.error());
    if (*size == sizeof packet && packet.word == static_cast<std::uint32_t>(wanted)) return true;
    if (*size == sizeof packet && packet.word == static_cast<std::uint32_t>(Word::kStop))
      return false;
  }
  return false;
}

Result<bool> Member::ready(const std::atomic<bool>& stop) {
  XAUTO_TRY(say(socket_.get(), Word::kReady));
  return hear(Word::kGo, stop);
}

void Member::tell(int module, std::uint64_t sequence, std::int64_t origin_ns, std::int64_t now_ns,
                  bool lost, const detail::Origins* origins, bool urgent) {
  Packet packet{.word = static_cast<std::uint32_t>(Word::kEvent),
                .index = static_cast<std::uint32_t>(module),
                .sequence = sequence,
                .origin_ns = origin_ns,
                .now_ns = now_ns,
                .lost = lost ? 1u : 0u,
                .rates = origins != nullptr ? 1u : 0u,
                .urgent = urgent ? 1u : 0u};
  if (origins != nullptr) packet.origins = *origins;
  // No result of ours may be lost; a dead hub: we are ended as well.
  (void)send_packet(socket_.get(), &packet, sizeof packet, {}, IfFull::kWait);
}

bool Member::wait_stop(const std::atomic<bool>& stop) {
  const auto heard = hear(Word::kStop, stop);
  return heard.has_value();
}

void Member::report(const std::string& text) {
  std::vector<std::byte> packet(sizeof(Packet) +
                                std::min(text.size(), kMaxReportBytes - sizeof(Packet)));
  const Packet head{.word = static_cast<std::uint32_t>(Word::kReport)};
  std::memcpy(packet.data(), &head, sizeof head);
  std::memcpy(packet.data() + sizeof head, text.data(), packet.size() - sizeof head);
  (void)send_packet(socket_.get(), packet.data(), packet.size(), {}, IfFull::kWait);
}

}  // namespace xauto::runtime
