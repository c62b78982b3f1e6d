// SPDX-License-Identifier: Apache-2.0
// The scheduler beside what else a machine does: namespaces, CPUs that go and come, cgroups, several apps, crowds. KTAP; as
// scx_test.
//   scx_machine_test [NAME [LOADS [THREADS]]]      of loaded_meanwhile, of fork_bomb
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <numeric>
#include <sstream>
#include <string>

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
  if (at == MAP_FAILED) ksft_exit_fail_msg("mmap\n");
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
  World& world = loaded_world();
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
  ksft_test_result(
      began && status == 0 && got > 4 * other,
      "an XNode thread in a PID namespace has its CPU before an ordinary one: %.2f and %.2f s\n",
      got, other);
}

/// A run's maps are its own as long as it lives, also where its number is nobody's.
void runs_elsewhere() {
  World world(1, kCpu);
  const pid_t container = fork();
  if (container == 0) {
    if (unshare(CLONE_NEWPID) != 0) _exit(2);
    const pid_t init = fork();
    if (init == 0) {
      const auto other = kernel::RunMaps::create("1-0", 1, 1);
      const auto runs = kernel::RunMaps::runs();
      _exit(other && std::count(runs.begin(), runs.end(), world.maps.run()) == 1 ? 0 : 4);
    }
    int status = 0;
    waitpid(init, &status, 0);
    _exit(init > 0 && status == 0 ? 0 : 5);
  }
  int status = 1;
  waitpid(container, &status, 0);
  const bool there =
      access((kernel::RunMaps::folder(world.maps.run()) + "/head").c_str(), F_OK) == 0;
  ksft_test_result(status == 0 && there,
                   "a run in a container sees one outside, and leaves it its maps\n");
  // It ended without saying so.
  { const World next(1, kCpu); }
  ksft_test_result(access(kernel::RunMaps::folder("1-0").c_str(), F_OK) != 0,
                   "... and what is left of it after its death goes with the next run\n");
}

// ---- CPUs that go and come ----------------------------------------------------------------------

bool switch_cpu(int cpu, bool on) {
  const std::string file = "/sys/devices/system/cpu/cpu" + std::to_string(cpu) + "/online";
  const int fd = open(file.c_str(), O_WRONLY);
  const bool done = fd >= 0 && write(fd, on ? "1" : "0", 1) == 1;
  close(fd);
  return done;
}

/// A thread that is nobody's job.
void be_ordinary(int cpu = -1) {
  cpu_set_t all;
  CPU_ZERO(&all);
  for (unsigned c = 0; c < 64; ++c)
    if (cpu < 0 || c == static_cast<unsigned>(cpu)) CPU_SET(c, &all);
  sched_setaffinity(0, sizeof all, &all);
  sched_param none{};
  sched_setscheduler(0, SCHED_OTHER, &none);
}

void hotplug() {
  constexpr int kRounds = 4;
  World& world = loaded_world();
  std::atomic<bool> stop{false};
  std::atomic<double> low{0}, high{0}, ordinary{0}, pinned{0};
  std::atomic<int> where{-1};
  int switched = 0, ran = 0, back = 0;
  {
    const auto show = [&](std::atomic<double>& cpu) {
      while (!stop) cpu = cpu_seconds();
    };
    XNodeThread spins(world, 0, [&](const kernel::ThreadSlot&) { show(low); });
    Waiter waiter(world, 1, [&](const kernel::ThreadSlot&) {
      where = sched_getcpu();
      burn_us(1000);
      high = cpu_seconds();
    });
    std::thread anywhere([&] {
      be_ordinary();
      show(ordinary);
    });
    std::thread here([&] {
      be_ordinary(kCpu);
      show(pinned);
    });
    std::uint32_t jobs = 0;
    const auto job_ran = [&] {
      waiter.submit(1, ++jobs);
      return wait_for([&] { return waiter.done() == jobs; });
    };
    const auto all_run = [&] {
      const double before[4] = {low, high, ordinary, pinned};
      return job_ran() && wait_for([&] {
               return low > before[0] && high > before[1] && ordinary > before[2] &&
                      pinned > before[3];
             });
    };
    for (int i = 0; i < kRounds; ++i) {
      switched += switch_cpu(kCpu, false);
      ran += all_run() && where != kCpu;
      switched += switch_cpu(kCpu, true);
      // The CPU's own wake-up may have raced with its coming.
      back += wait_for([&] { return job_ran() && where == kCpu; });
    }
    stop = true;
    anywhere.join();
    here.join();
  }
  const auto exit = kernel::scx_exit_of(world.maps.sched());
  ksft_print_msg("%s\n", exit ? exit->c_str() : "the scheduler is there");
  ksft_test_result(switched == 2 * kRounds && scx_state() == "enabled" && !exit,
                   "a CPU goes and comes %d times, and the scheduler stays\n", kRounds);
  ksft_test_result(ran == kRounds, "... while it is away, its threads run on another: %d of %d\n",
                   ran, kRounds);
  ksft_test_result(back == kRounds, "... and come back to it: %d of %d\n", back, kRounds);
}

