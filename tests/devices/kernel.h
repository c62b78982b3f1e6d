// SPDX-License-Identifier: Apache-2.0
// Device drivers of user space, below every library: seccomp's user notification hands the system
// calls of a process and its children to a supervisor, which answers those on device nodes with the
// drivers' numbers. A file is one end of a socket pair: so it is inherited, duplicated and passed on
// as any other, and its last close is seen, whatever has ended the process.
#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <sys/types.h>

#include "base/unique_fd.h"

struct seccomp_notif;

namespace devices {

class Kernel;
class File;

/// The thread that made a system call, which waits for its answer.
class Caller {
 public:
  Caller(Kernel& kernel, std::uint64_t id, pid_t thread)
      : kernel_(kernel), id_(id), thread_(thread) {}
  [[nodiscard]] pid_t thread() const { return thread_; }
  /// False: it has no such memory; EFAULT.
  [[nodiscard]] bool read(std::uint64_t address, void* to, std::size_t size) const;
  [[nodiscard]] bool write(std::uint64_t address, const void* from, std::size_t size) const;
  template <class T>
  [[nodiscard]] bool read(std::uint64_t address, T& to) const {
    return read(address, &to, sizeof to);
  }
  template <class T>
  [[nodiscard]] bool write(std::uint64_t address, const T& from) const {
    return write(address, &from, sizeof from);
  }
  [[nodiscard]] std::string text(std::uint64_t address) const;
  /// A new descriptor of the caller's; or -errno.
  int install(std::shared_ptr<File> file);
  /// What the descriptor leads to; null: nothing of ours.
  [[nodiscard]] std::shared_ptr<File> file(int fd) const;

 private:
  Kernel& kernel_;
  std::uint64_t id_;
  pid_t thread_;
};

/// An open file of a driver; destroyed when its last descriptor is closed.
class File {
 public:
  virtual ~File() = default;
  /// What /proc/PID/fd/N reads.
  [[nodiscard]] virtual std::string link() const = 0;
  /// 0 or more, or -errno.
  virtual long ioctl(Caller& caller, unsigned command, std::uint64_t argument) = 0;
};

class Driver {
 public:
  virtual ~Driver() = default;
  [[nodiscard]] virtual bool has(const std::string& node) const = 0;
  [[nodiscard]] virtual std::shared_ptr<File> open(const std::string& node) = 0;
};

/// Owns the supervisor's thread. What drivers share with a test is guarded by `mutex()`.
class Kernel {
 public:
  /// "": seccomp's user notification is there; else why not.
  [[nodiscard]] static std::string missing();

  explicit Kernel(std::vector<std::shared_ptr<Driver>> drivers);
  ~Kernel();
  Kernel(const Kernel&) = delete;
  Kernel& operator=(const Kernel&) = delete;

  /// Runs `body` on a new thread, which has these devices, and those that it starts. It must not hold
  /// `mutex()` in a system call: the supervisor takes it to answer.
  void run(const std::function<void()>& body);
  /// Runs `body` in a new process on these devices; returns its pid.
  pid_t fork(const std::function<void()>& body);
  /// All that was closed by now is closed for its driver, too.
  void settle();
  [[nodiscard]] std::mutex& mutex() { return mutex_; }

 private:
  friend class Caller;
  struct Open {
    xauto::UniqueFd end;  ///< hangs up when the other is closed
    std::shared_ptr<File> file;
  };
  void serve(int listener);
  void answer(int listener, const seccomp_notif& call);
  /// The value to return, or -errno; `ours` false: the call is not for us.
  long emulate(Caller& caller, const seccomp_notif& call, bool& ours);
  void forget_closed();

  std::vector<std::shared_ptr<Driver>> drivers_;
  std::mutex mutex_;
  std::map<std::uint64_t, Open> open_;  ///< by the inode of the caller's end
  std::list<std::thread> threads_;
  xauto::UniqueFd stop_;
  int answering_ = -1;
};

}  // namespace devices
