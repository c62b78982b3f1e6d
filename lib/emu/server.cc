// SPDX-License-Identifier: Apache-2.0
#include "emu/server.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <limits>
#include <set>

#include <sys/epoll.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/socket.h"

namespace xauto::emu {

namespace {

Status watch(int epoll, int fd) {
  epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
  if (epoll_ctl(epoll, EPOLL_CTL_ADD, fd, &event) != 0)
    return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  return {};
}

}  // namespace

Result<std::unique_ptr<Server>> Server::create(const Platform& platform,
                                               const ServerOptions& options) {
  UniqueFd listener(options.listener_fd);
  UniqueFd memory_fd(options.memory_fd);
  std::optional<StateMemory> memory;
  std::optional<Snapshot> before;
  if (memory_fd) {
    XAUTO_ASSIGN(StateMemory mapped, StateMemory::map(std::move(memory_fd)));
    memory.emplace(std::move(mapped));
    XAUTO_ASSIGN(before, memory->load());
  }
  XAUTO_ASSIGN(Machine machine, before
                                    ? Machine::restore(platform, *before, now_ns(), options.script)
                                    : Machine::create(platform, options.script));
  auto server = std::unique_ptr<Server>(new Server(std::move(machine)));
  if (memory) server->memory_.emplace(std::move(*memory));
  server->epoll_ = UniqueFd(epoll_create1(EPOLL_CLOEXEC));
  server->timer_ = UniqueFd(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK));
  if (!server->epoll_ || !server->timer_)
    return fail(ErrorCode::kIo, std::string("epoll/timerfd: ") + strerror(errno));
  server->listener_ = std::move(listener);
  if (!server->listener_) {
    XAUTO_ASSIGN(server->listener_, listen_abstract(options.address));
  }
  // Whoever comes back after a death does not wait in connect().
  if (listen(server->listener_.get(), SOMAXCONN) != 0)
    return fail(ErrorCode::kIo, std::string("listen: ") + strerror(errno), options.address);
  for (const int fd : {server->timer_.get(), server->listener_.get()})
    XAUTO_TRY(watch(server->epoll_.get(), fd));
  if (before) XAUTO_TRY(server->take_over(*before));
  server->machine_.give_away();  // to the thread of run()
  return server;
}

/// The contexts wait for their owners as long as those live: an idle owner notices our
/// predecessor's death only at its next call.
Status Server::take_over(const Snapshot& snapshot) {
  std::set<pid_t> ended, watched;
  for (const ContextRecord& context : snapshot.contexts) {
    owner_[context.id] = {.key = context.key, .pid = context.pid};
    if (context.pid <= 0 || !watched.insert(context.pid).second) continue;
    UniqueFd pidfd(static_cast<int>(syscall(SYS_pidfd_open, context.pid, 0)));
    if (!pidfd && errno == ESRCH) ended.insert(context.pid);
    if (!pidfd) continue;
    const int fd = pidfd.get();
    XAUTO_TRY(watch(epoll_.get(), fd));
    orphans_[fd] = {context.pid, std::move(pidfd)};
  }
  for (const pid_t process : ended) give_up(process);
  log::info("emud: took over from an emulator that died: {} context{}", owner_.size(),
            owner_.size() == 1 ? "" : "s");
  return {};
}

/// Closes the contexts of a process that has ended without coming back for them.
void Server::give_up(pid_t process) {
  for (auto at = owner_.begin(); at != owner_.end();) {
    if (at->second.connection != kAbsent || at->second.pid != process) {
      ++at;
      continue;
    }
    machine_.close(at->first, now_ns());
    dirty_ = true;
    at = owner_.erase(at);
  }
}

Status Server::run(int stop_fd) {
  thread_.check();
  XAUTO_TRY(watch(epoll_.get(), stop_fd));
  std::array<epoll_event, 64> ready;
  settle(now_ns());  // what came of taking over
  for (;;) {
    arm();
    const int count = epoll_wait(epoll_.get(), ready.data(), static_cast<int>(ready.size()), -1);
    if (count < 0 && errno != EINTR)
      return fail(ErrorCode::kIo, std::string("epoll_wait: ") + strerror(errno));
    for (int i = 0; i < count; ++i) {
      const int fd = ready[static_cast<std::size_t>(i)].data.fd;
      if (fd == stop_fd) return {};
      if (fd == timer_.get()) {
        std::uint64_t expirations;
        [[maybe_unused]] const ssize_t got = read(fd, &expirations, sizeof expirations);
      } else if (fd == listener_.get()) {
        accept_connection();
      } else if (connections_.contains(fd)) {
        Packet packet;
        const auto size = receive_packet(fd, &packet, sizeof packet);
        if (!size || !handle_packet(fd, &packet, *size, now_ns())) drop(fd);
      } else if (const auto orphans = orphans_.find(fd); orphans != orphans_.end()) {
        const pid_t process = orphans->second.pid;
        orphans_.erase(orphans);  // its end takes the descriptor out of epoll
        give_up(process);
      }
    }
    settle(now_ns());
  }
}

