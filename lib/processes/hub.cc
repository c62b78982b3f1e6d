// SPDX-License-Identifier: Apache-2.0
#include "processes/hub.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstring>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/socket.h"
#include "base/thread.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kReadyNs = 60'000'000'000;  ///< init may load weights
constexpr std::int64_t kReportNs = 2'000'000'000;

transport::TopicShape shape_of(const Graph::Topic& topic, std::size_t readers,
                               const Session& session) {
  const detail::TopicSpec& spec = topic.spec;
  return {transport::chunk_bytes_of(spec), static_cast<std::uint32_t>(readers),
          static_cast<std::uint32_t>(session.deployment.queue_depth.value_or(kQueueDepth)),
          static_cast<std::uint32_t>(session.deployment.keep.value_or(kKeep)),
          spec.buffered.make != nullptr};
}

/// Who is dead, or does not read, is cut off: serve() notices both.
void order(int socket, Word word) {
  if (!say(socket, word)) (void)shutdown(socket, SHUT_RDWR);
}

}  // namespace

Result<std::unique_ptr<Hub>> Hub::create(const Plan& plan, const Graph& graph,
                                         const Session& session, std::size_t flows, HubHost& host) {
  auto hub = std::unique_ptr<Hub>(new Hub(plan, graph, host));
  if (session.board_fd >= 0) hub->board_fd_ = UniqueFd(fcntl(session.board_fd, F_DUPFD_CLOEXEC, 3));
  XAUTO_ASSIGN(hub->board_, Board::create(shape_of(plan, graph, session, flows), hub->board_fd_));
  hub->topics_.resize(graph.topics.size());
  for (std::size_t t = 0; t < graph.topics.size(); ++t)
    if (const std::size_t readers = plan.topics[t].readers.size(); readers > 0) {
      XAUTO_ASSIGN(hub->topics_[t],
                   transport::make_link(shape_of(graph.topics[t], readers, session)));
    }
  hub->listener_ = UniqueFd(session.parts.hub_fd);
  if (!hub->listener_) {
    XAUTO_ASSIGN(hub->listener_, listen_abstract(session.parts.hub));
  }
  hub->wake_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!hub->wake_) return fail(ErrorCode::kIo, std::string("eventfd: ") + strerror(errno));
  XAUTO_ASSIGN(hub->thread_, start_thread([h = hub.get()] { h->serve(); }));
  return hub;
}

Hub::~Hub() {
  quit_.store(true);
  if (wake_) signal_eventfd(wake_.get());
  if (thread_.joinable()) thread_.join();
}

void Hub::serve() {
  rt::set_thread_name("xauto/hub");
  while (!quit_.load()) {
    std::vector<pollfd> fds = {{wake_.get(), POLLIN, 0}, {listener_.get(), POLLIN, 0}};
    {
      const Guard lock(mutex_);
      for (const MemberState& member : members_) {
        const bool to_tell = member.told < topics_.size() + 2;
        const auto events = static_cast<short>(to_tell ? POLLIN | POLLOUT : POLLIN);
        if (member.socket) fds.push_back({member.socket.get(), events, 0});
      }
    }
    for (const UniqueFd& stranger : strangers_) fds.push_back({stranger.get(), POLLIN, 0});
    if (poll(fds.data(), fds.size(), -1) < 0) continue;
    if (fds[0].revents != 0) drain_eventfd(wake_.get());
    if (fds[1].revents != 0) accept();
    for (std::size_t i = 2; i < fds.size(); ++i) {
      const int fd = fds[i].fd;
      const bool reads = (fds[i].revents & POLLOUT) != 0, says = (fds[i].revents & ~POLLOUT) != 0;
      if ((!reads || introduce(process_of(fd))) && (!says || hear(fd))) continue;
      if (const int process = process_of(fd); process != 0) lose(process);
      std::erase_if(strangers_, [&](const UniqueFd& s) { return s.get() == fd; });
    }
  }
}

void Hub::accept() {
  auto peer = accept_own(listener_.get());
  if (!peer) {
    refusals_.tell(peer.error().what, now_ns());
    return;
  }
  if (strangers_.size() < 2 * num_members() + 8) strangers_.push_back(std::move(*peer));
}

/// 0: nobody's yet.
int Hub::process_of(int fd) const {
  const Guard lock(mutex_);
  for (std::size_t p = 1; p < members_.size(); ++p)
    if (members_[p].socket.get() == fd) return static_cast<int>(p);
  return 0;
}

/// The first packet of a connection. False: it is over.
bool Hub::let_in(int fd, const Packet& packet) {
  const auto stranger = std::find_if(strangers_.begin(), strangers_.end(),
                                     [&](const UniqueFd& s) { return s.get() == fd; });
  if (packet.index == 0 || packet.index >= num_members() || stranger == strangers_.end())
    return false;
  const Word word = static_cast<Word>(packet.word);
  const Guard lock(mutex_);
  MemberState& member = members_[packet.index];
  if (word == Word::kGone) {
    if (!member.socket) member.state = State::kGone;
    futex_advance(changes_, INT_MAX);
    return false;
  }
  if (word != Word::kHello || member.socket || stopping_) return false;
  member = {State::kStarting, std::move(*stranger), 0};
  strangers_.erase(stranger);
  return true;
}

