// SPDX-License-Identifier: Apache-2.0
#include "coord/socket_watch.h"

#include <array>
#include <cerrno>
#include <cstring>

#include <sys/epoll.h>
#include <sys/eventfd.h>

#include "base/rt.h"
#include "base/socket.h"
#include "base/thread.h"

namespace xauto::coord {

Result<std::shared_ptr<SocketWatch>> SocketWatch::of_process(int fifo) {
  static PiMutex mutex;
  static std::weak_ptr<SocketWatch> current;
  const Guard lock(mutex);
  if (auto watch = current.lock()) return watch;
  std::shared_ptr<SocketWatch> watch(new SocketWatch);
  watch->epoll_ = UniqueFd(epoll_create1(EPOLL_CLOEXEC));
  watch->stop_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  epoll_event stop{.events = EPOLLIN, .data = {.fd = watch->stop_.get()}};
  if (!watch->epoll_ || !watch->stop_ ||
      epoll_ctl(watch->epoll_.get(), EPOLL_CTL_ADD, watch->stop_.get(), &stop) != 0)
    return fail(ErrorCode::kIo, std::string("epoll/eventfd: ") + strerror(errno));
  XAUTO_ASSIGN(watch->thread_, start_thread([self = watch.get(), fifo] { self->run(fifo); }));
  current = watch;
  return watch;
}

SocketWatch::~SocketWatch() {
  if (!thread_.joinable()) return;
  signal_eventfd(stop_.get());
  thread_.join();
}

Status SocketWatch::add(int socket, std::function<void()> ended) {
  const Guard lock(mutex_);
  epoll_event event{.events = EPOLLIN | EPOLLONESHOT, .data = {.fd = socket}};
  if (epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, socket, &event) != 0)
    return fail(ErrorCode::kIo, std::string("epoll_ctl: ") + strerror(errno));
  watched_[socket] = std::move(ended);
  return {};
}

void SocketWatch::remove(int socket) {
  const Guard lock(mutex_);
  if (watched_.erase(socket) != 0) epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, socket, nullptr);
}

void SocketWatch::run(int fifo) {
  rt::set_thread_name("xauto/watch");
  if (fifo > 0) (void)rt::set_fifo(fifo);
  std::array<epoll_event, 8> events;
  for (;;) {
    const int count = epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), -1);
    for (int i = 0; i < count; ++i) {
      const int fd = events[static_cast<std::size_t>(i)].data.fd;
      if (fd == stop_.get()) return;
      const Guard lock(mutex_);
      if (const auto found = watched_.find(fd); found != watched_.end()) found->second();
    }
  }
}

}  // namespace xauto::coord
