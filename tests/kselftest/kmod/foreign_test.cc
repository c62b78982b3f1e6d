// SPDX-License-Identifier: Apache-2.0
// Work of a process that knows nothing of XAuto, on a GPU or a DLA that the machine's service hands out: suspended while a job
// has it, and whoever dies at any moment, nothing stays suspended. The service and its coordinators are the real ones.
#include <csignal>
#include <cstring>
#include <filesystem>
#include <optional>
#include <random>

#include <kselftest.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/clock.h"
#include "coord/port.h"
#include "emu/driver_queue.h"
#include "launch/system_lease.h"
#include "model/json.h"

#include "guest.h"

using xauto::Json;
using xauto::coord::Port;
using xauto::emu::DriverQueue;
using xauto::launch::SystemLease;

namespace {

constexpr const char* kSocket = "/tmp/foreign.sock";
constexpr const char* kBin = "/opt/xauto/bin/xauto-system";

std::mt19937_64 random_source(20261129);

void sleep_below_ms(int limit) {
  usleep(static_cast<useconds_t>(random_source() % static_cast<std::uint64_t>(limit * 1000)));
}

/// Killed and waited for at its end; or when this test ends before that: whoever reads what it prints waits for the
/// last one that may.
class Child {
 public:
  template <class F>
  explicit Child(F run) : pid_(fork()) {
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      run();
      _exit(0);
    }
  }
  ~Child() { end(); }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  void end(int signal = SIGKILL) {
    if (pid_ <= 0) return;
    kill(pid_, signal);
    waitpid(pid_, nullptr, 0);
    pid_ = 0;
  }
  [[nodiscard]] pid_t pid() const { return pid_; }

 private:
  pid_t pid_;
};

void serve() {
  execl(kBin, "xauto-system", "--socket", kSocket, "--suspend-foreign", nullptr);
  _exit(9);
}

xauto::Result<DriverQueue> open_queue(const std::string& hardware) {
  return hardware == "gpu0" ? DriverQueue::open_gpu()
                            : DriverQueue::open_dla(hardware.back() - '0');
}

/// A stranger, in a program of its own, which inherits no queue: one there that always has something to do.
[[noreturn]] void stranger_program(const char* hardware = "gpu0") {
  execl("/proc/self/exe", "foreign_test", hardware, nullptr);
  _exit(9);
}
[[noreturn]] void compute(const std::string& hardware) {
  auto queue = open_queue(hardware);
  if (!queue) _exit(2);
  for (;;) {
    (void)queue->submit(std::chrono::milliseconds(20));
    (void)queue->wait(1000);
  }
}

std::int64_t told(const char* what, const char* hardware = "gpu0") {
  const auto machine = xauto::launch::ask_who_is_there(kSocket);
  if (!machine) return -1;
  for (const Json& coordinator : machine->at("coordinators").elements())
    if (coordinator.at("xpu").text() == hardware)
      return coordinator.at("foreign").at(what).integer().value_or(-1);
  return -1;
}

pid_t coordinator() {
  const auto machine = xauto::launch::ask_who_is_there(kSocket);
  if (!machine || machine->at("coordinators").elements().empty()) return 0;
  return static_cast<pid_t>(
      machine->at("coordinators").elements()[0].at("pid").integer().value_or(0));
}

/// A run that has joined for one XPU.
struct Run {
  std::optional<SystemLease> lease;
  std::unique_ptr<Port> port;

