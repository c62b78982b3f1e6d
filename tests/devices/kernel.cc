// SPDX-License-Identifier: Apache-2.0
#include "kernel.h"

#include <cerrno>
#include <charconv>
#include <cstddef>
#include <cstring>
#include <iterator>

#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/socket.h"

namespace devices {
namespace {

/// All that may be about a device node, and those ioctls whose type a driver has: the terminals' 'T'
/// is nvgpu's, too. Returns the listener, or -errno.
int install_filter() {
  std::vector<sock_filter> code;
  const auto load = [&](std::size_t at) {
    code.push_back(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, static_cast<std::uint32_t>(at)));
  };
  const auto notify_if = [&](std::uint32_t value) {
    code.push_back(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, value, 0, 1));
    code.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_USER_NOTIF));
  };
  load(offsetof(seccomp_data, nr));
#ifdef SYS_open
  notify_if(SYS_open);
  notify_if(SYS_stat);
  notify_if(SYS_readlink);
#endif
  notify_if(SYS_openat);
  notify_if(SYS_newfstatat);
  notify_if(SYS_readlinkat);
  code.push_back(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_ioctl, 1, 0));
  code.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
  load(offsetof(seccomp_data, args[1]));
  code.push_back(BPF_STMT(BPF_ALU | BPF_RSH | BPF_K, 8));
  code.push_back(BPF_STMT(BPF_ALU | BPF_AND | BPF_K, 0xff));
  for (const char type : {'G', 'T', 'H', 'D', 'F', 'K', 'd'})
    notify_if(static_cast<std::uint32_t>(type));
  code.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
  sock_fprog program{static_cast<unsigned short>(code.size()), code.data()};
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return -errno;
  const long listener =
      syscall(SYS_seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_NEW_LISTENER, &program);
  return listener < 0 ? -errno : static_cast<int>(listener);
}

/// Of "/proc/self/fd/7" and "/proc/123/fd/7".
bool is_descriptor_of_proc(const std::string& path, pid_t self, std::string& real) {
  if (!path.starts_with("/proc/") || path.find("/fd/") == std::string::npos) return false;
  real = path;
  if (path.starts_with("/proc/self/"))
    real = "/proc/" + std::to_string(self) + path.substr(sizeof "/proc/self" - 1);
  return true;
}

/// The inode of a socket that a link names; 0: it is none.
std::uint64_t socket_inode(const std::string& link) {
  char target[64];
  const ssize_t size = readlink(link.c_str(), target, sizeof target);
  constexpr std::size_t kPrefix = sizeof "socket:[" - 1;
  if (size <= static_cast<ssize_t>(kPrefix) || std::memcmp(target, "socket:[", kPrefix) != 0)
    return 0;
  std::uint64_t inode = 0;
  std::from_chars(target + kPrefix, target + size, inode);
  return inode;
}

}  // namespace

// ---- the caller --------------------------------------------------------------------------------

bool Caller::read(std::uint64_t address, void* to, std::size_t size) const {
  const iovec local{to, size};
  const iovec remote{reinterpret_cast<void*>(address), size};
  return process_vm_readv(thread_, &local, 1, &remote, 1, 0) == static_cast<ssize_t>(size);
}

bool Caller::write(std::uint64_t address, const void* from, std::size_t size) const {
  const iovec local{const_cast<void*>(from), size};
  const iovec remote{reinterpret_cast<void*>(address), size};
  return process_vm_writev(thread_, &local, 1, &remote, 1, 0) == static_cast<ssize_t>(size);
}

std::string Caller::text(std::uint64_t address) const {
  std::string text;
  for (char c = 0; text.size() < 4096 && read(address + text.size(), c) && c != 0;) text += c;
  return text;
}

int Caller::install(std::shared_ptr<File> file) {
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0) return -errno;
  xauto::UniqueFd ours(ends[0]);
  const xauto::UniqueFd theirs(ends[1]);
  struct stat status {};
  fstat(theirs.get(), &status);
  seccomp_notif_addfd add{};
  add.id = id_;
  add.srcfd = static_cast<std::uint32_t>(theirs.get());
  add.newfd_flags = O_CLOEXEC;
  const int fd = ::ioctl(kernel_.answering_, SECCOMP_IOCTL_NOTIF_ADDFD, &add);
  if (fd < 0) return -errno;
  kernel_.open_[status.st_ino] = {std::move(ours), std::move(file)};
  return fd;
}

std::shared_ptr<File> Caller::file(int fd) const {
  const auto it = kernel_.open_.find(
      socket_inode("/proc/" + std::to_string(thread_) + "/fd/" + std::to_string(fd)));
  return it == kernel_.open_.end() ? nullptr : it->second.file;
}

// ---- the supervisor ----------------------------------------------------------------------------

Kernel::Kernel(std::vector<std::shared_ptr<Driver>> drivers)
    : drivers_(std::move(drivers)), stop_(eventfd(0, EFD_CLOEXEC)) {}

Kernel::~Kernel() {
  const std::uint64_t one = 1;
  (void)!write(stop_.get(), &one, sizeof one);
  for (std::thread& thread : threads_) thread.join();
}

