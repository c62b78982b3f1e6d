// SPDX-License-Identifier: Apache-2.0
#include "coord/core_thread.h"

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include <linux/capability.h>
#include <poll.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/core_levels.h"
#include "coord/regulator.h"

namespace xauto::coord {
namespace {

namespace fs = std::filesystem;

std::string tasks_of(pid_t process) {
  return "/proc/" + std::to_string(process) + "/task";
}

/// What that thread is called in its own PID namespace: the last number of that line. 0: it has gone.
pid_t own_name(const std::string& task) {
  FILE* const file = std::fopen((task + "/status").c_str(), "r");
  if (file == nullptr) return 0;
  char line[256];
  pid_t name = 0;
  while (name == 0 && std::fgets(line, sizeof line, file) != nullptr) {
    if (std::strncmp(line, "NSpid:", 6) != 0) continue;
    const char* last = std::strrchr(line, '\t');
    const char* end = line + std::strlen(line);
    if (last != nullptr) (void)std::from_chars(last + 1, end, name);
  }
  std::fclose(file);
  return name;
}

template <class Each>
void each_thread(pid_t process, Each each) {
  std::error_code error;
  for (fs::directory_iterator it(tasks_of(process), error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().filename().string();
    pid_t thread = 0;
    if (std::from_chars(name.data(), name.data() + name.size(), thread).ec == std::errc())
      if (!each(thread, it->path().string())) return;
  }
}

bool set(pid_t thread, int policy, int priority) {
  sched_param wanted{};
  wanted.sched_priority = priority;
  return sched_setscheduler(thread, policy, &wanted) == 0;
}

}  // namespace

pid_t thread_of(pid_t process, pid_t named) {
  if (process <= 0 || named <= 0) return 0;
  // Mostly the namespace is ours.
  if (own_name(tasks_of(process) + "/" + std::to_string(named)) == named) return named;
  pid_t found = 0;
  each_thread(process, [&](pid_t thread, const std::string& task) {
    if (own_name(task) == named) found = thread;
    return found == 0;
  });
  return found;
}

UniqueFd process_behind(int socket, pid_t pid) {
#ifndef SO_PEERPIDFD
  constexpr int SO_PEERPIDFD = 77;  // Linux 6.5
#endif
  int fd = -1;
  socklen_t size = sizeof fd;
  if (getsockopt(socket, SOL_SOCKET, SO_PEERPIDFD, &fd, &size) == 0) return UniqueFd(fd);
  return UniqueFd(static_cast<int>(syscall(SYS_pidfd_open, pid, 0)));
}

bool lives(int process) {
  pollfd ended{process, POLLIN, 0};
  return process >= 0 && poll(&ended, 1, 0) == 0;
}

int core_number(const std::string& hardware) {
  int core = -1;
  if (!hardware.starts_with("core")) return -1;
  const char* const begin = hardware.data() + 4;
  const char* const end = hardware.data() + hardware.size();
  const auto [stopped, error] = std::from_chars(begin, end, core);
  return error == std::errc() && stopped == end && core >= 0 && core < CPU_SETSIZE ? core : -1;
}

bool give_core(pid_t thread, int core) {
  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(core, &one);
  return sched_setaffinity(thread, sizeof one, &one) == 0 &&
         set(thread, SCHED_FIFO | SCHED_RESET_ON_FORK, kCpuRegulated);
}

void take_core(pid_t thread, bool anywhere) {
  (void)set(thread, SCHED_OTHER, 0);
  if (!anywhere) return;
  cpu_set_t all;
  std::memset(&all, 0xff, sizeof all);
  (void)sched_setaffinity(thread, sizeof all, &all);
}

void let_ask(pid_t thread) {
  (void)set(thread, SCHED_FIFO | SCHED_RESET_ON_FORK, kCpuAsks);
}

void take_cores(pid_t process) {
  each_thread(process, [](pid_t thread, const std::string&) {
    take_core(thread, true);
    return true;
  });
}

Status limit_raised(pid_t process) {
  const rlim_t us = kRtLimitNs / 1000;
  rlimit limit{};
  if (prlimit(process, RLIMIT_RTTIME, nullptr, &limit) != 0 ||
      (limit.rlim_max > us && (limit = {us, us}, true) &&
       prlimit(process, RLIMIT_RTTIME, &limit, nullptr) != 0))
    return fail(ErrorCode::kPermission, std::string("prlimit: ") + strerror(errno));
  return {};
}

bool may_give_cores() {
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  __user_cap_data_struct data[2]{};
  if (syscall(SYS_capget, &header, data) != 0) return false;
  const auto has = [&](int cap) { return (data[cap / 32].effective >> (cap % 32) & 1u) != 0; };
  return has(CAP_SYS_NICE);
}

}  // namespace xauto::coord