void Server::settle(Nanos now) {
  thread_.check();
  deliver(now);
  if (dirty_) save();
  for (const Answer& answer : outbox_)
    // Never waits: a client that does not read loses its connection.
    if (send(answer.connection, &answer.packet, sizeof answer.packet,
             MSG_NOSIGNAL | MSG_DONTWAIT) != sizeof answer.packet)
      broken_.push_back(answer.connection);
  outbox_.clear();
  for (const int fd : std::exchange(broken_, {})) drop(fd);
}

void Server::save() {
  dirty_ = false;
  if (!memory_) return;
  machine_.save(snapshot_);
  for (ContextRecord& context : snapshot_.contexts) {
    const auto owner = owner_.find(context.id);
    if (owner == owner_.end()) continue;
    context.key = owner->second.key;
    context.pid = owner->second.pid;
  }
  memory_->save(snapshot_);
}

/// The timer goes off when the machine has something to tell.
void Server::arm() {
  const Nanos next = machine_.next_event();
  itimerspec when{};
  if (next != std::numeric_limits<Nanos>::max()) {
    when.it_value.tv_sec = next / 1'000'000'000;
    when.it_value.tv_nsec = std::max<long>(1, next % 1'000'000'000);
  }
  timerfd_settime(timer_.get(), TFD_TIMER_ABSTIME, &when, nullptr);
}

void Server::accept_connection() {
  auto peer = accept_own(listener_.get());
  if (!peer) {
    refusals_.tell(peer.error().what, now_ns());
    return;
  }
  if (connections_.size() >= kMaxConnections) return;
  const int fd = peer->get();
  const auto who = peer_of(fd);
  if (who && watch(epoll_.get(), fd)) connections_[fd] = {std::move(*peer), who->pid};
}

void Server::drop(int fd) {
  const auto found = connections_.find(fd);
  if (found == connections_.end()) return;
  epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, fd, nullptr);
  connections_.erase(found);
  for (auto at = owner_.begin(); at != owner_.end();) {
    if (at->second.connection != fd) {
      ++at;
      continue;
    }
    machine_.close(at->first, now_ns());
    dirty_ = true;
    at = owner_.erase(at);
  }
  std::erase_if(requests_, [&](const auto& r) { return r.second.connection == fd; });
  std::erase_if(outbox_, [&](const Answer& a) { return a.connection == fd; });
}

bool Server::handle_packet(int connection, const void* data, std::size_t bytes, Nanos now) {
  thread_.check();
  Packet packet;
  if (bytes != sizeof packet) return false;
  std::memcpy(&packet, data, sizeof packet);
  if (std::memchr(packet.name, 0, sizeof packet.name) == nullptr) return false;
  switch (static_cast<Op>(packet.op)) {
    case Op::kOpen:
      return open(connection, packet, now);
    case Op::kRejoin:
      return rejoin(connection, packet);
    case Op::kPing:
      answer(connection, {.op = static_cast<std::uint32_t>(Op::kPong), .tag = packet.tag});
      return true;
    case Op::kSubmit: {
      const auto owner = owner_.find(packet.context);
      if (owner == owner_.end() || owner->second.connection != connection) {
        refuse(connection, packet.tag, {ErrorCode::kInvalid, "not a context of yours", {}, {}});
        return true;
      }
      if (const auto done = machine_.submit(packet.context, packet.tag, packet.value, now); !done)
        refuse(connection, packet.tag, done.error());
      dirty_ = true;
      return true;
    }
    case Op::kLevel: {
      const int level = static_cast<int>(std::clamp<std::int64_t>(packet.value, -1, kMaxLevels));
      if (const auto done = machine_.level(packet.context, level, now); done)
        answer(connection, {.op = static_cast<std::uint32_t>(Op::kLeveled),
                            .context = packet.context,
                            .tag = packet.tag});
      else
        refuse(connection, packet.tag, done.error());
      dirty_ = true;
      return true;
    }
    case Op::kBusy: {
      const auto busy = machine_.busy(packet.name, now);
      if (busy)
        answer(connection,
               {.op = static_cast<std::uint32_t>(Op::kBusied), .tag = packet.tag, .value = *busy});
      else
        refuse(connection, packet.tag, busy.error());
      dirty_ = true;  // time has passed on the devices
      return true;
    }
    case Op::kSuspend:
    case Op::kResume: {
      if (requests_.size() >= kMaxRequests) {
        refuse(connection, packet.tag, {ErrorCode::kUnavailable, "too many requests", {}, {}});
        return true;
      }
      const std::uint64_t request = next_request_++;
      requests_[request] = {connection, packet.tag};
      const auto done = packet.op == static_cast<std::uint32_t>(Op::kSuspend)
                            ? machine_.suspend(packet.context, request, now)
                            : machine_.resume(packet.context, request, now);
      if (!done) {
        requests_.erase(request);
        refuse(connection, packet.tag, done.error());
      }
      dirty_ = true;
      return true;
    }
    default:
      return false;
  }
}

