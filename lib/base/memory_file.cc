// SPDX-License-Identifier: Apache-2.0
#include "base/memory_file.h"

#include <cerrno>
#include <cstring>
#include <string>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

namespace xauto {
namespace {

tl::unexpected<Error> io_error(const char* what) {
  return fail(ErrorCode::kIo, std::string(what) + ": " + strerror(errno));
}

}  // namespace

UniqueFd private_memfd(const char* name, unsigned flags) {
  UniqueFd fd(memfd_create(name, flags));
  if (fd && fchmod(fd.get(), S_IRUSR | S_IWUSR) != 0) fd.reset();
  return fd;
}

Result<UniqueFd> make_memory_file(const char* name) {
  UniqueFd fd = private_memfd(name, MFD_CLOEXEC);
  if (!fd) return io_error("memfd_create");
  return fd;
}

Status seal_memory(int fd, std::size_t bytes) {
  if (ftruncate(fd, static_cast<off_t>(bytes)) != 0) return io_error("cannot make shared memory");
  if (fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0)
    return io_error("cannot seal shared memory");
  return {};
}

Result<UniqueFd> sealed_memory(const char* name, std::size_t bytes) {
  UniqueFd fd = private_memfd(name, MFD_CLOEXEC | MFD_ALLOW_SEALING);
  if (!fd) return io_error("cannot make shared memory");
  XAUTO_TRY(seal_memory(fd.get(), bytes));
  return fd;
}

Result<UniqueFd> read_only(int fd) {
  UniqueFd second(open(("/proc/self/fd/" + std::to_string(fd)).c_str(), O_RDONLY | O_CLOEXEC));
  if (!second) return io_error("cannot reopen memory");
  return second;
}

Status write_memory_file(int fd, std::string_view text) {
  if (ftruncate(fd, 0) != 0) return io_error("cannot empty a memory file");
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t wrote =
        pwrite(fd, text.data() + done, text.size() - done, static_cast<off_t>(done));
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote <= 0) return io_error("cannot write a memory file");
    done += static_cast<std::size_t>(wrote);
  }
  return {};
}

Result<std::string> read_memory_file(int fd) {
  struct stat status {};
  if (fstat(fd, &status) != 0) return io_error("cannot read a memory file");
  if (status.st_size < 0 || static_cast<std::size_t>(status.st_size) > kMaxMemoryFileBytes)
    return fail(ErrorCode::kInvalid, "memory file of " + std::to_string(status.st_size) + " bytes");
  std::string text(static_cast<std::size_t>(status.st_size), '\0');
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t got = pread(fd, text.data() + done, text.size() - done, static_cast<off_t>(done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return io_error("cannot read a memory file");
    if (got == 0) break;
    done += static_cast<std::size_t>(got);
  }
  text.resize(done);
  return text;
}

}  // namespace xauto
