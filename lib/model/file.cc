// SPDX-License-Identifier: Apache-2.0
// Whole files in and out: the readers of json.cc stand on these two functions.
#include <cerrno>
#include <cstdio>
#include <cstdlib>
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

namespace {

/// Where the bytes of `path` go.
struct Target {
  std::string path;     ///< of a link: what it points at, so that the link stays
  bool direct = false;  ///< a device or a pipe: written into, nothing can take its place
  mode_t mode = 0644;   ///< an existing file keeps its own
};

Result<Target> target_of(const std::string& path) {
  Target target{path};
  struct stat status {};
  if (stat(path.c_str(), &status) != 0) return target;
  if (S_ISDIR(status.st_mode)) return fail(ErrorCode::kInvalid, "is a folder, not a file", path);
  target.direct = !S_ISREG(status.st_mode);
  target.mode = status.st_mode & 0777;
  if (target.direct) return target;
  if (char* real = realpath(path.c_str(), nullptr)) {
    target.path = real;
    free(real);
  }
  return target;
}

std::string beside(const Target& target) {
  return target.path + ".tmp." + std::to_string(getpid());
}

Error cannot_be_written(int error, const std::string& path) {
  const bool named_wrong = error == ENOENT || error == ENOTDIR;
  return {named_wrong ? ErrorCode::kNotFound : ErrorCode::kIo,
          std::string("cannot be written: ") + strerror(error), path,
          named_wrong ? "make its folder first" : ""};
}

/// 0, or the errno of the first failure. Closes `fd`.
int write_and_close(int fd, std::string_view text) {
  int error = 0;
  for (std::size_t done = 0; done < text.size() && error == 0;) {
    const ssize_t wrote = write(fd, text.data() + done, text.size() - done);
    if (wrote > 0)
      done += static_cast<std::size_t>(wrote);
    else if (wrote == 0 || errno != EINTR)
      error = wrote == 0 ? EIO : errno;
  }
  if (close(fd) != 0 && error == 0) error = errno;
  return error;
}

}  // namespace

Status check_writable(const std::string& path) {
  XAUTO_ASSIGN(const Target target, target_of(path));
  if (target.direct) {
    if (access(path.c_str(), W_OK) == 0) return {};
    return tl::unexpected<Error>(cannot_be_written(errno, path));
  }
  // A file without a name where there are such: nothing is left of it even if we are killed here.
  const std::size_t slash = target.path.rfind('/');
  const std::string folder = slash == std::string::npos ? "." : target.path.substr(0, slash + 1);
  int fd = open(folder.c_str(), O_WRONLY | O_TMPFILE | O_CLOEXEC, 0600);
  if (fd < 0 && (errno == EOPNOTSUPP || errno == EISDIR)) {
    fd = open(beside(target).c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    if (fd >= 0) unlink(beside(target).c_str());
  }
  if (fd < 0) return tl::unexpected<Error>(cannot_be_written(errno, path));
  close(fd);
  return {};
}

Status write_file(const std::string& path, std::string_view text) {
  XAUTO_ASSIGN(const Target target, target_of(path));
  const std::string name = target.direct ? path : beside(target);
  const int flags = target.direct ? 0 : O_CREAT | O_TRUNC;
  const int fd = open(name.c_str(), O_WRONLY | O_CLOEXEC | flags, target.mode);
  if (fd < 0) return tl::unexpected<Error>(cannot_be_written(errno, path));
  int error = write_and_close(fd, text);
  if (error == 0 && !target.direct && rename(name.c_str(), target.path.c_str()) != 0) error = errno;
  if (error == 0) return {};
  if (!target.direct) unlink(name.c_str());
  return tl::unexpected<Error>(cannot_be_written(error, path));
}

}  // namespace xauto
