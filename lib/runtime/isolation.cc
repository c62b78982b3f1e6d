// SPDX-License-Identifier: Apache-2.0
#include "runtime/isolation.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstring>
#include <set>

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

namespace xauto::runtime {
namespace {

constexpr std::int64_t kReadyNs = 60'000'000'000;  ///< init may load weights
constexpr std::int64_t kReportNs = 2'000'000'000;

Status say(int socket, Word word, int index = 0, const std::vector<int>& fds = {}) {
  const Packet packet{.word = static_cast<std::uint32_t>(word),
                      .index = static_cast<std::uint32_t>(index)};
  return send_packet(socket, &packet, sizeof packet, fds);
}

BoardShape board_shape(const Plan& plan, const Graph& graph, std::size_t flows) {
  return {static_cast<std::uint32_t>(plan.processes),
          static_cast<std::uint32_t>(graph.modules.size()),
          static_cast<std::uint32_t>(graph.nodes.size()), static_cast<std::uint32_t>(flows)};
}

transport::TopicShape shape_of(const Graph::Topic& topic, std::size_t readers,
                               const Session& session) {
  const detail::TopicSpec& spec = topic.spec;
  return {spec.plain_bytes > 0 ? spec.plain_bytes : spec.max_bytes,
          static_cast<std::uint32_t>(readers),
          static_cast<std::uint32_t>(session.deployment.queue_depth.value_or(kQueueDepth)),
          static_cast<std::uint32_t>(session.deployment.keep.value_or(kKeep))};
}

}  // namespace

// ---- who is where ------------------------------------------------------------------------------

int Plan::Remote::reader(int process) const {
  const auto at = std::find(readers.begin(), readers.end(), process);
  return at == readers.end() ? -1 : static_cast<int>(at - readers.begin());
}

Result<Plan> Plan::make(const Graph& graph, const detail::AppSpecErased& app,
                        const Session& session) {
  Plan plan;
  plan.process_of.assign(graph.modules.size(), 0);
  plan.topics.resize(graph.topics.size());
  plan.processes = static_cast<int>(session.processes.size()) + 1;
  if (session.processes.size() >= kMaxProcesses)
    return fail(ErrorCode::kInvalid,
                "has " + std::to_string(session.processes.size()) + " processes, at most " +
                    std::to_string(kMaxProcesses - 1) + " are possible",
                "app '" + graph.name + "'");
  for (std::size_t p = 0; p < session.processes.size(); ++p)
    for (const std::string& name : session.processes[p]) {
      const auto module = std::find_if(graph.modules.begin(), graph.modules.end(),
                                       [&](const Graph::Module& m) { return m.name == name; });
      if (module == graph.modules.end())
        return fail(ErrorCode::kInvalid, "is not a module of the program",
                    "XModule '" + name + "'");
      int& process = plan.process_of[static_cast<std::size_t>(module - graph.modules.begin())];
      if (process != 0)
        return fail(ErrorCode::kInvalid, "is given to two processes", "XModule '" + name + "'");
      process = static_cast<int>(p) + 1;
    }
  for (std::size_t t = 0; t < graph.topics.size(); ++t) {
    const Graph::Topic& topic = graph.topics[t];
    Remote& remote = plan.topics[t];
    remote.publisher =
        topic.module < 0 ? 0 : plan.process_of[static_cast<std::size_t>(topic.module)];
    std::set<int> readers;
    for (const Graph::Subscriber& s : topic.subscribers)
      readers.insert(plan.process_of[static_cast<std::size_t>(s.module)]);
    for (const detail::ObserverSpec& observer : app.observers)
      if (observer.topic.name == topic.spec.name) readers.insert(0);
    readers.erase(remote.publisher);
    remote.readers.assign(readers.begin(), readers.end());
    if (remote.readers.empty()) continue;
    if (remote.readers.size() > transport::kMaxTopicSubscribers)
      return fail(ErrorCode::kInvalid,
                  "is read by " + std::to_string(remote.readers.size()) + " processes, at most " +
                      std::to_string(transport::kMaxTopicSubscribers) + " are possible",
                  "topic '" + topic.spec.name + "'");
    if (topic.spec.plain_bytes == 0 &&
        (topic.spec.encode == nullptr || topic.spec.decode == nullptr))
      return fail(ErrorCode::kInvalid,
                  "messages of type " + topic.spec.type_name + " cannot leave their process",
                  "topic '" + topic.spec.name + "'",
                  "specialise xauto::Codec for it, or keep its modules in one process");
  }
  return plan;
}

// ---- hub ---------------------------------------------------------------------------------------

Result<std::unique_ptr<Hub>> Hub::create(const Plan& plan, const Graph& graph,
                                         const Session& session, std::size_t flows, HubHost& host) {
  auto hub = std::unique_ptr<Hub>(new Hub(plan, graph, host));
  if (session.board_fd >= 0) hub->board_fd_ = UniqueFd(fcntl(session.board_fd, F_DUPFD_CLOEXEC, 3));
  XAUTO_ASSIGN(hub->board_, Board::create(board_shape(plan, graph, flows), hub->board_fd_));
  hub->topics_.resize(graph.topics.size());
  for (std::size_t t = 0; t < graph.topics.size(); ++t)
    if (const std::size_t readers = plan.topics[t].readers.size(); readers > 0) {
      XAUTO_ASSIGN(hub->topics_[t],
                   transport::make_link(shape_of(graph.topics[t], readers, session)));
    }
  hub->members_.resize(static_cast<std::size_t>(plan.processes));
  hub->listener_ = UniqueFd(session.hub_fd);
  if (!hub->listener_) {
    XAUTO_ASSIGN(hub->listener_, listen_abstract(session.hub));
  }
  hub->wake_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!hub->wake_) return fail(ErrorCode::kIo, std::string("eventfd: ") + strerror(errno));
  hub->thread_ = std::thread([h = hub.get()] { h->serve(); });
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
      const std::lock_guard lock(mutex_);
      for (const Member& member : members_)
        if (member.socket) fds.push_back({member.socket.get(), POLLIN, 0});
    }
    for (const UniqueFd& stranger : strangers_) fds.push_back({stranger.get(), POLLIN, 0});
    if (poll(fds.data(), fds.size(), -1) < 0) continue;
    if (fds[0].revents != 0) drain_eventfd(wake_.get());
    if (fds[1].revents != 0) accept();
    for (std::size_t i = 2; i < fds.size(); ++i) {
      if (fds[i].revents == 0) continue;
      const int fd = fds[i].fd;
      if (hear(fd)) continue;
      int process = 0;
      {
        const std::lock_guard lock(mutex_);
        for (std::size_t p = 1; p < members_.size(); ++p)
          if (members_[p].socket.get() == fd) process = static_cast<int>(p);
      }
      if (process != 0) lose(process);
      std::erase_if(strangers_, [&](const UniqueFd& s) { return s.get() == fd; });
    }
  }
}

