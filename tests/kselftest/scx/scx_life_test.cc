// SPDX-License-Identifier: Apache-2.0
// The scheduler's coming and going: tables replaced under load, the loader killed at any moment,
// and everything that makes the kernel refuse it. KTAP; run as root.
//   scx_life_test [NAME [KILLS [TABLES]]]
#include <cstdlib>
#include <fstream>
#include <random>

#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/clock.h"
#include "kernel/pid_namespace.h"

#include "tests.h"

namespace xauto::test {
namespace {

constexpr int kCpu = 1;
int g_kills = 200, g_tables = 10'000;

// Table v gives every XNode the key 1000 + v % 5000 + its number and a budget of v seconds, so
// that an entry put together from two tables shows. What the scheduler goes by is in jobs[],
// written once per job before it runs.
void tables() {
  constexpr std::uint32_t kXNodes = 8;
  World& world = loaded_world();
  const auto key_of = [](std::uint64_t version, std::uint32_t xnode) {
    return static_cast<std::int64_t>(1000 + version % 5000 + xnode);
  };
  const auto put = [&] {
    const std::uint64_t next = world.maps.version() + 1;
    for (std::uint32_t x = 0; x < kXNodes; ++x)
      world.rows[x] = {static_cast<std::uint32_t>(next % 2), key_of(next, x),
                       static_cast<std::int64_t>(next) * 1'000'000};
    world.put_rows();
  };
  put();
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> jobs{0}, mixed{0}, seen{0};
  {
    std::vector<std::unique_ptr<XNodeThread>> threads;
    for (std::uint32_t t = 0; t < 4; ++t)
      threads.push_back(
          std::make_unique<XNodeThread>(world, t, [&, t](const kernel::ThreadSlot& slot) {
            const auto at = static_cast<std::size_t>(world.slots.index(slot));
            const volatile xauto_bpf_job& job = world.maps.jobs()[at];
            std::uint64_t last = 0;
            for (std::uint64_t n = 1; !stop; ++n) {
              const std::uint32_t xnode = (t + static_cast<std::uint32_t>(n)) % kXNodes;
              if (slot.tell(xnode, n)) sched_yield();
              usleep(200);  // woken: the scheduler has the job now
              if (job.job != XAUTO_BPF_JOB(xnode, n)) continue;
              const std::uint64_t version = job.version;
              const bool whole = job.key == key_of(version, xnode) && job.cpu == version % 2 &&
                                 job.budget_ns == version * 1'000'000'000ull;
              mixed += whole ? 0 : 1;
              seen += version != last ? 1 : 0;
              last = version;
              ++jobs;
            }
          }));
    std::mt19937 random(3);
    // On and on until enough jobs have met one, however slow the emulator is.
    const auto enough = [&] { return jobs > 500 && seen > 100; };
    for (int i = 0; i < g_tables || (!enough() && i < 20 * g_tables); ++i) {
      put();
      if (random() % 8 == 0) usleep(100);
      // In the emulator, threads make slow progress: give each 100th table some time.
      if (i % 100 == 0) usleep(3000);
    }
    stop = true;
  }
  ksft_test_result(
      mixed == 0 && jobs > 500 && seen > 100,
      "at least %d tables under load: of %llu jobs, which went by %llu tables, %llu mixed two\n",
      g_tables, static_cast<unsigned long long>(jobs.load()),
      static_cast<unsigned long long>(seen.load()), static_cast<unsigned long long>(mixed.load()));
  ksft_print_msg("entries copied again because a replacement came between: %llu\n",
                 static_cast<unsigned long long>(world.stat(XAUTO_BPF_STAT_TORN)));
}

void killed_loader() {
  World world(4, kCpu);
  std::mt19937 random(11);
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> progress[4] = {};
  int not_disabled = 0, stuck = 0, enabled = 0;
  const auto begin = Clock::now();
  world.load();
  // From before its first system call until well after it is enabled, whatever that takes here.
  const auto span_us = static_cast<std::uint32_t>(1e6 * seconds(Clock::now() - begin));
  world.unload();
  {
    std::vector<std::unique_ptr<XNodeThread>> threads;
    for (std::uint32_t t = 0; t < 4; ++t)
      threads.push_back(
          std::make_unique<XNodeThread>(world, t, [&, t](const kernel::ThreadSlot& slot) {
            for (std::uint64_t n = 0; !stop; ++n) {
              if (slot.tell(t, n)) sched_yield();
              burn_us(100);
              ++progress[t];
              usleep(2000 * (t + 1));
            }
          }));
    for (int i = 0; i < g_kills; ++i) {
      const pid_t child = fork();
      if (child == 0) {
        sched_param none{};
        sched_setscheduler(0, SCHED_OTHER, &none);
        pin(0);
        const int null = open("/dev/null", O_WRONLY);
        dup2(null, 1);
        dup2(null, 2);
        execl((program_folder() + "/xauto-cpusched").c_str(), "xauto-cpusched", "--run",
              world.maps.run().c_str(), "--cpus", "1", nullptr);
        _exit(127);
      }
      // Every other time somewhere in the loading, else some time after it.
      if (i % 2 == 0) wait_for([] { return scx_state() == "enabled"; }, 20);
      usleep(static_cast<useconds_t>(random() % (i % 2 == 0 ? 100'000 : span_us)));
      enabled += scx_state() == "enabled" ? 1 : 0;
      kill(child, SIGKILL);
      waitpid(child, nullptr, 0);
      if (!wait_for([] { return scx_state() == "disabled"; }, 5)) ++not_disabled;
      std::uint64_t before[4];
      for (int t = 0; t < 4; ++t) before[t] = progress[t];
      if (!wait_for(
              [&] {
                for (int t = 0; t < 4; ++t)
                  if (progress[t] <= before[t]) return false;
                return true;
              },
              5))
        ++stuck;
      if (i % 25 == 24)
        ksft_print_msg("%d kills, %d while enabled; not disabled %d, threads stuck %d\n", i + 1,
                       enabled, not_disabled, stuck);
    }
    stop = true;
  }
  ksft_test_result(
      not_disabled == 0 && stuck == 0 && enabled >= g_kills * 4 / 10,
      "the loader killed at %d random moments (%d times while enabled): state disabled, all "
      "threads go on (%d, %d times not)\n",
      g_kills, enabled, not_disabled, stuck);
  world.load();
  ksft_test_result(scx_state() == "enabled", "... and it loads again\n");
}

// ---- what is wrong: with what user space wrote we live, with what cannot be we end --------------

void wrong_slot() {
  World& world = loaded_world();
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> rounds{0};
  std::thread stray([&] {
    const std::uint64_t key = std::uint64_t{kernel::own_pid_namespace().value()} << 32 |
                              static_cast<std::uint64_t>(gettid());
    const std::uint64_t nowhere[2] = {4711, static_cast<std::uint64_t>(now_ns())};
    if (!kernel::set_element(world.maps.fd("threads"), &key, nowhere))
      ksft_exit_fail_msg("entering\n");
    while (!stop) {
      usleep(1000);
      ++rounds;
    }
    kernel::remove_element(world.maps.fd("threads"), &key);
  });
  const bool ran = wait_for([&] { return rounds > 100; });
  const std::uint64_t looks = world.stat(XAUTO_BPF_STAT_NO_SLOT);
  const std::string state = scx_state();
  stop = true;
  stray.join();
  ksft_test_result(
      ran && state == "enabled" && looks > 100,
      "a thread with a slot that there is not is an ordinary one, and counted: %llu looks\n",
      static_cast<unsigned long long>(looks));
}

void impossible_maps() {
  World world(1, kCpu, 16), smaller(1, kCpu, 1);
  // Slots 1 to 15 have no job: the loader never makes such maps.
  unlink((kernel::RunMaps::folder(world.maps.run()) + "/jobs").c_str());
  if (!world.maps.pin(smaller.maps.fd("jobs"), "jobs")) ksft_exit_fail_msg("pinning\n");
  const_cast<xauto_bpf_head&>(world.maps.head()).slots = 1;
  world.load();
  {
    const auto sleeps = [](const kernel::ThreadSlot&) { usleep(10'000); };
    XNodeThread good(world, 0, sleeps);
    ksft_test_result(scx_state() == "enabled" && good.index() == 0,
                     "a thread whose slot has a job is fine\n");
    XNodeThread bad(world, 0, sleeps);
  }
  const bool ended = wait_for([&] { return kernel::scx_exit_of(world.maps.sched()).has_value(); });
  const std::string why = kernel::scx_exit_of(world.maps.sched()).value_or("nothing");
  ksft_print_msg("%s\n", why.c_str());
  ksft_test_result(ended && why.find("slot 1 has no job") != std::string::npos,
                   "one whose slot has none cannot be: the scheduler ends and says why\n");
  ksft_test_result(wait_for([] { return scx_state() == "disabled"; }),
                   "... and the kernel is back at its own\n");
  wait_for([&] { return kernel::kept_scx_dump("", world.maps.run()).has_value(); });
  const auto kept = kernel::kept_scx_dump("", world.maps.run());
  std::string dump;
  if (kept) std::getline(std::ifstream(kept->path), dump, '\0');
  ksft_test_result(kept && kept->about.find("slot 1 has no job") != std::string::npos &&
                       dump.find("xauto: mode 1, ") != std::string::npos &&
                       dump.size() < XAUTO_BPF_DUMP + 512,
                   "... whose dump is kept, %zu bytes, with our lines in it\n", dump.size());
}

// ---- refusals: one clear line each, and nothing left behind -------------------------------------

bool refused(const Result<kernel::ScxProcess>& result, const char* expected) {
  if (result) {
    ksft_print_msg("it was not refused\n");
    return false;
  }
  const std::string& what = result.error().what;
  ksft_print_msg("%s\n", what.c_str());
  return what.find(expected) != std::string::npos && what.find('\n') == std::string::npos;
}

void another_scheduler() {
  (void)loaded_world();
  World second(1, kCpu);
  ksft_test_result(refused(second.try_load(), "another sched_ext scheduler is loaded: 'xauto"),
                   "with another scheduler loaded\n");
  ksft_test_result(scx_state() == "enabled", "... which stays\n");
}

void wrong_layout() {
  World good(1, kCpu), other(1, kCpu);
  const std::string table = kernel::RunMaps::folder(good.maps.run()) + "/table";
  unlink(table.c_str());
  // A map of another size under the name of ours.
  if (!good.maps.pin(other.maps.fd("slots"), "table")) ksft_exit_fail_msg("pinning\n");
  ksft_test_result(refused(good.try_load(), "map 'table' has keys of 4 and values of 128 bytes"),
                   "with maps of another layout\n");
  auto& head = const_cast<xauto_bpf_head&>(other.maps.head());
  head.abi = 99;
  ksft_test_result(refused(other.try_load(), "maps of layout 99"),
                   "with maps of another version\n");
  head.abi = 0;
  ksft_test_result(refused(other.try_load(), "the run is just starting"),
                   "with maps that are being made\n");
  head.abi = XAUTO_BPF_ABI;
}

void without_btf() {
  World world(1, kCpu);
  mkdir("/tmp/empty", 0755);
  if (mount("/tmp/empty", "/sys/kernel/btf", nullptr, MS_BIND, nullptr) != 0)
    ksft_exit_fail_msg("mount\n");
  const bool told = refused(world.try_load(), "this kernel has no BTF");
  umount("/sys/kernel/btf");
  ksft_test_result(told, "without BTF\n");
}

void without_privilege() {
  World world(1, kCpu);
  chmod("/", 0755);  // of the initramfs
  // The folder is root's: whoever may not read it has no right to schedule either.
  int ends[2];
  if (pipe(ends) != 0) ksft_exit_fail_msg("pipe\n");
  const pid_t child = fork();
  if (child == 0) {
    if (setgid(1000) != 0 || setuid(1000) != 0) _exit(3);
    auto result = world.try_load();
    const std::string text = result ? "loaded" : result.error().what;
    (void)!write(ends[1], text.data(), text.size());
    _exit(0);
  }
  close(ends[1]);
  char text[512] = {};
  (void)!read(ends[0], text, sizeof text - 1);
  close(ends[0]);
  waitpid(child, nullptr, 0);
  ksft_print_msg("%s\n", text);
  ksft_test_result(
      strstr(text, "Permission denied") != nullptr || strstr(text, "not permitted") != nullptr,
      "without privilege\n");
  ksft_test_result(scx_state() == "disabled", "... and after all refusals nothing is loaded\n");
}

void without_table() {
  World world(1, kCpu);
  auto empty = kernel::RunMaps::create(std::to_string(getpid()) + "-empty", 2, 4);
  if (!empty) ksft_exit_fail_msg("maps\n");
  auto loaded = kernel::start_scx(program_folder(), empty->run(), {kCpu});
  ksft_test_result(loaded && scx_state() == "enabled",
                   "without a table yet: XNodes are ordinary threads\n");
}

void isolated_mode() {
  const kernel::ScxChoice choice = kernel::choose_scx_mode("", {.cpus = {kCpu}});
  World world(2, kCpu);
  world.load({"--mode", "partial"});
  std::atomic<bool> stop{false};
  const auto body = [&](const kernel::ThreadSlot&) { spin(stop); };
  {
    XNodeThread low(world, 0, body, true), high(world, 1, body, true);
    usleep(1'000'000);
    stop = true;
    low.join();
    high.join();
    ksft_test_result(high.cpu() > 0.7 && low.cpu() < 0.2,
                     "partial mode orders SCHED_EXT threads: %.2f and %.2f s of 1.0\n", high.cpu(),
                     low.cpu());
  }
  ksft_test_result(!choice.partial, "on CPUs that are not isolated full mode is chosen: %s\n",
                   choice.why.c_str());
}

// Those that share a scheduler first.
const Test kTests[] = {
    {"tables", 1, tables},
    {"wrong_slot", 1, wrong_slot},
    {"another_scheduler", 2, another_scheduler},
    {"killed_loader", 2, killed_loader},
    {"impossible_maps", 4, impossible_maps},
    {"wrong_layout", 3, wrong_layout},
    {"without_btf", 1, without_btf},
    {"without_privilege", 2, without_privilege},
    {"without_table", 1, without_table},
    {"isolated_mode", 2, isolated_mode},
};

}  // namespace
}  // namespace xauto::test

int main(int argc, char** argv) {
  using namespace xauto::test;
  const char* wanted = argc > 1 ? argv[1] : "";
  if (argc > 2) g_kills = std::max(1, atoi(argv[2]));
  if (argc > 3) g_tables = std::max(1, atoi(argv[3]));
  run_tests(kTests, wanted);
}
