// SPDX-License-Identifier: Apache-2.0
#include "base/rt.h"

#include <cerrno>
#include <cstring>
#include <thread>

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>

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

bool may_use_fifo(int priority) {
  // Rights are the process's, so a thread that ends at once tells without touching the caller.
  bool allowed = false;
  std::thread([&] { allowed = set_fifo(priority).has_value(); }).join();
  return allowed;
}

std::string fifo_hint() {
  rlimit limit{};
  getrlimit(RLIMIT_RTPRIO, &limit);
  return "the real-time limit is " + std::to_string(limit.rlim_cur) +
         ": run as root, or `setcap cap_sys_nice+ep` the program, or add '@GROUP - rtprio 99' to "
         "/etc/security/limits.conf and log in again";
}

Status pin_to_core(int core) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<unsigned>(core), &set);
  if (const int error = pthread_setaffinity_np(pthread_self(), sizeof set, &set); error != 0)
    return fail(ErrorCode::kInvalid,
                "cannot run on core " + std::to_string(core) + ": " + strerror(error));
  return {};
}

std::vector<int> allowed_cores() {
  cpu_set_t set;
  CPU_ZERO(&set);
  sched_getaffinity(0, sizeof set, &set);
  std::vector<int> cores;
  for (int core = 0; core < CPU_SETSIZE; ++core)
    if (CPU_ISSET(static_cast<unsigned>(core), &set)) cores.push_back(core);
  return cores;
}

void set_timer_slack_1ns() {
  prctl(PR_SET_TIMERSLACK, 1ul, 0, 0, 0);
}

bool lock_memory() {
  return mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
}

void set_thread_name(const std::string& name) {
  pthread_setname_np(pthread_self(), name.substr(0, 15).c_str());
}

}  // namespace xauto::rt
