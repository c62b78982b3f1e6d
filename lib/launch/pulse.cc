// SPDX-License-Identifier: Apache-2.0
#include "launch/pulse.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <string>
#include <utility>

#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>

#include "base/socket.h"
#include "emu/protocol.h"

namespace xauto::launch {
namespace {

/// How often it has gone to sleep; the same number when that cannot be read.
std::uint64_t sleeps_of(pid_t process) {
  std::ifstream status("/proc/" + std::to_string(process) + "/status");
  const std::string key = "voluntary_ctxt_switches:";
  for (std::string line; std::getline(status, line);)
    if (line.compare(0, key.size(), key) == 0)
      return std::strtoull(line.c_str() + key.size(), nullptr, 10);
  return 0;
}

}  // namespace

bool Stall::look(bool busy, std::uint64_t progress, std::int64_t now_ns) {
  if (!busy) {
    since_ns_ = -1;
    return false;
  }
  if (since_ns_ < 0 || progress != progress_) {
    since_ns_ = now_ns;
    progress_ = progress;
    return false;
  }
  return now_ns - since_ns_ >= kHungNs;
}

Result<Pulse> Pulse::of(int memory_fd, int listener_fd) {
  void* memory = mmap(nullptr, sizeof(coord::Header), PROT_READ, MAP_SHARED, memory_fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  Pulse pulse;
  pulse.header_ = static_cast<const coord::Header*>(memory);
  pulse.listener_fd_ = listener_fd;
  return pulse;
}

Pulse::Pulse(Pulse&& other) noexcept
    : header_(std::exchange(other.header_, nullptr)),
      listener_fd_(other.listener_fd_),
      stall_(other.stall_) {}

Pulse& Pulse::operator=(Pulse&& other) noexcept {
  std::swap(header_, other.header_);
  listener_fd_ = other.listener_fd_;
  stall_ = other.stall_;
  return *this;
}

Pulse::~Pulse() {
  if (header_ != nullptr) munmap(const_cast<coord::Header*>(header_), sizeof(coord::Header));
}

bool Pulse::idle(int but) const {
  if (header_ == nullptr) return false;
  const std::uint64_t owner = header_->owner.load() & ~coord::kParkings;
  const bool alone = (owner & (coord::kFat | coord::kParked | coord::kTaken)) == 0;
  return owner == 0 || (but >= 0 && alone && coord::owner_slot(owner) == but);
}

bool Pulse::hangs(pid_t coordinator, std::int64_t now_ns) {
  thread_.check();
  if (header_ == nullptr) return false;
  bool busy = header_->waiting.load(std::memory_order_relaxed) == 0;
  if (!busy) {
    pollfd queue{listener_fd_, POLLIN, 0};
    busy = poll(&queue, 1, 0) > 0;
  }
  // /proc is read only then: hardly ever.
  if (!stall_.look(busy, busy ? sleeps_of(coordinator) : 0, now_ns)) return false;
  stall_ = {};  // the next one is another process
  return true;
}

bool Ping::hangs(std::int64_t now_ns) {
  thread_.check();
  if (socket_) hear();
  if (!asked_ && now_ns >= next_ns_) {
    next_ns_ = now_ns + kPingEveryNs;
    if (!socket_) {
      if (auto connected = connect_abstract(address_, 0)) socket_ = std::move(*connected);
    }
    const emu::Packet ping{.op = static_cast<std::uint32_t>(emu::Op::kPing), .tag = answers_ + 1};
    asked_ = socket_ && send(socket_.get(), &ping, sizeof ping, MSG_NOSIGNAL | MSG_DONTWAIT) ==
                            static_cast<ssize_t>(sizeof ping);
  }
  if (!stall_.look(asked_, answers_, now_ns)) return false;
  socket_.reset();
  asked_ = false;
  stall_ = {};
  return true;
}

void Ping::hear() {
  emu::Packet packet;
  const ssize_t got = recv(socket_.get(), &packet, sizeof packet, MSG_DONTWAIT);
  if (got < 0 && (errno == EAGAIN || errno == EINTR)) return;
  asked_ = false;
  stall_ = {};
  if (got > 0)
    ++answers_;
  else
    socket_.reset();  // it has died: the next one is asked
}

}  // namespace xauto::launch