/// A CPU goes or comes while the scheduler is loaded: at another moment each time.
int g_loads = 8;

void loaded_meanwhile() {
  end_loaded_world();
  World world(1, 0);
  int loaded = 0, stayed = 0, switched = 0;
  for (int i = 0; i < g_loads; ++i) {
    std::thread other([&] {
      sleep_ms(100 + 300 * i);
      switched += switch_cpu(kCpu, i % 2 != 0);
    });
    {
      auto loader = world.try_load();
      loaded += loader ? 1 : 0;
      if (!loader) ksft_print_msg("%s\n", loader.error().what.c_str());
      other.join();
      stayed += scx_state() == "enabled";
    }
    wait_for([] { return scx_state() == "disabled"; });
  }
  // It went in the last load of an odd number; the tests after this one need it.
  if (g_loads % 2 != 0) switch_cpu(kCpu, true);
  ksft_test_result(loaded == g_loads && stayed == g_loads && switched == g_loads,
                   "a CPU goes or comes during a load: %d of %d loaded, %d stayed\n", loaded,
                   g_loads, stayed);
}

// ---- cgroups ------------------------------------------------------------------------------------

bool put(const std::string& file, const std::string& text) {
  const int fd = open(file.c_str(), O_WRONLY);
  const bool done = fd >= 0 && write(fd, text.data(), text.size()) == ssize_t(text.size());
  close(fd);
  return done;
}

void cpu_max() {
  const std::string root = "/sys/fs/cgroup", limited = root + "/limited";
  (void)loaded_world();
  put(root + "/cgroup.subtree_control", "+cpu");
  mkdir(limited.c_str(), 0755);
  if (access((limited + "/cpu.max").c_str(), F_OK) != 0) {
    for (int i = 0; i < 2; ++i)
      ksft_test_result_skip("cpu.max: this kernel has none (CONFIG_CFS_BANDWIDTH)\n");
    return;
  }
  const bool set = put(limited + "/cpu.max", "20000 100000");
  struct Shared {
    std::atomic<bool> stop{false};
    std::atomic<double> got[3]{};
  };
  auto& s = shared<Shared>();
  std::vector<pid_t> children;
  for (int i = 0; i < 3; ++i) {  // two of the limited cgroup, one beside them
    children.push_back(fork());
    if (children.back() != 0) continue;
    be_ordinary();
    if (i < 2 && !put(limited + "/cgroup.procs", "0")) _exit(1);
    while (!s.stop) s.got[i] = cpu_seconds();
    _exit(0);
  }
  sleep_ms(500);
  const double before[3] = {s.got[0], s.got[1], s.got[2]};
  const auto begin = Clock::now();
  sleep_ms(5000);
  const double wall = seconds(Clock::now() - begin);
  const double both = s.got[0] - before[0] + s.got[1] - before[1], other = s.got[2] - before[2];
  s.stop = true;
  int failed = 0;
  for (const pid_t child : children) {
    int status = 1;
    waitpid(child, &status, 0);
    failed += status != 0;
  }
  rmdir(limited.c_str());
  ksft_test_result(set && failed == 0 && both > 0.1 * wall && both < 0.3 * wall,
                   "a cgroup limited to 20 %% of a CPU has that: %.2f of %.2f s\n", both, wall);
  ksft_test_result(other > 0.8 * wall && scx_state() == "enabled",
                   "... and who is beside it is not slowed down: %.2f s\n", other);
}

// ---- strangers ----------------------------------------------------------------------------------

constexpr uid_t kStranger = 65534;

