// SPDX-License-Identifier: Apache-2.0
// Tells of the death of coordinators: one thread of a process sleeps on the sockets of all its
// ports. Management threads sleep on a word of shared memory, which any worker may ring; a futex
// has no other way to learn that a process is gone.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <thread>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"

namespace xauto::coord {

/// Threads: any.
class SocketWatch {
 public:
  /// The one of this process; its thread ends with the last user. `fifo`: SCHED_FIFO priority of
  /// that thread, if this call starts it; 0: SCHED_OTHER.
  [[nodiscard]] static Result<std::shared_ptr<SocketWatch>> of_process(int fifo);
  ~SocketWatch();
  SocketWatch(const SocketWatch&) = delete;
  SocketWatch& operator=(const SocketWatch&) = delete;

  /// `ended` is called once, on the watch's thread, when there is something to read on `socket`: a
  /// coordinator sends nothing after Welcome, so that is its end, or its ruin.
  [[nodiscard]] Status add(int socket, std::function<void()> ended);
  /// When it returns, `ended` is not running and will not be called.
  void remove(int socket);

 private:
  SocketWatch() = default;
  void run(int fifo);

  UniqueFd epoll_, stop_;
  PiMutex mutex_;  ///< held during `ended`
  std::map<int, std::function<void()>> watched_ XAUTO_GUARDED_BY(mutex_);
  std::thread thread_;
};

}  // namespace xauto::coord
