// SPDX-License-Identifier: Apache-2.0
// Whole files in and out: the readers of json.cc stand on these two functions.
#include <cerrno>
#include <cstdio>
#include <cstring>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "model/json.h"

namespace xauto {

Result<std::string> read_open_file(int fd, const std::string& path, std::size_t max_bytes) {
  struct stat status {};
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode))
    return fail(ErrorCode::kInvalid, "is not a regular file", path);
  if (static_cast<std::size_t>(status.st_size) > max_bytes)
    return fail(ErrorCode::kInvalid, "is longer than " + std::to_string(max_bytes) + " bytes",
                path);
  std::string text(static_cast<std::size_t>(status.st_size), '\0');
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t got = pread(fd, text.data() + done, text.size() - done, static_cast<off_t>(done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0)
      return fail(ErrorCode::kIo, std::string("cannot be read: ") + strerror(errno), path);
    if (got == 0) break;
    done += static_cast<std::size_t>(got);
  }
  text.resize(done);
  return text;
}

Result<std::string> read_file(const std::string& path) {
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0)
    return fail(errno == ENOENT ? ErrorCode::kNotFound : ErrorCode::kInvalid,
                std::string("cannot be opened: ") + strerror(errno), path);
  struct Closer {
    int fd;
    ~Closer() { close(fd); }
  } const closer{fd};
  return read_open_file(fd, path, kMaxFileBytes);
}

Status write_file(const std::string& path, std::string_view text) {
  const std::string beside = path + ".tmp." + std::to_string(getpid());
  const int fd = open(beside.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0)
    return fail(ErrorCode::kNotFound, std::string("cannot be written: ") + strerror(errno), path);
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t wrote = write(fd, text.data() + done, text.size() - done);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote <= 0) break;
    done += static_cast<std::size_t>(wrote);
  }
  const bool good =
      close(fd) == 0 && done == text.size() && rename(beside.c_str(), path.c_str()) == 0;
  if (good) return {};
  const int error = errno;
  unlink(beside.c_str());
  return fail(ErrorCode::kIo, std::string("cannot be written: ") + strerror(error), path);
}

}  // namespace xauto