/// A cgroup that the stranger may do with as one does with one's own. Returns false without cpu.max.
bool give_cgroup(const std::string& path, const char* limit) {
  const std::string root = "/sys/fs/cgroup";
  put(root + "/cgroup.subtree_control", "+cpu");
  mkdir(path.c_str(), 0755);
  if (!put(path + "/cpu.max", limit)) return false;
  for (const char* file : {"", "/cgroup.procs", "/cgroup.subtree_control", "/cgroup.threads"})
    if (chown((path + file).c_str(), kStranger, kStranger) != 0) return false;
  return true;
}

void become_stranger() {
  if (setgid(kStranger) != 0 || setuid(kStranger) != 0) _exit(9);
}

/// The limit is the outermost's, however deep its threads have nested themselves.
void deep_groups() {
  constexpr int kDeep = 40;
  const std::string limited = "/sys/fs/cgroup/deep";
  (void)loaded_world();
  if (!give_cgroup(limited, "20000 100000")) {
    ksft_test_result_skip("nested cgroups: this kernel has no cpu.max (CONFIG_CFS_BANDWIDTH)\n");
    return;
  }
  struct Shared {
    std::atomic<bool> stop{false}, nested{false};
    std::atomic<double> got{0};
  };
  auto& s = shared<Shared>();
  const pid_t child = fork();
  if (child == 0) {
    be_ordinary();
    if (!put(limited + "/cgroup.procs", "0")) _exit(1);
    become_stranger();
    if (chdir(limited.c_str()) != 0) _exit(2);
    for (int i = 0; i < kDeep; ++i) {
      // Nobody may be in one that hands its controllers down.
      if (mkdir("below", 0755) != 0 || !put("below/cgroup.procs", "0") ||
          !put("cgroup.subtree_control", "+cpu") || chdir("below") != 0)
        _exit(3);
    }
    s.nested = true;
    while (!s.stop) s.got = cpu_seconds();
    _exit(0);
  }
  const bool nested = wait_for([&] { return s.nested.load(); }, 60);
  sleep_ms(500);
  const double before = s.got;
  const auto begin = Clock::now();
  sleep_ms(3000);
  const double wall = seconds(Clock::now() - begin), got = s.got - before;
  s.stop = true;
  int status = 1;
  waitpid(child, &status, 0);
  for (int i = kDeep; i >= 0; --i) {
    std::string path = limited;
    for (int k = 0; k < i; ++k) path += "/below";
    wait_for([&] { return rmdir(path.c_str()) == 0; });
  }
  ksft_test_result(nested && status == 0 && got > 0.1 * wall && got < 0.3 * wall,
                   "a cgroup's limit holds for who has nested itself %d deeper: %.2f of %.2f s\n",
                   kDeep, got, wall);
}

/// Microseconds that a cgroup has used.
std::int64_t usage_us(const std::string& cgroup) {
  const std::string line = slurp(cgroup + "/cpu.stat");  // "usage_usec N"
  return atoll(line.c_str() + std::min(line.size(), strlen("usage_usec ")));
}

/// The count of each is kept, however many there are. A turn of 5 ms is five periods' quota.
void many_groups() {
  constexpr int kGroups = 1100;
  const std::string all = "/sys/fs/cgroup/many";
  if (!full()) {
    ksft_test_result_skip(
        "many limited cgroups: to make them takes long: `make check-full` has it\n");
    return;
  }
  (void)loaded_world({"--timeout", "30s"});
  if (!give_cgroup(all, "max") || !put(all + "/cgroup.subtree_control", "+cpu")) {
    ksft_test_result_skip(
        "many limited cgroups: this kernel has no cpu.max (CONFIG_CFS_BANDWIDTH)\n");
    return;
  }
  struct Shared {
    std::atomic<int> there{0};
    std::atomic<std::uint32_t> go{0};
  };
  auto& s = shared<Shared>();
  std::vector<pid_t> children;
  for (int i = 0; i < kGroups; ++i) {
    const std::string group = all + "/" + std::to_string(i);
    if (!give_cgroup(group, "1000 1000000")) break;
    children.push_back(fork());
    if (children.back() != 0) continue;
    be_ordinary();
    if (!put(group + "/cgroup.procs", "0")) _exit(1);
    ++s.there;
    while (s.go == 0) syscall(SYS_futex, &s.go, FUTEX_WAIT, 0, nullptr, nullptr, 0);
    for (;;) asm volatile("");
  }
  const bool there = wait_for([&] { return s.there == kGroups; }, 120);
  s.go = 1;
  syscall(SYS_futex, &s.go, FUTEX_WAKE, 1 << 30, nullptr, nullptr, 0);
  sleep_ms(5400);  // each has had its turn
  const std::int64_t before = usage_us(all);
  const auto begin = Clock::now();
  sleep_ms(700);
  const double wall = seconds(Clock::now() - begin);
  const double got = static_cast<double>(usage_us(all) - before) * 1e-6;
  for (const pid_t child : children) kill(child, SIGKILL);
  for (const pid_t child : children) waitpid(child, nullptr, 0);
  for (int i = 0; i < kGroups; ++i) rmdir((all + "/" + std::to_string(i)).c_str());
  rmdir(all.c_str());
  ksft_test_result(there && before > 0 && got < 0.4 * wall,
                   "%d limited cgroups that have had their quota wait: they ran %.2f of %.2f s\n",
                   kGroups, got, wall);
}

