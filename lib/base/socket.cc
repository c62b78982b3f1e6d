// SPDX-License-Identifier: Apache-2.0
#include "base/socket.h"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <sstream>

#include <fcntl.h>
#include <poll.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <unistd.h>

#include "base/clock.h"

namespace xauto {
namespace {

constexpr std::size_t kMaxAddress = 100;

std::string errno_text(const char* call) {
  return std::string(call) + ": " + strerror(errno);
}

Result<socklen_t> fill(sockaddr_un& name, const std::string& address) {
  if (address.empty() || address.size() > kMaxAddress)
    return fail(ErrorCode::kInvalid,
                "socket address has " + std::to_string(address.size()) + " bytes, not 1.." +
                    std::to_string(kMaxAddress),
                address);
  name = {};
  name.sun_family = AF_UNIX;
  const bool path = address.front() == '/';
  std::memcpy(name.sun_path + (path ? 0 : 1), address.data(), address.size());
  return static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + address.size());
}

}  // namespace

Result<UniqueFd> hold_abstract(const std::string& address) {
  sockaddr_un name;
  XAUTO_ASSIGN(const socklen_t length, fill(name, address));
  UniqueFd socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket) return fail(ErrorCode::kIo, errno_text("socket"), address);
  if (bind(socket.get(), reinterpret_cast<sockaddr*>(&name), length) != 0)
    return fail(errno == EADDRINUSE ? ErrorCode::kUnavailable : ErrorCode::kIo,
                errno_text("cannot listen"), address);
  return socket;
}

Result<UniqueFd> listen_abstract(const std::string& address) {
  XAUTO_ASSIGN(UniqueFd socket, hold_abstract(address));
  if (listen(socket.get(), 64) != 0)
    return fail(ErrorCode::kIo, errno_text("cannot listen"), address);
  return socket;
}

namespace {

/// `timeout_ms` 0: does not wait.
Result<UniqueFd> connect_within(const std::string& address, int timeout_ms) {
  sockaddr_un name;
  XAUTO_ASSIGN(const socklen_t length, fill(name, address));
  UniqueFd socket(
      ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | (timeout_ms == 0 ? SOCK_NONBLOCK : 0), 0));
  if (!socket) return fail(ErrorCode::kIo, errno_text("socket"), address);
  const std::int64_t until = now_ns() + std::int64_t{timeout_ms} * 1'000'000;
  for (;;) {
    // The kernel lets connect() wait for as long as send() may; 0 would be for ever.
    const std::int64_t left_us = std::max<std::int64_t>(1, (until - now_ns()) / 1000);
    const timeval limit{left_us / 1'000'000, left_us % 1'000'000};
    setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
    if (connect(socket.get(), reinterpret_cast<sockaddr*>(&name), length) == 0) break;
    if (errno == EAGAIN)
      return fail(ErrorCode::kTimeout, "does not accept connections: its queue is full", address);
    if (errno != EINTR)
      return fail(ErrorCode::kUnavailable, errno_text("cannot connect"), address,
                  "is the process that serves it still running? see `xauto top --once`");
  }
  constexpr timeval kNone{};
  setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &kNone, sizeof kNone);
  if (timeout_ms == 0) fcntl(socket.get(), F_SETFL, 0);
  return socket;
}

}  // namespace

Result<UniqueFd> connect_to_anybody(const std::string& address) {
  return connect_within(address, 0);
}

Result<UniqueFd> connect_abstract(const std::string& address, int timeout_ms) {
  XAUTO_ASSIGN(UniqueFd socket, connect_within(address, timeout_ms));
  XAUTO_ASSIGN(const Peer server, peer_of(socket.get()));
  if (server.uid != geteuid() && server.uid != 0)
    return fail(ErrorCode::kPermission,
                "is served by uid " + std::to_string(server.uid) + ", pid " +
                    std::to_string(server.pid) + ": neither this user nor root",
                address);
  return socket;
}

Result<UniqueFd> connect_path(const std::string& path, int timeout_ms) {
  if (path.empty() || path.front() != '/')
    return fail(ErrorCode::kInvalid, "is no path of a socket: it begins with '/'", path);
  return connect_within(path, timeout_ms);
}