/// One packet. False: this connection is over.
bool Hub::hear(int fd) {
  alignas(Packet) std::byte room[kMaxReportBytes];
  const auto size = receive_packet(fd, room, sizeof room);
  if (!size || *size < sizeof(Packet)) return false;
  Packet packet;
  std::memcpy(&packet, room, sizeof packet);
  const int process = process_of(fd);
  if (process == 0) return let_in(fd, packet);
  const Word word = static_cast<Word>(packet.word);
  switch (word) {
    case Word::kReady: {
      bool again;
      {
        const Guard lock(mutex_);
        MemberState& member = members_[static_cast<std::size_t>(process)];
        if (member.state != State::kStarting) return false;
        member.state = State::kReady;
        again = begun_;
      }
      if (again) {  // the others run already
        host_.joins(process);
        const Guard lock(mutex_);
        MemberState& member = members_[static_cast<std::size_t>(process)];
        member.state = State::kRunning;
        if (!say(member.socket.get(), Word::kGo)) return false;
      }
      futex_advance(changes_, INT_MAX);
      return true;
    }
    case Word::kEvent:
      if (packet.index >= graph_.modules.size() || plan_.process_of[packet.index] != process)
        return false;  // a broken client hurts only its own modules
      host_.event(packet);
      return true;
    case Word::kReport: {
      const Guard lock(mutex_);
      reports_.emplace_back(reinterpret_cast<const char*>(room + sizeof packet),
                            *size - sizeof packet);
      return true;
    }
    default:
      return false;
  }
}

/// Gives a new member what it reads and publishes, as fast as it reads that: nobody waits for it.
/// False: it cannot have it.
bool Hub::introduce(int process) {
  const Guard lock(mutex_);
  MemberState& member = members_[static_cast<std::size_t>(process)];
  while (member.told < topics_.size() + 2) {
    const Status status = tell(member.socket.get(), process, member.told);
    if (!status && status.error().code == ErrorCode::kTimeout) return true;
    if (!status) {
      log::warn("hub: process {}: {}", process, status.error().to_string());
      return false;
    }
    ++member.told;
  }
  return true;
}

Status Hub::tell(int socket, int process, std::size_t step) {
  if (step == topics_.size()) return say(socket, Word::kBoard, 0, {board_fd_.get()});
  if (step > topics_.size()) return say(socket, Word::kBegin);
  const Plan::Remote& remote = plan_.topics[step];
  const int reader = remote.reader(process);
  if (remote.readers.empty() || (remote.publisher != process && reader < 0)) return {};
  XAUTO_ASSIGN(const std::vector<UniqueFd> fds, topics_[step]->invite(reader));
  std::vector<int> numbers;
  for (const UniqueFd& fd : fds) numbers.push_back(fd.get());
  return say(socket, Word::kTopic, static_cast<int>(step), numbers);
}

/// The member's process has ended, or talks nonsense: then it is cut off, which ends it.
void Hub::lose(int process) {
  bool running, stopping;
  {
    const Guard lock(mutex_);
    MemberState& member = members_[static_cast<std::size_t>(process)];
    running = member.state == State::kRunning;
    member.socket.reset();
    member.state = State::kAbsent;
    stopping = stopping_;
    if (!stopping) deaths_.push_back(process);
  }
  board_->process(process).watched_ns.store(0);  // the next one may need long to start
  for (std::size_t t = 0; t < topics_.size(); ++t) {
    const int reader = plan_.topics[t].reader(process);
    if (reader >= 0) topics_[t]->release_all(static_cast<std::uint32_t>(reader));
  }
  if (running && !stopping) host_.left(process);
  futex_advance(changes_, INT_MAX);
}

Result<bool> Hub::wait_ready(const std::atomic<bool>& stop) {
  const std::int64_t limit = now_ns() + kReadyNs;
  for (;;) {
    const std::uint32_t seen = changes_.load();
    {
      const Guard lock(mutex_);
      bool all = true;
      for (std::size_t p = 1; p < members_.size(); ++p) {
        if (members_[p].state == State::kGone)
          return fail(ErrorCode::kUnavailable, "ended before it was ready",
                      "process " + std::to_string(p) + " of app '" + graph_.name + "'",
                      "its own messages above tell why");
        all = all && members_[p].state == State::kReady;
      }
      if (all) {
        begun_ = true;
        for (std::size_t p = 1; p < members_.size(); ++p) {
          members_[p].state = State::kRunning;
          order(members_[p].socket.get(), Word::kGo);
        }
        return true;
      }
    }
    if (stop.load()) return false;
    if (now_ns() > limit)
      return fail(ErrorCode::kTimeout, "a module process was not ready within 60 s",
                  "app '" + graph_.name + "'");
    futex_wait(changes_, seen);
  }
}

void Hub::kill(int process) {
  const Guard lock(mutex_);
  const MemberState& member = members_[static_cast<std::size_t>(process)];
  // The kernel's word, not the member's; the pid is its own as long as the socket is connected.
  if (stopping_ || !member.socket) return;
  if (const auto peer = peer_of(member.socket.get()); peer && peer->pid > 0)
    (void)::kill(peer->pid, SIGKILL);
}

std::vector<std::string> Hub::stop() {
  {
    const Guard lock(mutex_);
    stopping_ = true;
    for (const MemberState& member : members_)
      if (member.socket) order(member.socket.get(), Word::kStop);
  }
  const std::int64_t limit = now_ns() + kReportNs;
  for (;;) {
    const std::uint32_t seen = changes_.load();
    {
      const Guard lock(mutex_);
      const bool left = std::none_of(members_.begin(), members_.end(), [](const MemberState& m) {
        return static_cast<bool>(m.socket);
      });
      if (left || now_ns() > limit) return reports_;
    }
    futex_wait(changes_, seen);
  }
}

std::vector<int> Hub::deaths() const {
  const Guard lock(mutex_);
  return deaths_;
}

}  // namespace xauto::runtime