/// Threads of another user, all of which spin once they are let go.
class Bomb {
 public:
  Bomb(int threads, const std::string& cgroup) : shared_(shared<Shared>()) {
    child_ = fork();
    if (child_ == 0) burst(threads);
    ready_ = wait_for([&] { return shared_.made.load() != 0; }, 300);
    if (!cgroup.empty()) ready_ = put(cgroup + "/cgroup.procs", std::to_string(child_)) && ready_;
  }
  void go() {
    shared_.go = 1;
    syscall(SYS_futex, &shared_.go, FUTEX_WAKE, 1 << 30, nullptr, nullptr, 0);
  }
  ~Bomb() {
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
  }
  [[nodiscard]] int made() const { return ready_ ? shared_.made.load() : 0; }

 private:
  struct Shared {
    std::atomic<int> made{0};
    std::atomic<std::uint32_t> go{0};
  };
  static void* spin_later(void* at) {
    auto& go = static_cast<Shared*>(at)->go;
    while (go == 0) syscall(SYS_futex, &go, FUTEX_WAIT, 0, nullptr, nullptr, 0);
    for (;;) asm volatile("");
  }
  [[noreturn]] void burst(int threads) {
    be_ordinary();
    become_stranger();
    pthread_attr_t small;
    pthread_attr_init(&small);
    pthread_attr_setstacksize(&small, 16384);
    pthread_attr_setguardsize(&small, 0);
    int made = 0;
    for (pthread_t thread; made < threads; ++made)
      if (pthread_create(&thread, &small, spin_later, &shared_) != 0) break;
    shared_.made = made;
    for (;;) pause();
  }
  Shared& shared_;
  pid_t child_ = -1;
  bool ready_ = false;
};

/// How late a job of the waiter's begins: of that many, the median and the worst, ms.
struct Late {
  double median = 0, worst = 0;
};
Late how_late(Waiter& waiter, std::atomic<std::int64_t>& began_ns, int jobs) {
  std::vector<double> late;
  for (int i = 0; i < jobs; ++i) {
    sleep_ms(7);  // no multiple of anybody's period
    const std::uint32_t done = waiter.done();
    const std::int64_t since_ns = now_ns();
    waiter.wake();
    if (!wait_for([&] { return waiter.done() != done; }, 60))
      ksft_exit_fail_msg("a job does not run\n");
    late.push_back(static_cast<double>(began_ns - since_ns) * 1e-6);
  }
  std::sort(late.begin(), late.end());
  return {late[late.size() / 2], late.back()};
}

int g_bomb = 2000;

/// What is done with a run queue locked does not grow with their number. More than the test's own are for by
/// hand: the kernel's limit has to be longer then.
void fork_bomb() {
  constexpr int kJobs = 200;
  const std::string limited = "/sys/fs/cgroup/bomb";
  World& world = g_bomb > 2000 ? loaded_world({"--timeout", "30s"}) : loaded_world();
  const bool has_limit = give_cgroup(limited, "100000 100000");
  std::atomic<std::int64_t> began_ns{0};
  Waiter waiter(world, 0, [&](const kernel::ThreadSlot&) {
    began_ns = now_ns();
    burn_us(500);
  });
  waiter.submit(0, 1);
  const Late quiet = how_late(waiter, began_ns, kJobs);
  ksft_print_msg("nobody else: %.2f ms (median), %.2f (worst)\n", quiet.median, quiet.worst);
  for (const bool parked : {true, false}) {
    if (parked && !has_limit) {
      ksft_test_result_skip("parked threads: this kernel has no cpu.max (CONFIG_CFS_BANDWIDTH)\n");
      continue;
    }
    Bomb bomb(g_bomb, parked ? limited : "");
    bomb.go();
    sleep_ms(500);
    const Late late = how_late(waiter, began_ns, kJobs);
    ksft_print_msg("%d threads%s: %.2f ms (median), %.2f (worst)\n", bomb.made(),
                   parked ? " of a limited cgroup" : "", late.median, late.worst);
    ksft_test_result(bomb.made() == g_bomb && late.worst < 15 && scx_state() == "enabled",
                     "a job is not held up by %d threads of a stranger's%s: %.1f ms at worst\n",
                     bomb.made(), parked ? " in a limited cgroup" : "", late.worst);
  }
  wait_for([&] { return rmdir(limited.c_str()) == 0; });
}

