// SPDX-License-Identifier: Apache-2.0
#include "world.h"

#include <cstdlib>
#include <ctime>
#include <fstream>

#include <kselftest.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/process.h"
#include "coord/rule.h"

namespace xauto::test {
namespace {

template <class T>
T must(Result<T> result, const char* what) {
  if (!result) ksft_exit_fail_msg("%s: %s\n", what, result.error().to_string().c_str());
  return std::move(*result);
}

std::optional<World> g_loaded;
std::vector<std::string> g_arguments;  // it was loaded with

std::string next_run() {
  static int number = 0;
  return std::to_string(getpid()) + "-" + std::to_string(number++);
}

}  // namespace

std::string slurp(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

bool full() {
  return getenv("XAUTO_FULL") != nullptr;
}

double cpu_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

void pin(int cpu) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<unsigned>(cpu), &set);
  sched_setaffinity(0, sizeof set, &set);
}

void burn_us(std::int64_t us) {
  const double until = cpu_seconds() + static_cast<double>(us) * 1e-6;
  while (cpu_seconds() < until)
    for (int i = 0; i < 200; ++i) asm volatile("");
}

bool wait_for(const std::function<bool()>& done, double limit_s) {
  const auto limit = Clock::now() + std::chrono::duration<double>(limit_s);
  while (!done()) {
    if (Clock::now() > limit) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

World::World(std::uint32_t xnodes, int on_cpu, std::uint32_t slot_count)
    : maps(must(kernel::RunMaps::create(next_run(), xnodes, slot_count), "making the maps")),
      slots(must(kernel::ThreadSlots::attach(UniqueFd(dup(maps.fd("slots"))),
                                             UniqueFd(dup(maps.fd("threads")))),
                 "mapping the slots")),
      cpu(on_cpu) {
  rows.resize(xnodes);
  renew();
}

void World::renew() {
  for (std::uint32_t i = 0; i < rows.size(); ++i)
    rows[i] = {static_cast<std::uint32_t>(cpu), coord::key_of_priority(10 * (i + 1)), 0};
  put_rows();
  before_ = must(maps.counts(), "counts");
}

void World::put_rows() {
  if (auto status = maps.replace_table(rows); !status)
    ksft_exit_fail_msg("table: %s\n", status.error().to_string().c_str());
}

Result<kernel::ScxProcess> World::try_load(const std::vector<std::string>& arguments) const {
  return kernel::start_scx(program_folder(), maps.run(), {cpu}, arguments);
}

void World::load(const std::vector<std::string>& arguments) {
  if (g_loaded && this != &*g_loaded) end_loaded_world();
  loader = must(try_load(arguments), "loading the scheduler");
}

void World::unload() {
  loader.reset();
  if (!wait_for([] { return scx_state() == "disabled"; }))
    ksft_exit_fail_msg("the scheduler is still there: %s\n", scx_state().c_str());
}

std::uint64_t World::stat(int which) const {
  return must(maps.counts(), "counts").stats[which] - before_.stats[which];
}

World& loaded_world(const std::vector<std::string>& arguments) {
  if (g_loaded && g_arguments == arguments) {
    g_loaded->renew();
  } else {
    end_loaded_world();
    g_loaded.emplace(16U, 1);
    g_loaded->load(arguments);
    g_arguments = arguments;
  }
  return *g_loaded;
}

void end_loaded_world() {
  if (g_loaded) g_loaded->unload();
  g_loaded.reset();
}

XNodeThread::XNodeThread(World& world, std::uint32_t xnode,
                         std::function<void(const kernel::ThreadSlot&)> body, bool ext)
    : slot_(world.slots.take(0)), index_(static_cast<std::uint32_t>(world.slots.index(slot_))) {
  std::atomic<bool> entered{false};
  thread_ = std::thread([&world, &entered, slot = slot_, xnode, ext, body = std::move(body), this] {
    if (ext) {
      sched_param none{};
      if (syscall(SYS_sched_setscheduler, 0, SCHED_EXT, &none) != 0)
        ksft_exit_fail_msg("SCHED_EXT refused\n");
    }
    cpu_set_t all;  // the controller's affinity is not theirs: the table says where they run
    CPU_ZERO(&all);
    for (unsigned c = 0; c < 64; ++c) CPU_SET(c, &all);
    sched_setaffinity(0, sizeof all, &all);
    if (auto status = world.slots.enter(slot); !status)
      ksft_exit_fail_msg("entering: %s\n", status.error().to_string().c_str());
    (void)slot.tell(xnode, 0);
    usleep(1000);  // woken by its job, on its CPU
    entered = true;
    const double begin = cpu_seconds();
    body(slot);
    cpu_s_ = cpu_seconds() - begin;
    world.slots.leave(slot);
  });
  // Sleeping: the controller is real-time, and the new thread begins on its CPU.
  if (!wait_for([&] { return entered.load(); })) ksft_exit_fail_msg("a thread did not begin\n");
}

void XNodeThread::join() {
  if (thread_.joinable()) thread_.join();
}

void become_controller() {
  pin(0);
  sched_param priority{};
  priority.sched_priority = 50;
  if (sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &priority) != 0)
    ksft_exit_fail_msg("the test needs SCHED_FIFO\n");
}

std::string scx_state() {
  return slurp("/sys/kernel/sched_ext/state");
}

std::string program_folder() {
  return program_directory();
}

}  // namespace xauto::test