namespace {

/// Only one process at a time makes the socket at a path: who has locked the file beside it, which stays, as the socket
/// does. The kernel ends the lock of who dies. It is not the folder's lock, which anybody may take who may read it.
Result<UniqueFd> lock_path(const std::string& path) {
  constexpr int kTries = 1000;  // a millisecond apart; where the machine stands still, that is one
  const std::string name = path + ".lock";
  UniqueFd file(open(name.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0600));
  if (!file) return fail(ErrorCode::kIo, errno_text("cannot lock"), name);
  for (int tries = 0; flock(file.get(), LOCK_EX | LOCK_NB) != 0; ++tries) {
    if (errno != EWOULDBLOCK && errno != EINTR)
      return fail(ErrorCode::kIo, errno_text("cannot lock"), name);
    if (tries == kTries)
      return fail(ErrorCode::kTimeout,
                  "another process is about to listen there, and does not go on", path,
                  "`fuser " + name + "` says who it is");
    sleep_until_ns(now_ns() + 1'000'000);
  }
  return file;
}

/// Whether what is at `path`, a socket or nothing, was left by one who has gone.
Status nobody_listens(const std::string& path) {
  sockaddr_un name;
  XAUTO_ASSIGN(const socklen_t length, fill(name, path));
  const UniqueFd asks(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!asks) return fail(ErrorCode::kIo, errno_text("socket"), path);
  if (connect(asks.get(), reinterpret_cast<sockaddr*>(&name), length) != 0) {
    if (errno == ECONNREFUSED || errno == ENOENT) return {};
    return fail(ErrorCode::kUnavailable, errno_text("somebody may listen there"), path);
  }
  XAUTO_ASSIGN(const Peer server, peer_of(asks.get()));
  return fail(ErrorCode::kUnavailable,
              "is served already, by uid " + std::to_string(server.uid) + ", pid " +
                  std::to_string(server.pid),
              path, "stop that one, or listen elsewhere");
}

}  // namespace

Result<UniqueFd> listen_path(const std::string& path, mode_t mode) {
  if (path.empty() || path.front() != '/')
    return fail(ErrorCode::kInvalid, "is no path of a socket: it begins with '/'", path);
  // Who sees it there may connect, and may change its mode: it comes by its name when it is complete.
  const std::string fresh = path + ".new";
  sockaddr_un name;
  XAUTO_ASSIGN(const socklen_t length, fill(name, fresh));
  struct stat status {};
  if (lstat(path.c_str(), &status) == 0 && !S_ISSOCK(status.st_mode))
    return fail(ErrorCode::kIo, "cannot listen: a file that is no socket has this name", path);
  XAUTO_ASSIGN(const UniqueFd lock, lock_path(path));
  XAUTO_TRY(nobody_listens(path));
  if (lstat(fresh.c_str(), &status) == 0 && S_ISSOCK(status.st_mode)) unlink(fresh.c_str());
  UniqueFd socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket) return fail(ErrorCode::kIo, errno_text("socket"), path);
  if (bind(socket.get(), reinterpret_cast<sockaddr*>(&name), length) != 0 ||
      chmod(fresh.c_str(), mode) != 0 || listen(socket.get(), 64) != 0 ||
      rename(fresh.c_str(), path.c_str()) != 0)
    return fail(ErrorCode::kIo, errno_text("cannot listen"), path);
  return socket;
}

Result<Peer> peer_of(int socket) {
  ucred who{};
  socklen_t length = sizeof who;
  if (getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &who, &length) != 0)
    return fail(ErrorCode::kIo, errno_text("SO_PEERCRED"));
  return Peer{who.uid, who.pid};
}

Result<UniqueFd> accept_own(int listener) {
  UniqueFd peer(accept4(listener, nullptr, nullptr, SOCK_CLOEXEC));
  if (!peer) return fail(ErrorCode::kIo, errno_text("accept"));
  XAUTO_ASSIGN(const Peer who, peer_of(peer.get()));
  if (who.uid != geteuid() && who.uid != 0)
    return fail(ErrorCode::kPermission, "refused a connection of uid " + std::to_string(who.uid) +
                                            ", pid " + std::to_string(who.pid));
  return peer;
}

Status send_packet(int socket, const void* data, std::size_t bytes, const std::vector<int>& fds,
                   IfFull if_full) {
  iovec part{const_cast<void*>(data), bytes};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int) * kMaxPassedFds)] = {};
  if (!fds.empty()) {
    if (fds.size() > kMaxPassedFds) return fail(ErrorCode::kInternal, "too many descriptors");
    message.msg_control = control;
    message.msg_controllen = CMSG_SPACE(sizeof(int) * fds.size());
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(sizeof(int) * fds.size());
    std::memcpy(CMSG_DATA(header), fds.data(), sizeof(int) * fds.size());
  }
  ssize_t sent;
  do {
    sent = sendmsg(socket, &message, MSG_NOSIGNAL | (if_full == IfFull::kFail ? MSG_DONTWAIT : 0));
  } while (sent < 0 && errno == EINTR);
  if (sent < 0 && errno == EAGAIN)
    return fail(ErrorCode::kTimeout, "cannot send: the peer does not read");
  if (sent < 0) return fail(ErrorCode::kUnavailable, errno_text("cannot send"));
  return {};
}