/// Too many to be served within the kernel's limit: those that have waited for half of it do not take the CPUs.
void share_of_a_crowd() {
  constexpr int kThreads = 800;
  const auto cpus = static_cast<std::uint32_t>(sysconf(_SC_NPROCESSORS_ONLN));
  World world(cpus, kCpu);
  for (std::uint32_t i = 0; i < cpus; ++i) world.rows[i].cpu = i;
  world.put_rows();
  world.load({"--timeout", "4s"});
  std::vector<std::atomic<double>> got(cpus);
  std::atomic<bool> stop{false};
  double share = 0;
  int made = 0;
  std::uint64_t rescued = 0;
  {
    Bomb bomb(kThreads, "");
    made = bomb.made();
    std::vector<std::unique_ptr<XNodeThread>> spinners;
    for (std::uint32_t i = 0; i < cpus; ++i)
      spinners.push_back(std::make_unique<XNodeThread>(world, i, [&, i](const kernel::ThreadSlot&) {
        while (!stop) got[i] = cpu_seconds();
      }));
    bomb.go();
    sleep_ms(2300);
    const auto sum = [&] { return std::accumulate(got.begin(), got.end(), 0.0); };
    const double before = sum();
    const std::uint64_t floor = world.stat(XAUTO_BPF_STAT_FLOOR);
    const auto begin = Clock::now();
    sleep_ms(1200);
    share = (sum() - before) / (seconds(Clock::now() - begin) * cpus);
    rescued = world.stat(XAUTO_BPF_STAT_FLOOR) - floor;
    stop = true;
  }
  ksft_test_result(
      made == kThreads && share > 0.6,
      "XNodes have %.0f %% of the CPUs where %d threads of a stranger's have waited for long (%d "
      "turns)\n",
      share * 100, made, static_cast<int>(rescued));
}

// ---- kernel threads -----------------------------------------------------------------------------

/// Writing into a pty keeps a kernel worker busy; all unbound workers are sent to the XNode's CPU.
void kernel_hog() {
  const std::string cpus = "/sys/devices/virtual/workqueue/cpumask";
  const std::string before = slurp(cpus);
  World& world = loaded_world();
  std::atomic<bool> stop{false};
  std::atomic<double> got{0};
  double share = 0;
  {
    XNodeThread spins(world, 0, [&](const kernel::ThreadSlot&) {
      while (!stop) got = cpu_seconds();
    });
    const bool sent = put(cpus, "2");
    std::vector<std::thread> writers;
    for (int i = 0; i < 4; ++i)
      writers.emplace_back([&] {
        be_ordinary(0);
        const int master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
        grantpt(master);
        unlockpt(master);
        const int slave = open(ptsname(master), O_RDWR | O_NOCTTY | O_NONBLOCK);
        char text[2048];
        memset(text, 'a', sizeof text);
        while (!stop) {
          (void)!write(master, text, sizeof text);
          (void)!read(slave, text, sizeof text);
          (void)!read(master, text, sizeof text);
        }
        close(slave);
        close(master);
      });
    sleep_ms(500);
    const double from = got;
    const auto begin = Clock::now();
    sleep_ms(3000);
    share = sent ? (got - from) / seconds(Clock::now() - begin) : 0;
    stop = true;
    for (auto& writer : writers) writer.join();
    put(cpus, before);
  }
  ksft_test_result(share > 0.3 && scx_state() == "enabled",
                   "kernel threads that are busy leave an XNode its CPU: %.0f %%\n", share * 100);
}

