// SPDX-License-Identifier: Apache-2.0
#include "base/rt.h"

#include <algorithm>
#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <cstring>

#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include "base/thread.h"
#include "base/unique_fd.h"

namespace xauto::rt {

Status set_fifo(int priority) {
  sched_param wanted{};
  wanted.sched_priority = priority;
  if (const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted); error != 0)
    return fail(error == EPERM ? ErrorCode::kPermission : ErrorCode::kIo,
                "SCHED_FIFO priority " + std::to_string(priority) + ": " + strerror(error), {},
                error == EPERM ? fifo_hint() : "");
  int policy = 0;
  sched_param got{};
  pthread_getschedparam(pthread_self(), &policy, &got);
  if (policy != SCHED_FIFO || got.sched_priority != priority)
    return fail(ErrorCode::kPermission,
                "SCHED_FIFO priority " + std::to_string(priority) + " was accepted but not set", {},
                fifo_hint());
  return {};
}

Status set_other() {
  const sched_param none{};
  if (const int error = pthread_setschedparam(pthread_self(), SCHED_OTHER, &none); error != 0)
    return fail(ErrorCode::kIo, std::string("SCHED_OTHER: ") + strerror(error));
  return {};
}

Status set_nice(int nice) {
  if (setpriority(PRIO_PROCESS, static_cast<id_t>(gettid()), nice) != 0)
    return fail(ErrorCode::kPermission, "nice " + std::to_string(nice) + ": " + strerror(errno), {},
                "it needs CAP_SYS_NICE, or a limit (LimitNICE=, `nice` of limits.d)");
  return {};
}

bool may_use_fifo(int priority) {
  // Rights are the process's, so a thread that ends at once tells without touching the caller.
  bool allowed = false;
  auto asks = start_thread([&] { allowed = set_fifo(priority).has_value(); });
  if (asks) asks->join();  // no thread to ask by: none to use it, either
  return allowed;
}

int highest_fifo() {
  const int most = sched_get_priority_max(SCHED_FIFO);
  if (may_use_fifo(most)) return most;
  rlimit limit{};
  getrlimit(RLIMIT_RTPRIO, &limit);
  const int highest = static_cast<int>(std::min<rlim_t>(limit.rlim_cur, 99));
  return highest > 0 && may_use_fifo(highest) ? highest : 0;
}

Status set_fifo_up_to(int priority) {
  if (const Status set = set_fifo(priority)) return set;
  return set_fifo(std::clamp(highest_fifo(), 1, priority));
}

std::string fifo_hint() {
  rlimit limit{};
  getrlimit(RLIMIT_RTPRIO, &limit);
  return "the real-time limit is " + std::to_string(limit.rlim_cur) + ": " +
         way_to_fifo(geteuid() == 0);
}

std::string way_to_fifo(bool root) {
  if (root)
    return "root is refused here: a container or unit needs CAP_SYS_NICE (`--cap-add SYS_NICE`), "
           "or "
           "a real-time limit (`--ulimit rtprio=60`, LimitRTPRIO=60); see `xauto doctor`, too";
  return "put '@GROUP - rtprio 60' into /etc/security/limits.d/xauto.conf and log in again (in a "
         "systemd unit: LimitRTPRIO=60), or run as root";
}

Status pin_to_core(int core) {
  return pin_to_cores({core});
}

Status pin_to_cores(const std::vector<int>& cores, pid_t thread) {
  cpu_set_t set;
  CPU_ZERO(&set);
  std::string names;
  for (const int core : cores) {
    CPU_SET(static_cast<unsigned>(core), &set);
    names += (names.empty() ? "" : ", ") + std::to_string(core);
  }
  if (sched_setaffinity(thread, sizeof set, &set) != 0)
    return fail(ErrorCode::kInvalid, "cannot run on core " + names + ": " + strerror(errno));
  return {};
}

namespace {

std::vector<int> cores_of(const cpu_set_t& set) {
  std::vector<int> cores;
  for (int core = 0; core < CPU_SETSIZE; ++core)
    if (CPU_ISSET(static_cast<unsigned>(core), &set)) cores.push_back(core);
  return cores;
}

}  // namespace

Placement placement_of(pid_t thread) {
  cpu_set_t set;
  CPU_ZERO(&set);
  const int policy = sched_getscheduler(thread);
  if (policy < 0 || sched_getaffinity(thread, sizeof set, &set) != 0) return {};
  return {cores_of(set), policy};
}

std::vector<int> allowed_cores() {
  cpu_set_t set;
  CPU_ZERO(&set);
  sched_getaffinity(0, sizeof set, &set);
  return cores_of(set);
}

void set_timer_slack_1ns() {
  prctl(PR_SET_TIMERSLACK, 1ul, 0, 0, 0);
}

void leave_huge_pages() {
  // Asked first: setting it takes the lock that page faults take.
  if (prctl(PR_GET_THP_DISABLE, 0, 0, 0, 0) == 0) prctl(PR_SET_THP_DISABLE, 1, 0, 0, 0);
}

bool lock_memory() {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  // Under a limit, locking what is yet to come would let any later mapping fail, a thread's stack
  // included.
  const bool unlimited = limit.rlim_cur == RLIM_INFINITY || geteuid() == 0;
  return mlockall(unlimited ? MCL_CURRENT | MCL_FUTURE : MCL_CURRENT) == 0;
}

namespace {

// Three numbers: ns on a core, ns in a run queue, how often it got a core (kernel: proc_pid_schedstat).
// The second is added to when it gets one, so that who asks for its own time has all of it, and so has who
// asks for that of a thread that sleeps. All three are 0 where nobody counts, which can be a matter of the
// kernel's command line (nodelayacct, 5.10).
std::optional<std::int64_t> waited_by(int schedstat) {
  const auto times = times_of(schedstat);
  return times ? std::optional(times->waited_ns) : std::nullopt;
}

}  // namespace

std::optional<ThreadTimes> times_of(int schedstat) {
  char text[96];
  const ssize_t size = pread(schedstat, text, sizeof text - 1, 0);
  if (size <= 0) return std::nullopt;
  text[size] = 0;
  std::int64_t ran = 0, waited = 0, times = 0;
  if (std::sscanf(text, "%" SCNd64 " %" SCNd64 " %" SCNd64, &ran, &waited, &times) != 3 ||
      times == 0)
    return std::nullopt;
  return ThreadTimes{ran, waited};
}

std::optional<std::int64_t> without_core_ns() {
  thread_local const UniqueFd file(open("/proc/thread-self/schedstat", O_RDONLY | O_CLOEXEC));
  return waited_by(file.get());
}

std::optional<std::int64_t> without_core_ns(pid_t asleep) {
  const std::string folder = "/proc/self/task/" + std::to_string(asleep);
  const UniqueFd stat(open((folder + "/stat").c_str(), O_RDONLY | O_CLOEXEC));
  char text[512];
  const ssize_t size = pread(stat.get(), text, sizeof text - 1, 0);
  if (size <= 0) return std::nullopt;
  text[size] = 0;
  const char* behind_name = std::strrchr(text, ')');  // which may have any bytes
  if (behind_name == nullptr || std::strlen(behind_name) < 3 ||
      std::strchr("SDTt", behind_name[2]) == nullptr)
    return std::nullopt;
  const UniqueFd schedstat(open((folder + "/schedstat").c_str(), O_RDONLY | O_CLOEXEC));
  return waited_by(schedstat.get());
}

void set_thread_name(const std::string& name) {
  pthread_setname_np(pthread_self(), name.substr(0, 15).c_str());
}

}  // namespace xauto::rt