void Hub::accept() {
  auto peer = accept_own(listener_.get());
  if (!peer) {
    log::warn("hub: {}", peer.error().what);
    return;
  }
  if (strangers_.size() < 2 * members_.size() + 8) strangers_.push_back(std::move(*peer));
}

/// One packet. False: this connection is over.
bool Hub::hear(int fd) {
  alignas(Packet) std::byte room[kMaxReportBytes];
  const auto size = receive_packet(fd, room, sizeof room);
  if (!size || *size < sizeof(Packet)) return false;
  Packet packet;
  std::memcpy(&packet, room, sizeof packet);
  int process = 0;
  {
    const std::lock_guard lock(mutex_);
    for (std::size_t p = 1; p < members_.size(); ++p)
      if (members_[p].socket.get() == fd) process = static_cast<int>(p);
  }
  const Word word = static_cast<Word>(packet.word);
  if (process == 0) {
    const auto stranger = std::find_if(strangers_.begin(), strangers_.end(),
                                       [&](const UniqueFd& s) { return s.get() == fd; });
    if (packet.index == 0 || packet.index >= members_.size() || stranger == strangers_.end())
      return false;
    const int who = static_cast<int>(packet.index);
    if (word == Word::kGone) {
      const std::lock_guard lock(mutex_);
      Member& member = members_[packet.index];
      if (!member.socket) member.state = State::kGone;
      futex_advance(changes_, INT_MAX);
      return false;
    }
    if (word != Word::kHello) return false;
    {
      const std::lock_guard lock(mutex_);
      Member& member = members_[packet.index];
      if (member.socket || stopping_) return false;
      member.socket = std::move(*stranger);
      member.state = State::kStarting;
      strangers_.erase(stranger);
    }
    const Status status = introduce(who);
    if (!status) log::warn("hub: process {}: {}", who, status.error().to_string());
    return status.has_value();
  }
  switch (word) {
    case Word::kReady: {
      bool again;
      {
        const std::lock_guard lock(mutex_);
        Member& member = members_[static_cast<std::size_t>(process)];
        if (member.state != State::kStarting) return false;
        member.state = State::kReady;
        again = begun_;
      }
      if (again) {  // the others run already
        host_.joins(process);
        const std::lock_guard lock(mutex_);
        Member& member = members_[static_cast<std::size_t>(process)];
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
      const std::lock_guard lock(mutex_);
      reports_.emplace_back(reinterpret_cast<const char*>(room + sizeof packet),
                            *size - sizeof packet);
      return true;
    }
    default:
      return false;
  }
}

/// Gives a new member what it reads and publishes.
Status Hub::introduce(int process) {
  const int socket = members_[static_cast<std::size_t>(process)].socket.get();
  for (std::size_t t = 0; t < topics_.size(); ++t) {
    const Plan::Remote& remote = plan_.topics[t];
    if (remote.readers.empty()) continue;
    const bool publishes = remote.publisher == process;
    if (!publishes && remote.reader(process) < 0) continue;
    XAUTO_ASSIGN(const std::vector<UniqueFd> fds, topics_[t]->invite(publishes));
    std::vector<int> numbers;
    for (const UniqueFd& fd : fds) numbers.push_back(fd.get());
    XAUTO_TRY(say(socket, Word::kTopic, static_cast<int>(t), numbers));
  }
  XAUTO_TRY(say(socket, Word::kBoard, 0, {board_fd_.get()}));
  return say(socket, Word::kBegin);
}

/// The member's process has ended, or talks nonsense: then it is cut off, which ends it.
void Hub::lose(int process) {
  bool running, stopping;
  {
    const std::lock_guard lock(mutex_);
    Member& member = members_[static_cast<std::size_t>(process)];
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
      const std::lock_guard lock(mutex_);
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
          (void)say(members_[p].socket.get(), Word::kGo);  // its death is noticed by serve()
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
  const std::lock_guard lock(mutex_);
  const Member& member = members_[static_cast<std::size_t>(process)];
  ucred peer{};
  socklen_t size = sizeof peer;
  // The kernel's word, not the member's; the pid is its own as long as the socket is connected.
  if (stopping_ || !member.socket ||
      getsockopt(member.socket.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 || peer.pid <= 0)
    return;
  (void)::kill(peer.pid, SIGKILL);
}

std::vector<std::string> Hub::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    for (const Member& member : members_)
      if (member.socket) (void)say(member.socket.get(), Word::kStop);
  }
  const std::int64_t limit = now_ns() + kReportNs;
  for (;;) {
    const std::uint32_t seen = changes_.load();
    {
      const std::lock_guard lock(mutex_);
      const bool left = std::none_of(members_.begin(), members_.end(),
                                     [](const Member& m) { return static_cast<bool>(m.socket); });
      if (left || now_ns() > limit) return reports_;
    }
    futex_wait(changes_, seen);
  }
}

std::vector<int> Hub::deaths() const {
  const std::lock_guard lock(mutex_);
  return deaths_;
}

// ---- member ------------------------------------------------------------------------------------

Result<std::unique_ptr<Member>> Member::join(const Plan& plan, const Graph& graph,
                                             const Session& session, std::size_t flows) {
  auto member = std::unique_ptr<Member>(new Member);
  XAUTO_ASSIGN(member->socket_, connect_abstract(session.hub));
  const int socket = member->socket_.get();
  XAUTO_TRY(say(socket, Word::kHello, session.process));
  member->topics_.resize(graph.topics.size());
  for (;;) {
    Packet packet;
    std::vector<UniqueFd> fds;
    XAUTO_ASSIGN(const std::size_t size, receive_packet(socket, &packet, sizeof packet, &fds));
    const Word word = static_cast<Word>(packet.word);
    if (size == sizeof packet && word == Word::kTopic && packet.index < graph.topics.size()) {
      XAUTO_ASSIGN(member->topics_[packet.index], transport::join_link(std::move(fds)));
    } else if (size == sizeof packet && word == Word::kBoard && fds.size() == 1) {
      XAUTO_ASSIGN(member->board_, Board::map(fds[0].get(), board_shape(plan, graph, flows)));
    } else if (size == sizeof packet && word == Word::kBegin && member->board_ != nullptr) {
      for (std::size_t t = 0; t < graph.topics.size(); ++t) {
        const Plan::Remote& remote = plan.topics[t];
        const bool ours = remote.publisher == session.process ? !remote.readers.empty()
                                                              : remote.reader(session.process) >= 0;
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
                  bool lost, const detail::Origins* origins) {
  Packet packet{.word = static_cast<std::uint32_t>(Word::kEvent),
                .index = static_cast<std::uint32_t>(module),
                .sequence = sequence,
                .origin_ns = origin_ns,
                .now_ns = now_ns,
                .lost = lost ? 1u : 0u,
                .rates = origins != nullptr ? 1u : 0u};
  if (origins != nullptr) packet.origins = *origins;
  (void)send_packet(socket_.get(), &packet, sizeof packet);  // a dead hub: we are ended as well
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
  (void)send_packet(socket_.get(), packet.data(), packet.size());
}

}  // namespace xauto::runtime