/// khugepaged asked to be nice. Where it has work without end it gets what ordinary threads get.
void nice_kernel_thread() {
  const std::string knobs = "/sys/kernel/mm/transparent_hugepage/";
  pid_t khugepaged = 0;
  for (const auto& entry : std::filesystem::directory_iterator("/proc"))
    if (slurp(entry.path() / "comm") == "khugepaged")
      khugepaged = atoi(entry.path().filename().c_str());
  if (khugepaged == 0) {
    ksft_test_result_skip("a nice kernel thread: this kernel has no khugepaged\n");
    return;
  }
  const std::string wait = slurp(knobs + "khugepaged/scan_sleep_millisecs");
  // "[always] madvise never" where it is read, one word where it is written.
  std::string usual = slurp(knobs + "enabled");
  if (const size_t from = usual.find('['); from != usual.npos)
    usual = usual.substr(from + 1, usual.find(']') - from - 1);
  const auto used_s = [&] {
    return atof(slurp("/proc/" + std::to_string(khugepaged) + "/schedstat").c_str()) / 1e9;
  };
  World& world = loaded_world();
  std::atomic<bool> stop{false};
  double share = 1;
  {
    XNodeThread spins(world, 0, [&](const kernel::ThreadSlot&) { spin(stop); });
    cpu_set_t own, all;
    CPU_ZERO(&own);
    CPU_SET(kCpu, &own);
    sched_getaffinity(khugepaged, sizeof all, &all);
    const bool sent = sched_setaffinity(khugepaged, sizeof own, &own) == 0 &&
                      put(knobs + "enabled", "always") &&
                      put(knobs + "khugepaged/scan_sleep_millisecs", "0");
    sleep_ms(500);
    const double from = used_s();
    const auto begin = Clock::now();
    sleep_ms(3000);
    const double got = used_s() - from;
    if (!sent || got <= 0)
      ksft_print_msg("khugepaged %s\n", sent ? "did not run" : "could not be sent");
    if (sent && got > 0) share = got / seconds(Clock::now() - begin);
    stop = true;
    put(knobs + "khugepaged/scan_sleep_millisecs", wait);
    put(knobs + "enabled", usual);
    sched_setaffinity(khugepaged, sizeof all, &all);
  }
  ksft_test_result(share < 0.08, "a nice kernel thread has the floor, no more: %.1f %%\n",
                   share * 100);
}

// ---- what is said when it goes wrong --------------------------------------------------------------

void dumped() {
  const std::string trace = "/sys/kernel/tracing/";
  World& world = loaded_world();
  std::atomic<bool> stop{false};
  XNodeThread spins(world, 0, [&](const kernel::ThreadSlot&) { spin(stop); });
  put(trace + "trace", "\n");
  put(trace + "events/sched_ext/sched_ext_dump/enable", "1");
  put("/proc/sysrq-trigger", "D");  // the kernel's dump of its scheduler
  int general = 0, cpu = 0, slot = 0;
  std::ifstream lines(trace + "trace");
  for (std::string line; std::getline(lines, line);) {
    general += line.find("xauto: mode 1, ") != std::string::npos;
    cpu += line.find("wait by key, credit") != std::string::npos;
    slot += line.find("xauto: slot 0, XNode 0, key -10, ran ") != std::string::npos;
  }
  put(trace + "events/sched_ext/sched_ext_dump/enable", "0");
  stop = true;
  ksft_test_result(general == 1 && cpu > 0 && slot == 1,
                   "the kernel's dump tells our queues, CPUs and slots: %d, %d, %d lines\n",
                   general, cpu, slot);
}

// ---- several apps -------------------------------------------------------------------------------

