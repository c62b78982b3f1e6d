// SPDX-License-Identifier: Apache-2.0
#include "base/write_now.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <ctime>
#include <string>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/unique_fd.h"

namespace xauto {
namespace {

/// Whoever has closed the other end does not end us, and a SIGPIPE of somebody else's stays.
class NoSigpipe {
 public:
  NoSigpipe() {
    sigset_t pending;
    sigpending(&pending);
    was_pending_ = sigismember(&pending, SIGPIPE) == 1;
    sigemptyset(&pipe_);
    sigaddset(&pipe_, SIGPIPE);
    pthread_sigmask(SIG_BLOCK, &pipe_, &before_);
  }
  ~NoSigpipe() {
    constexpr timespec kNow{};
    while (!was_pending_ && sigtimedwait(&pipe_, nullptr, &kNow) < 0 && errno == EINTR) {
    }
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  NoSigpipe(const NoSigpipe&) = delete;
  NoSigpipe& operator=(const NoSigpipe&) = delete;

 private:
  sigset_t pipe_, before_;
  bool was_pending_ = false;
};

/// Until all is written, or `once` takes no more.
template <class Once>
std::size_t write_all(std::string_view text, Once once) {
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t taken = once(text.substr(done));
    if (taken < 0 && errno == EINTR) continue;
    if (taken <= 0) break;
    done += static_cast<std::size_t>(taken);
  }
  return done;
}

/// splice() does not wait if told so, whatever the flags of both ends.
ssize_t move_into_pipe(int pipe, std::string_view text) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0) return -1;
  const UniqueFd out(ends[0]), in(ends[1]);
  const ssize_t there = write(in.get(), text.data(), std::min<std::size_t>(text.size(), PIPE_BUF));
  if (there <= 0) return there;
  return splice(out.get(), nullptr, pipe, nullptr, static_cast<std::size_t>(there),
                SPLICE_F_NONBLOCK);
}

/// A stopped one says that it takes nothing.
ssize_t write_to_terminal(int terminal, std::string_view text) {
  constexpr std::size_t kPiece = 64;  // drivers say so for less than this, too
  pollfd ready{terminal, POLLOUT, 0};
  if (poll(&ready, 1, 0) <= 0) return -1;
  return write(terminal, text.data(), std::min(text.size(), kPiece));
}

}  // namespace

std::size_t write_now(int fd, std::string_view text) {
  const NoSigpipe guard;
  struct stat what {};
  if (fstat(fd, &what) != 0) return 0;
  if (S_ISSOCK(what.st_mode))
    return write_all(text, [fd](std::string_view rest) {
      return send(fd, rest.data(), rest.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    });
  const auto plain = [](int to) {
    return [to](std::string_view rest) { return write(to, rest.data(), rest.size()); };
  };
  const bool is_pipe = S_ISFIFO(what.st_mode);
  if (!is_pipe && isatty(fd) != 1) return write_all(text, plain(fd));
  const std::string path = "/proc/self/fd/" + std::to_string(fd);
  const UniqueFd own(open(path.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
  if (own) return write_all(text, plain(own.get()));
  if (is_pipe)
    return write_all(text, [fd](std::string_view rest) { return move_into_pipe(fd, rest); });
  return write_all(text, [fd](std::string_view rest) { return write_to_terminal(fd, rest); });
}

}  // namespace xauto