bool wait_readable(int fd, int timeout_ms) {
  const std::int64_t until = now_ns() + std::int64_t{timeout_ms} * 1'000'000;
  for (int left = timeout_ms;;) {
    pollfd ready{fd, POLLIN, 0};
    const int count = poll(&ready, 1, left);
    if (count >= 0 || errno != EINTR) return count > 0;
    left = static_cast<int>(std::max<std::int64_t>(0, (until - now_ns()) / 1'000'000));
  }
}

Result<std::size_t> receive_packet(int socket, void* data, std::size_t bytes,
                                   std::vector<UniqueFd>* fds) {
  iovec part{data, bytes};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int) * kMaxPassedFds)] = {};
  if (fds != nullptr) {
    message.msg_control = control;
    message.msg_controllen = sizeof control;
  }
  ssize_t received;
  do {
    received = recvmsg(socket, &message, MSG_CMSG_CLOEXEC);
    // ECONNRESET: the peer has closed with something of ours unread. It is said once (unix_release_sock(),
    // net/unix/af_unix.c), and before what the peer had said.
  } while (received < 0 && (errno == EINTR || errno == ECONNRESET));

  std::vector<UniqueFd> passed;  // closed here unless the caller wants them
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); received >= 0 && header != nullptr;
       header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) continue;
    const std::size_t count = (header->cmsg_len - CMSG_LEN(0)) / sizeof(int);
    for (std::size_t i = 0; i < count; ++i) {
      int fd;
      std::memcpy(&fd, CMSG_DATA(header) + i * sizeof(int), sizeof fd);
      passed.emplace_back(fd);
    }
  }
  if (received < 0) return fail(ErrorCode::kUnavailable, errno_text("cannot receive"));
  if (received == 0) return fail(ErrorCode::kUnavailable, "the peer closed the connection");
  if ((message.msg_flags & MSG_TRUNC) != 0)
    return fail(ErrorCode::kInvalid, "packet is longer than " + std::to_string(bytes) + " bytes");
  if ((message.msg_flags & MSG_CTRUNC) != 0 && fds == nullptr)
    return fail(ErrorCode::kInvalid, "a packet brings descriptors that nobody has asked for");
  // More than we read, or more than this process may have open.
  if ((message.msg_flags & MSG_CTRUNC) != 0)
    return fail(ErrorCode::kUnavailable, "not all file descriptors of a packet could be taken", "",
                "allow more open files: ulimit -n");
  if (fds != nullptr) *fds = std::move(passed);
  return static_cast<std::size_t>(received);
}

void signal_eventfd(int fd) {
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written =
      write(fd, &one, sizeof one);  // full counter: it is signalled
}

void drain_eventfd(int fd) {
  // O_NONBLOCK is of the open file, and whoever has it, too, may have taken that back.
  std::uint64_t count;
  const iovec part{&count, sizeof count};
  [[maybe_unused]] const ssize_t got = preadv2(fd, &part, 1, -1, RWF_NOWAIT);  // empty: nothing
}

namespace {

std::vector<std::string> names_of(const std::string& prefix, bool listening) {
  // Num RefCount Protocol Flags Type St Inode Path; listening: flag __SO_ACCEPTCON (0x10000).
  std::vector<std::string> names;
  std::ifstream table("/proc/net/unix");
  std::string line;
  while (std::getline(table, line)) {
    std::istringstream fields(line);
    std::string num, references, protocol, flags, type, state, inode, path;
    fields >> num >> references >> protocol >> flags >> type >> state >> inode >> path;
    if ((!listening || flags == "00010000") && path.size() > 1 && path[0] == '@' &&
        path.compare(1, prefix.size(), prefix) == 0)
      names.push_back(path.substr(1));
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

}  // namespace

std::vector<std::string> abstract_sockets(const std::string& prefix) {
  return names_of(prefix, true);
}

std::vector<std::string> abstract_names(const std::string& prefix) {
  return names_of(prefix, false);
}

}  // namespace xauto