void second_app() {
  World world(2, kCpu);  // priorities 10 and 20
  world.load();
  std::vector<kernel::TableRow> rows{{static_cast<std::uint32_t>(kCpu), -15, 0}};
  {
    auto second = kernel::RunMaps::join(world.maps.run(), 1);
    if (!second) ksft_exit_fail_msg("joining: %s\n", second.error().to_string().c_str());
    if (!second->replace_table(rows)) ksft_exit_fail_msg("writing rows\n");
    std::atomic<bool> stop{false};
    double between = 0, low_cpu = 0, high_cpu = 0;
    {
      const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
      XNodeThread low(world, 0, body), other(world, second->first(), body);
      sleep_ms(1500);
      world.put_rows();  // the first app's new table leaves the other's rows alone
      std::optional<XNodeThread> high(std::in_place, world, 1, body);
      sleep_ms(1500);
      stop = true;
      low.join();
      other.join();
      high->join();
      low_cpu = low.cpu();
      between = other.cpu();
      high_cpu = high->cpu();
    }
    ksft_test_result(
        low_cpu < 0.3 && between > 1.0 && between < 2.0 && high_cpu > 1.0,
        "a second app's priority of 15 is between the first one's 10 and 20: %.2f, %.2f, "
        "%.2f s of 3\n",
        low_cpu, between, high_cpu);
  }
  {
    auto third = kernel::RunMaps::join(world.maps.run(), 512);
    ksft_test_result(third && third->first() == 2, "... and its rows are free again after it\n");
  }
  auto& entered = shared<std::atomic<int>>();
  entered = -1;
  const pid_t killed = fork();
  if (killed == 0) {
    be_ordinary();
    auto joined = kernel::RunMaps::join(world.maps.run(), 512);
    const kernel::ThreadSlot slot = world.slots.take(0);
    if (joined && joined->replace_table(std::vector<kernel::TableRow>(512, rows.front())) &&
        world.slots.enter(slot))
      entered = world.slots.index(slot);
    for (;;) pause();
  }
  const bool began = wait_for([&] { return entered >= 0; });
  kill(killed, SIGKILL);
  waitpid(killed, nullptr, 0);
  auto fourth = kernel::RunMaps::join(world.maps.run(), 512);
  ksft_test_result(began && fourth && fourth->first() == 2,
                   "... also of one that was killed, while the first goes on\n");
  ksft_test_result(began && world.maps.slots()[entered].tid == 0,
                   "... and the slots of its threads\n");
}

// ---- clusters -----------------------------------------------------------------------------------

/// To the first CPU, of the kernel's threads, those that may: kdamond wakes up every 5 ms wherever it is.
void move_kernel_threads() {
  constexpr unsigned long kKernelThread = 0x200000;  // PF_KTHREAD, field 9 of proc_pid_stat(5)
  cpu_set_t first;
  CPU_ZERO(&first);
  CPU_SET(0, &first);
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    std::string stat;
    std::getline(std::ifstream(entry.path() / "stat"), stat);
    std::istringstream fields(stat.substr(std::min(stat.size(), stat.rfind(')') + 1)));
    std::string word;
    for (int field = 3; field < 9; ++field) fields >> word;
    unsigned long flags = 0;
    if (fields >> flags && (flags & kKernelThread) != 0)
      (void)sched_setaffinity(std::stoi(entry.path().filename()), sizeof first, &first);
  }
}