  static std::optional<Run> join(const std::string& hardware = "gpu0") {
    xauto::Demand demand;
    xauto::DemandOnXpu& on = demand.xpus.emplace_back();
    on.xpu = {hardware, {}, true, 300};
    on.sequences.push_back({.period = 10'000, .jobs = {{.key = 10'000, .work = 2'000}}});
    xauto::launch::LeaseRequest request{.path = kSocket,
                                        .app = "certified",
                                        .num_xnodes = 1,
                                        .xpus = {},
                                        .demand = to_json(demand)};
    xauto::launch::JoinXpu& xpu = request.xpus.emplace_back();
    std::strcpy(xpu.id, hardware.c_str());
    std::strcpy(xpu.hardware, hardware.c_str());
    std::strcpy(xpu.type, hardware.substr(0, 3).c_str());
    xpu.instance = hardware.back() - '0';
    xpu.preempt_us = 300;
    Run run;
    auto lease = SystemLease::ask(request);
    if (!lease) {
      ksft_print_msg("%s\n", lease.error().to_string().c_str());
      return std::nullopt;
    }
    run.lease.emplace(std::move(*lease));
    auto port = Port::connect(run.lease->address(hardware), "worker", {0}, {});
    if (!port) {
      ksft_print_msg("%s\n", port.error().to_string().c_str());
      return std::nullopt;
    }
    run.port = std::move(*port);
    return run;
  }
  void start(std::uint64_t sequence) const {
    port->start({.xnode = 0, .sequence = sequence, .key = xauto::now_ns() + 10'000'000});
  }
};

/// However long this machine stands still.
bool eventually(const std::function<bool()>& condition) {
  return guest::eventually(condition, 60'000);
}

bool nothing_suspended() {
  return eventually([] { return guest::suspended() == 0; });
}

void keeps_off() {
  const Child service(serve), stranger([] { stranger_program(); });
  if (!eventually([] { return std::filesystem::exists(kSocket); }))
    ksft_exit_fail_msg("no service\n");
  auto run = Run::join();
  if (!run) ksft_exit_fail_msg("not admitted\n");
  const bool found = eventually([] { return told("queues") == 1; });
  ksft_test_result(found, "a stranger's queue is found: %lld\n",
                   static_cast<long long>(told("queues")));
  if (!found) ksft_finished();  // what follows would wait for each suspension
  auto own = DriverQueue::open_gpu();
  guest::sleep_ms(600);  // two looks: it is none of theirs
  int late = 0, stays = 0;
  for (std::uint64_t n = 1; n <= 200; ++n) {
    run->start(n);
    late += !eventually([] { return guest::suspended() == 1; });
    run->port->finish();
    stays += !nothing_suspended();
  }
  ksft_test_result(
      late == 0 && stays == 0,
      "it is off the GPU while a job has it, and on it after: 200 jobs, %d not off, %d "
      "left off\n",
      late, stays);
  ksft_test_result(
      told("queues") == 1 && told("not_kept_off") == 0 && told("suspensions") >= 200,
      "the run's own queue is none of it, and nothing ran beside a job: %lld suspensions, "
      "%lld not\n",
      static_cast<long long>(told("suspensions")), static_cast<long long>(told("not_kept_off")));
  // One that begins while a job has the GPU may have run unseen.
  run->start(1000);
  Child late_comer([] { stranger_program(); });
  const bool seen = eventually([] { return guest::suspended() == 2; });
  ksft_test_result(seen && told("not_kept_off") == 1,
                   "one that comes beside a job is suspended, and counted: %lld\n",
                   static_cast<long long>(told("not_kept_off")));
  guest::gpu_fault("fail_preempt", 1000);
  run->port->finish();
  (void)nothing_suspended();
  run->start(1001);  // nobody waits for what does not leave
  ksft_test_result(eventually([] { return told("not_kept_off") > 1; }),
                   "what cannot be suspended is counted, and no job waits for it\n");
  guest::gpu_fault("fail_preempt", 0);
  run->port->finish();
  late_comer.end();
  ksft_test_result(eventually([] { return told("queues") == 1; }) && nothing_suspended(),
                   "one that goes is forgotten\n");
}

/// A DLA's queue is told by its instance; the other DLA is nobody's business.
void keeps_off_one_dla() {
  std::filesystem::remove(kSocket);
  const Child service(serve), stranger([] { stranger_program("dla1"); }),
      elsewhere([] { stranger_program("dla0"); });
  (void)eventually([] { return std::filesystem::exists(kSocket); });
  auto run = Run::join("dla1");
  if (!run) ksft_exit_fail_msg("not admitted\n");
  const bool found = eventually([] { return told("queues", "dla1") == 1; });
  const auto both = [] { return guest::count(guest::dla_state(), "queue="); };
  ksft_test_result(found && eventually([&] { return both() == 2; }),
                   "a stranger's queue is found on its DLA: %lld, of %d\n",
                   static_cast<long long>(told("queues", "dla1")), both());
  int late = 0, stays = 0, wrong = 0;
  for (std::uint64_t n = 1; found && n <= 50; ++n) {
    run->start(n);
    late += !eventually([] { return guest::suspended() == 1; });
    wrong += guest::suspended_on_dla(0);
    run->port->finish();
    stays += !nothing_suspended();
  }
  ksft_test_result(
      found && late == 0 && stays == 0 && wrong == 0 && told("not_kept_off", "dla1") == 0,
      "it is off that DLA while a job has it: 50 jobs, %d not off, %d left off, %d on the other "
      "one\n",
      late, stays, wrong);
}

enum class Victim { kService, kCoordinator, kRun, kStranger };

void run_and_be_killed() {
  std::optional<Run> run;
  (void)eventually([&] { return (run = Run::join()).has_value(); });  // once it listens
  if (!run) _exit(3);
  for (std::uint64_t n = 1;; ++n) {
    run->start(n);
    usleep(3000);
    run->port->finish();
    usleep(1000);
  }
}

void killed(const char* name, Victim victim, int times) {
  int stuck = 0, idle = 0, lost = 0;
  for (int i = 0; i < times; ++i) {
    std::filesystem::remove(kSocket);
    Child service(serve), stranger([] { stranger_program(); });
    (void)eventually([] { return std::filesystem::exists(kSocket); });
    Child run(run_and_be_killed);
    idle += !eventually([] { return told("suspensions") > 0; });
    sleep_below_ms(30);
    if (victim == Victim::kService) service.end();
    if (victim == Victim::kRun) run.end();
    if (victim == Victim::kStranger) stranger.end();
    if (const pid_t pid = coordinator(); victim == Victim::kCoordinator && pid > 0) {
      kill(pid, SIGKILL);
      // The next one has them again: the run goes on, and the stranger is suspended again.
      const std::int64_t before = told("suspensions");
      lost += !eventually([&] { return told("suspensions") > before + 3; });
      run.end();
    }
    stuck += !nothing_suspended();
  }
  ksft_test_result(stuck == 0 && idle == 0 && lost == 0,
                   "%s killed: %d times, %d left something suspended; %d suspended nothing, %d not "
                   "again\n",
                   name, times, stuck, idle, lost);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 1) compute(argv[1]);
  const char* scale = getenv("XAUTO_KILLS");
  const int kills = scale != nullptr ? atoi(scale) / 5 : 6;
  setlinebuf(stdout);
  ksft_print_header();
  if (access(kBin, X_OK) != 0) ksft_exit_skip("no xauto-system here\n");
  ksft_set_plan(12);
  keeps_off();
  keeps_off_one_dla();
  killed("the service", Victim::kService, kills);
  killed("the coordinator", Victim::kCoordinator, kills);
  killed("the run", Victim::kRun, kills);
  killed("the stranger", Victim::kStranger, kills);
  ksft_finished();
}
