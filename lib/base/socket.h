// SPDX-License-Identifier: Apache-2.0
// Abstract AF_UNIX sockets, one packet per message, with descriptor passing. Abstract: nothing is
// left in the file system however a process ends. Peers are checked by uid (SO_PEERCRED), since an
// abstract name has no permissions of its own.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto {

/// `address`: without the leading NUL, at most 100 bytes.
[[nodiscard]] Result<UniqueFd> listen_abstract(const std::string& address);
[[nodiscard]] Result<UniqueFd> connect_abstract(const std::string& address);
/// Accepts one connection of our own user or of root; others are closed and give kPermission.
[[nodiscard]] Result<UniqueFd> accept_own(int listener);

[[nodiscard]] Status send_packet(int socket, const void* data, std::size_t bytes,
                                 const std::vector<int>& fds = {});
/// Waits for one packet of at most `bytes` and returns its size; a longer one is kInvalid, a closed
/// peer kUnavailable. Descriptors beyond kMaxPassedFds are refused.
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

}  // namespace xauto