bool Server::open(int connection, const Packet& packet, Nanos now) {
  if (packet.value != kEmuVersion) {
    refuse(connection, packet.tag, {ErrorCode::kInvalid, "another protocol version", {}, {}});
    return true;
  }
  std::uint64_t key = 0;
  if (getrandom(&key, sizeof key, 0) != sizeof key) return false;
  const auto context = machine_.open(packet.name, now);
  if (!context) {
    refuse(connection, packet.tag, context.error());
    return true;
  }
  const auto client = connections_.find(connection);
  owner_[*context] = {connection, key, client != connections_.end() ? client->second.pid : 0};
  dirty_ = true;
  answer(connection, {.op = static_cast<std::uint32_t>(Op::kOpened),
                      .context = *context,
                      .value = static_cast<std::int64_t>(key)});
  return true;
}

/// A client whose emulator died has the context back, and hears what became of its call.
bool Server::rejoin(int connection, const Packet& packet) {
  const auto owner = owner_.find(packet.context);
  const auto progress = machine_.progress(packet.context, packet.tag);
  if (owner == owner_.end() || owner->second.connection != kAbsent || !progress ||
      owner->second.key != static_cast<std::uint64_t>(packet.value)) {
    refuse(connection, packet.tag, {ErrorCode::kInvalid, "no context to come back to", {}, {}});
    return true;
  }
  owner->second.connection = connection;
  answer(connection, {.op = static_cast<std::uint32_t>(Op::kRejoined),
                      .context = packet.context,
                      .tag = packet.tag,
                      .value = static_cast<std::int64_t>(*progress)});
  return true;
}

void Server::deliver(Nanos now) {
  events_.clear();
  machine_.advance(now, events_);
  if (!events_.empty()) dirty_ = true;
  for (const Event& event : events_) {
    if (event.kind == Event::Kind::kDone) {
      const auto owner = owner_.find(event.context);
      if (owner != owner_.end() && owner->second.connection != kAbsent)
        answer(owner->second.connection, {.op = static_cast<std::uint32_t>(Op::kDone),
                                          .context = event.context,
                                          .tag = event.tag});
      continue;
    }
    if (event.kind == Event::Kind::kScript) {
      log::debug("emud: script: {} step{} taken at {} ns", event.tag, event.tag == 1 ? "" : "s",
                 event.time);
      continue;
    }
    const auto request = requests_.find(event.tag);
    if (request == requests_.end()) continue;  // who asked is gone
    if (event.kind == Event::Kind::kStuck) {
      refuse(request->second.connection, request->second.tag,
             {ErrorCode::kTimeout, "the work did not leave the XPU; it runs again", {}, {}});
      requests_.erase(request);
      continue;
    }
    const Op op = event.kind == Event::Kind::kSuspended ? Op::kSuspended : Op::kResumed;
    answer(request->second.connection, {.op = static_cast<std::uint32_t>(op),
                                        .context = event.context,
                                        .tag = request->second.tag});
    requests_.erase(request);
  }
}

void Server::answer(int connection, const Packet& packet) {
  outbox_.push_back({connection, packet});
}

void Server::refuse(int connection, std::uint64_t tag, const Error& error) {
  Packet packet{.op = static_cast<std::uint32_t>(Op::kError),
                .tag = tag,
                .value = static_cast<std::int64_t>(error.code)};
  const std::string text = error.where.empty() ? error.what : error.where + ": " + error.what;
  std::memcpy(packet.name, text.data(), std::min(text.size(), kMaxDeviceName - 1));
  answer(connection, packet);
}

}  // namespace xauto::emu
