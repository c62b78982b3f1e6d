// SPDX-License-Identifier: Apache-2.0
// Abstract AF_UNIX sockets, one packet per message, with descriptor passing. Abstract: nothing is
// left in the file system however a process ends. An abstract name has no permissions of its own, and
// anybody may listen at one: both ends ask the kernel who the other one is (SO_PEERCRED).
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto {

/// `address`: without the leading NUL, at most 100 bytes.
/// kUnavailable: somebody has it.
[[nodiscard]] Result<UniqueFd> listen_abstract(const std::string& address);
/// Has the name, and takes nobody in. Errors as above.
[[nodiscard]] Result<UniqueFd> hold_abstract(const std::string& address);
/// Our own user or root must serve it, else kPermission. Waits at most `timeout_ms` for a place in the
/// server's queue, which whoever does not accept leaves full.
[[nodiscard]] Result<UniqueFd> connect_abstract(const std::string& address,
                                                int timeout_ms = 10'000);
/// A socket in the file system: its directory's permissions say who may serve it, its own who may connect. At most
/// 100 bytes. Waits as connect_abstract does.
[[nodiscard]] Result<UniqueFd> connect_path(const std::string& path, int timeout_ms = 10'000);
/// Removes what a server before us has left at `path`, but no other kind of file. `mode`: of the socket. kUnavailable:
/// somebody listens there, and the error says who. Of several at once one gets it; `path`.lock is theirs, and stays.
[[nodiscard]] Result<UniqueFd> listen_path(const std::string& path, mode_t mode);
/// Whoever serves it: ask peer_of. Does not wait: kTimeout if the queue is full.
[[nodiscard]] Result<UniqueFd> connect_to_anybody(const std::string& address);
/// Who has accepted, and of a connecting end who listens: at the time when they did.
struct Peer {
  uid_t uid;
  pid_t pid;  ///< 0: in a PID namespace that is not seen from here
};
[[nodiscard]] Result<Peer> peer_of(int socket);
/// Accepts one connection of our own user or of root; others are closed and give kPermission.
[[nodiscard]] Result<UniqueFd> accept_own(int listener);

enum class IfFull : std::uint8_t { kFail, kWait };
/// A peer that does not read may not make us wait: then kTimeout. Unless all is lost without it.
[[nodiscard]] Status send_packet(int socket, const void* data, std::size_t bytes,
                                 const std::vector<int>& fds = {}, IfFull if_full = IfFull::kFail);
/// Waits for one packet of at most `bytes` and returns its size; a longer one is kInvalid, a closed
/// peer kUnavailable. Descriptors beyond kMaxPassedFds are refused, and all where `fds` is null:
/// they never become ours, since to close one may wait for a stranger (of FUSE, say).
[[nodiscard]] Result<std::size_t> receive_packet(int socket, void* data, std::size_t bytes,
                                                 std::vector<UniqueFd>* fds = nullptr);
inline constexpr std::size_t kMaxPassedFds = 66;  ///< a topic of 64 readers (shm_topic.h)
/// Whether there is something to read, or the other end is gone, within `timeout_ms`. A signal does
/// not shorten the wait.
[[nodiscard]] bool wait_readable(int fd, int timeout_ms);

void signal_eventfd(int fd);
void drain_eventfd(int fd);

/// Names of the abstract sockets in /proc/net/unix that start with `prefix` and are listening.
[[nodiscard]] std::vector<std::string> abstract_sockets(const std::string& prefix);
/// ... and of those that are only held, or connected.
[[nodiscard]] std::vector<std::string> abstract_names(const std::string& prefix);

}  // namespace xauto