/// An ordinary thread that loses its CPU to an XNode goes to the idle CPU that shares a cache with it.
void clusters() {
  constexpr int kRounds = 20;
  const std::vector<std::uint8_t> of =
      kernel::scx_clusters("", static_cast<std::size_t>(sysconf(_SC_NPROCESSORS_ONLN)));
  if (of.size() < 4) {
    ksft_test_result_skip("clusters: two clusters of two CPUs are needed\n");
    return;
  }
  const int last = static_cast<int>(of.size()) - 1;
  const auto cluster = [&](int cpu) { return cpu < 0 ? -1 : of[static_cast<std::size_t>(cpu)]; };
  pin(0);  // this thread wakes the XNode: on the idle CPU of the other's cluster it would not be idle
  move_kernel_threads();
  World world(1, last);
  world.load();
  std::atomic<bool> stop{false}, busy{false};
  std::atomic<int> where{-1}, moved_to{-1}, tid{0};  // moved_to: first, from `last`
  int lost = 0, near = 0;
  {
    Waiter waiter(world, 0, [&](const kernel::ThreadSlot&) {
      busy = true;
      burn_us(20'000);
    });
    std::thread ordinary([&] {
      tid = gettid();
      be_ordinary(last);
      while (!stop) {
        const int now = sched_getcpu();
        if (int none = -1; now != last && where == last)
          moved_to.compare_exchange_strong(none, now);
        where = now;
      }
    });
    const auto may_use = [&](int from, int to) {
      cpu_set_t set;
      CPU_ZERO(&set);
      for (int c = from; c <= to; ++c) CPU_SET(static_cast<unsigned>(c), &set);
      sched_setaffinity(tid, sizeof set, &set);
    };
    wait_for([&] { return tid != 0; });
    sleep_ms(500);  // the scheduler learns from ticks whom it may move
    for (std::uint32_t i = 0; i < kRounds; ++i) {
      may_use(last, last);
      wait_for([&] { return where == last; });
      moved_to = -1;
      may_use(0, last);
      busy = false;
      waiter.submit(0, i + 1);
      wait_for([&] { return busy && (moved_to >= 0 || waiter.done() == i + 1); });
      const int to = moved_to;
      lost += to >= 0;
      near += to >= 0 && cluster(to) == cluster(last);
      if (to >= 0 && cluster(to) != cluster(last)) ksft_print_msg("round %u: to CPU %d\n", i, to);
      wait_for([&] { return waiter.done() == i + 1; });
    }
    stop = true;
    ordinary.join();
  }
  ksft_print_msg("CPU 0 is of cluster %d, CPU %d of %d\n", cluster(0), last, cluster(last));
  ksft_test_result(
      cluster(0) != cluster(last) && lost >= kRounds / 2 && near == lost,
      "an ordinary thread that has to move stays in its cluster: %d of %d moves, %d CPUs\n", near,
      lost, last + 1);
}

// ---- crowds -------------------------------------------------------------------------------------

void crowd() {
  constexpr int kThreads = 100;
  const auto cpus = static_cast<std::uint32_t>(sysconf(_SC_NPROCESSORS_ONLN));
  World world(cpus, kCpu);
  for (std::uint32_t i = 0; i < cpus; ++i) world.rows[i].cpu = i;
  world.put_rows();
  world.load({"--timeout", "3s"});
  std::atomic<bool> stop{false};
  std::vector<std::atomic<double>> got(kThreads);
  double hogs = 0;
  const auto begin = Clock::now();
  double wall = 0;
  std::string state;
  {
    std::vector<std::thread> threads;
    for (int i = 0; i < kThreads; ++i)
      threads.emplace_back([&, i] {
        be_ordinary();
        while (!stop) got[static_cast<std::size_t>(i)] = cpu_seconds();
      });
    std::vector<std::unique_ptr<XNodeThread>> spinners;
    for (std::uint32_t i = 0; i < cpus; ++i)
      spinners.push_back(
          std::make_unique<XNodeThread>(world, i, [&](const kernel::ThreadSlot&) { spin(stop); }));
    for (auto& each : got) each = 0;
    sleep_ms(10'000);
    state = scx_state();
    wall = seconds(Clock::now() - begin);
    stop = true;
    for (auto& spinner : spinners) {
      spinner->join();
      hogs += spinner->cpu();
    }
    for (auto& thread : threads) thread.join();
  }
  const auto served =
      std::count_if(got.begin(), got.end(), [](const auto& one) { return one > 0; });
  const auto exit = kernel::scx_exit_of(world.maps.sched());
  if (exit) ksft_print_msg("%s\n", exit->c_str());
  ksft_test_result(state == "enabled",
                   "hogs on all CPUs and %d ordinary threads: 10 s, the kernel's limit is 3 s\n",
                   kThreads);
  ksft_test_result(served == kThreads && hogs > 0.5 * wall * cpus,
                   "... each of which is served, %d of them; the hogs have %.2f of %.2f s\n",
                   static_cast<int>(served), hogs, wall * cpus);
}

// One without a scheduler, then those that share one.
const Test kTests[] = {
    {"runs_elsewhere", 2, runs_elsewhere},
    {"pid_namespace", 1, pid_namespace},
    {"cpu_max", 2, cpu_max},
    {"deep_groups", 1, deep_groups},
    {"many_groups", 1, many_groups},
    {"fork_bomb", 2, fork_bomb},
    {"kernel_hog", 1, kernel_hog},
    {"nice_kernel_thread", 1, nice_kernel_thread},
    {"dumped", 1, dumped},
    {"hotplug", 3, hotplug},
    {"loaded_meanwhile", 1, loaded_meanwhile},
    {"share_of_a_crowd", 1, share_of_a_crowd},
    {"second_app", 4, second_app, true},
    {"clusters", 1, clusters},
    {"crowd", 2, crowd, true},
};

}  // namespace
}  // namespace xauto::test

int main(int argc, char** argv) {
  if (argc > 2) xauto::test::g_loads = std::max(1, atoi(argv[2]));
  if (argc > 3) xauto::test::g_bomb = std::max(1, atoi(argv[3]));
  xauto::test::run_tests(xauto::test::kTests, argc > 1 ? argv[1] : "");
}
