// SPDX-License-Identifier: Apache-2.0
// The scheduler beside what else a machine does: namespaces. KTAP; as
// scx_test.
//   scx_machine_test [NAME]
#include <algorithm>

#include <fcntl.h>
#include <linux/sched.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include "tests.h"

namespace xauto::test {
namespace {

constexpr int kCpu = 1;

/// Memory that a child sees, too.
template <class T>
T& shared() {
  void* at = mmap(nullptr, sizeof(T), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (at == MAP_FAILED) ktap_bail("mmap");
  return *new (at) T{};
}

// ---- PID namespaces -----------------------------------------------------------------------------

/// A child whose thread id in its own PID namespace is `tid`, as init's is there 1.
pid_t fork_with_id(pid_t tid) {
  clone_args args{};
  args.exit_signal = SIGCHLD;
  args.set_tid = reinterpret_cast<std::uint64_t>(&tid);
  args.set_tid_size = 1;
  return static_cast<pid_t>(syscall(SYS_clone3, &args, sizeof args));
}

void pid_namespace() {
  World world(1, kCpu);
  world.load();
  struct Shared {
    std::atomic<int> step{0};
    std::atomic<bool> stop{false};
    std::atomic<double> inside{0}, stranger{0};
  };
  auto& s = shared<Shared>();
  std::atomic<pid_t> id{0};
  std::thread stranger([&] {
    pin(kCpu);
    sched_param none{};
    sched_setscheduler(0, SCHED_OTHER, &none);
    id = gettid();
    while (!s.stop) s.stranger = cpu_seconds();
  });
  wait_for([&] { return id != 0; });
  const pid_t container = fork();
  if (container == 0) {
    if (unshare(CLONE_NEWPID | CLONE_NEWNS) != 0) _exit(2);
    const pid_t init = fork();
    if (init == 0) {
      mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr);
      mount("proc", "/proc", "proc", 0, nullptr);
      const pid_t app = fork_with_id(id);
      if (app == 0) {
        cpu_set_t all;
        CPU_ZERO(&all);
        for (unsigned c = 0; c < 64; ++c) CPU_SET(c, &all);
        sched_setaffinity(0, sizeof all, &all);
        const kernel::ThreadSlot slot = world.slots.take(0);
        (void)slot.tell(0, 0);
        s.step = world.slots.enter(slot) && gettid() == id ? 1 : 3;
        while (!s.stop) s.inside = cpu_seconds();
        world.slots.leave(slot);
        _exit(0);
      }
      int status = 0;
      waitpid(app, &status, 0);
      _exit(app > 0 && status == 0 ? 0 : 4);
    }
    int status = 0;
    waitpid(init, &status, 0);
    _exit(init > 0 && status == 0 ? 0 : 5);
  }
  const bool began = wait_for([&] { return s.step != 0; }) && s.step == 1;
  sleep_ms(300);
  const double inside = s.inside, outside = s.stranger;
  sleep_ms(1500);
  const double got = s.inside - inside, other = s.stranger - outside;
  s.stop = true;
  int status = 1;
  waitpid(container, &status, 0);
  stranger.join();
  ktap_test(
      began && status == 0 && got > 4 * other,
      "an XNode thread in a PID namespace has its CPU before an ordinary one: %.2f and %.2f s", got,
      other);
}

const Test kTests[] = {
    {"pid_namespace", 1, pid_namespace},
};

}  // namespace
}  // namespace xauto::test

int main(int argc, char** argv) {
  return xauto::test::run_tests(xauto::test::kTests, argc > 1 ? argv[1] : "");
}
