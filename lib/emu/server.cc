// SPDX-License-Identifier: Apache-2.0
#include "emu/server.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <limits>

#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/socket.h"

namespace xauto::emu {

Result<std::unique_ptr<Server>> Server::create(const Platform& platform,
                                               const std::string& address) {
  XAUTO_ASSIGN(Machine machine, Machine::create(platform));
  auto server = std::unique_ptr<Server>(new Server(std::move(machine)));
  server->epoll_ = UniqueFd(epoll_create1(EPOLL_CLOEXEC));
  server->timer_ = UniqueFd(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK));
  if (!server->epoll_ || !server->timer_)
    return fail(ErrorCode::kIo, std::string("epoll/timerfd: ") + strerror(errno));
  XAUTO_ASSIGN(server->listener_, listen_abstract(address));
  for (const int fd : {server->timer_.get(), server->listener_.get()}) {
    epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
    if (epoll_ctl(server->epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
      return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  }
  return server;
}

Status Server::run(int stop_fd) {
  epoll_event stop{.events = EPOLLIN, .data = {.fd = stop_fd}};
  if (epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, stop_fd, &stop) != 0)
    return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  std::array<epoll_event, 64> ready;
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
      }
    }
    deliver(now_ns());
    for (const int fd : std::exchange(broken_, {})) drop(fd);
  }
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
    log::warn("emud: {}", peer.error().what);
    return;
  }
  if (connections_.size() >= kMaxConnections) return;
  const int fd = peer->get();
  epoll_event event{.events = EPOLLIN, .data = {.fd = fd}};
  if (epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) == 0) connections_[fd] = std::move(*peer);
}

void Server::drop(int fd) {
  const auto found = connections_.find(fd);
  if (found == connections_.end()) return;
  epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, fd, nullptr);
  connections_.erase(found);
  for (auto at = owner_.begin(); at != owner_.end();) {
    if (at->second != fd) {
      ++at;
      continue;
    }
    machine_.close(at->first, now_ns());
    at = owner_.erase(at);
  }
  std::erase_if(requests_, [&](const auto& r) { return r.second.connection == fd; });
}

bool Server::handle_packet(int connection, const void* data, std::size_t bytes, Nanos now) {
  Packet packet;
  if (bytes != sizeof packet) return false;
  std::memcpy(&packet, data, sizeof packet);
  if (std::memchr(packet.name, 0, sizeof packet.name) == nullptr) return false;
  switch (static_cast<Op>(packet.op)) {
    case Op::kOpen: {
      if (packet.value != kEmuVersion) {
        refuse(connection, packet.tag, {ErrorCode::kInvalid, "another protocol version", {}, {}});
        return true;
      }
      const auto context = machine_.open(packet.name, now);
      if (!context) {
        refuse(connection, packet.tag, context.error());
        return true;
      }
      owner_[*context] = connection;
      answer(connection, {.op = static_cast<std::uint32_t>(Op::kOpened), .context = *context});
      return true;
    }
    case Op::kSubmit: {
      const auto owner = owner_.find(packet.context);
      if (owner == owner_.end() || owner->second != connection) {
        refuse(connection, packet.tag, {ErrorCode::kInvalid, "not a context of yours", {}, {}});
        return true;
      }
      if (const auto done = machine_.submit(packet.context, packet.tag, packet.value, now); !done)
        refuse(connection, packet.tag, done.error());
      return true;
    }
    case Op::kSuspend:
    case Op::kResume: {
      const std::uint64_t request = next_request_++;
      requests_[request] = {connection, packet.tag};
      const auto done = packet.op == static_cast<std::uint32_t>(Op::kSuspend)
                            ? machine_.suspend(packet.context, request, now)
                            : machine_.resume(packet.context, request, now);
      if (!done) {
        requests_.erase(request);
        refuse(connection, packet.tag, done.error());
      }
      return true;
    }
    default:
      return false;
  }
}

void Server::deliver(Nanos now) {
  events_.clear();
  machine_.advance(now, events_);
  for (const Event& event : events_) {
    if (event.kind == Event::Kind::kDone) {
      const auto owner = owner_.find(event.context);
      if (owner != owner_.end())
        answer(owner->second, {.op = static_cast<std::uint32_t>(Op::kDone),
                               .context = event.context,
                               .tag = event.tag});
      continue;
    }
    const auto request = requests_.find(event.tag);
    if (request == requests_.end()) continue;  // who asked is gone
    const Op op = event.kind == Event::Kind::kSuspended ? Op::kSuspended : Op::kResumed;
    answer(request->second.connection, {.op = static_cast<std::uint32_t>(op),
                                        .context = event.context,
                                        .tag = request->second.tag});
    requests_.erase(request);
  }
}

/// Never waits: a client that does not read loses its connection.
void Server::answer(int connection, const Packet& packet) {
  if (send(connection, &packet, sizeof packet, MSG_NOSIGNAL | MSG_DONTWAIT) != sizeof packet)
    broken_.push_back(connection);
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