std::string Kernel::missing() {
  // It reports races of descriptors that it has not seen made, and opens files to say so, locked.
#if defined(__has_feature)
#if __has_feature(thread_sanitizer)
  return "ThreadSanitizer waits for the supervisor, and that for it";
#endif
#elif defined(__SANITIZE_THREAD__)
  return "ThreadSanitizer waits for the supervisor, and that for it";
#endif
  const pid_t child = ::fork();
  if (child == 0) {
    const int listener = install_filter();
    _exit(listener < 0 ? -listener : 0);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 0
             ? ""
             : std::string("no seccomp user notification: ") + std::strerror(WEXITSTATUS(status));
}

void Kernel::run(const std::function<void()>& body) {
  std::promise<int> installed;
  std::thread thread([&] {
    const int listener = install_filter();
    installed.set_value(listener);
    if (listener >= 0) body();
  });
  if (const int listener = installed.get_future().get(); listener >= 0)
    threads_.emplace_back([this, listener] { serve(listener); });
  thread.join();
}

pid_t Kernel::fork(const std::function<void()>& body) {
  int sockets[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, sockets) != 0) return -1;
  const xauto::UniqueFd here(sockets[0]);
  xauto::UniqueFd there(sockets[1]);
  const pid_t child = ::fork();
  if (child == 0) {
    const int listener = install_filter();
    char go = 0;
    if (listener < 0 || !xauto::send_packet(there.get(), &go, 1, {listener})) _exit(127);
    close(listener);
    // From here on nobody but the supervisor answers: it has to have begun.
    if (!xauto::receive_packet(there.get(), &go, 1)) _exit(127);
    body();
    _exit(0);
  }
  there.reset();
  char go = 0;
  std::vector<xauto::UniqueFd> fds;
  if (!xauto::receive_packet(here.get(), &go, 1, &fds) || fds.size() != 1) return -1;
  threads_.emplace_back([this, listener = fds[0].release()] { serve(listener); });
  (void)xauto::send_packet(here.get(), &go, 1);
  return child;
}

void Kernel::forget_closed() {
  for (auto it = open_.begin(); it != open_.end();) {
    pollfd poll{it->second.end.get(), 0, 0};
    const bool closed = ::poll(&poll, 1, 0) == 1 && (poll.revents & POLLHUP) != 0;
    it = closed ? open_.erase(it) : std::next(it);
  }
}

void Kernel::settle() {
  const std::lock_guard lock(mutex_);
  forget_closed();
}

void Kernel::serve(int listener) {
  const xauto::UniqueFd close_it(listener);
  for (;;) {
    pollfd polls[2] = {{listener, POLLIN, 0}, {stop_.get(), POLLIN, 0}};
    if (poll(polls, 2, -1) < 0) continue;
    if (polls[1].revents != 0 || (polls[0].revents & POLLHUP) != 0) return;
    seccomp_notif call{};
    if (::ioctl(listener, SECCOMP_IOCTL_NOTIF_RECV, &call) == 0) answer(listener, call);
  }
}

void Kernel::answer(int listener, const seccomp_notif& call) {
  const std::lock_guard lock(mutex_);
  forget_closed();
  answering_ = listener;
  Caller caller(*this, call.id, static_cast<pid_t>(call.pid));
  bool ours = false;
  const long result = emulate(caller, call, ours);
  seccomp_notif_resp response{};
  response.id = call.id;
  if (!ours)
    response.flags = SECCOMP_USER_NOTIF_FLAG_CONTINUE;
  else if (result < 0)
    response.error = static_cast<std::int32_t>(result);
  else
    response.val = result;
  (void)::ioctl(listener, SECCOMP_IOCTL_NOTIF_SEND, &response);  // it may have been killed
}

long Kernel::emulate(Caller& caller, const seccomp_notif& call, bool& ours) {
  const auto& args = call.data.args;
  long nr = call.data.nr;
  std::size_t at = 1;  // of the path
#ifdef SYS_open
  if (nr == SYS_open || nr == SYS_stat || nr == SYS_readlink) at = 0;
  nr = nr == SYS_open ? SYS_openat : nr == SYS_stat ? SYS_newfstatat : nr;
  nr = nr == SYS_readlink ? SYS_readlinkat : nr;
#endif
  if (nr == SYS_ioctl) {
    const std::shared_ptr<File> file = caller.file(static_cast<int>(args[0]));
    ours = file != nullptr;
    return ours ? file->ioctl(caller, static_cast<unsigned>(args[1]), args[2]) : 0;
  }
  const std::string path = caller.text(args[at]);
  if (std::string real;
      nr == SYS_readlinkat && is_descriptor_of_proc(path, caller.thread(), real)) {
    const auto it = open_.find(socket_inode(real));
    ours = it != open_.end();
    if (!ours) return 0;
    const std::string link = it->second.file->link().substr(0, args[at + 2]);
    return caller.write(args[at + 1], link.data(), link.size()) ? static_cast<long>(link.size())
                                                                : -EFAULT;
  }
  for (const std::shared_ptr<Driver>& driver : drivers_) {
    if (!driver->has(path)) continue;
    ours = true;
    if (nr == SYS_openat) {
      auto file = driver->open(path);
      return file == nullptr ? -ENODEV : caller.install(std::move(file));
    }
    struct stat status {};
    status.st_mode = S_IFCHR | 0666;
    if (nr == SYS_newfstatat) return caller.write(args[at + 1], status) ? 0 : -EFAULT;
    return -EINVAL;
  }
  return 0;
}

}  // namespace devices
