// SPDX-License-Identifier: Apache-2.0
// Twelve threads that are released on and on, at 85 % load of each of N CPUs, by keys: key_us is the
// period, so that the order is that of deadlines, which no priorities have. Each job writes down
// its nominal release, when it ended, and how much CPU time its thread had had; keys.awk simulates
// the rest.
//   periodic_cpu --cpus N --app-json | --platform-json | --policy-json HASH | --set
//   xauto run ... -- periodic_cpu --cpus N --log FILE
#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#include <thread>
#include <vector>

#include <sched.h>

#include <xauto/xauto.h>

namespace {

constexpr int kThreads = 12, kLoadPct = 85;

std::int64_t clock_ns(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
}

struct Task {
  int cpu = 0;
  std::int64_t period_us = 0, burn_us = 0;
  [[nodiscard]] std::int64_t wcet_us() const { return burn_us * 11 / 10; }
};

struct State {
  int done = 0;
};

struct Job {
  std::uint64_t sequence = 0;
  std::int64_t nominal_ns = 0, end_ns = 0;
  std::int64_t cpu_began_ns = 0, cpu_ended_ns = 0;  ///< CPU time of the thread
};

std::vector<Task> tasks_on(int cpus) {
  const int per_cpu = kThreads / cpus;
  const std::int64_t periods_ms[] = {8, 12, 20};
  std::vector<Task> tasks;
  for (int i = 0; i < kThreads; ++i) {
    const int j = i / cpus;
    const std::int64_t period = periods_ms[j % 3] * (j / 3 + 1) * 1000;
    tasks.push_back({i % cpus, period, period * kLoadPct / 100 / per_cpu});
  }
  return tasks;
}

std::string name(std::size_t i) {
  return "t" + std::to_string(i);
}

template <class Row>
std::string rows(const std::vector<Task>& tasks, Row row) {
  std::string text;
  for (std::size_t i = 0; i < tasks.size(); ++i)
    text += std::string(i == 0 ? "" : ",") + "\n  {\"name\": \"" + name(i) + row(i, tasks[i]) + "}";
  return text;
}

void print_app(const std::vector<Task>& tasks) {
  const auto us = [](std::int64_t v) { return std::to_string(v); };
  std::printf(
      "{\"schema\": \"xauto.app\", \"version\": 3, \"name\": \"periodic\", \"sources\": [%s],\n",
      rows(tasks, [&](std::size_t, const Task& t) {
        return "\", \"period_us\": " + us(t.period_us);
      }).c_str());
  std::printf("\"xnodes\": [%s], \"edges\": []}\n",
              rows(tasks, [&](std::size_t i, const Task& t) {
                return ".run\", \"module\": \"" + name(i) + "M\", \"source\": \"" + name(i) +
                       "\", \"wcet_us\": {\"cpu\": " + us(t.wcet_us()) + "}";
              }).c_str());
}

void print_policy(const std::vector<Task>& tasks, const char* hash) {
  const auto us = [](std::int64_t v) { return std::to_string(v); };
  std::printf(
      "{\"schema\": \"xauto.policy\", \"version\": 3, \"app\": \"periodic\", \"app_hash\": "
      "\"%s\",\n"
      "\"platform\": \"cores\", \"method\": \"deadlines\", \"solve_us\": 0, \"xnodes\": [%s],\n",
      hash, rows(tasks, [&](std::size_t, const Task& t) {
              return ".run\", \"xpu\": \"cpu" + std::to_string(t.cpu) + "\", \"key_us\": [" +
                     us(t.period_us) + "]";
            }).c_str());
  // Each is done by its next release, since no CPU is loaded by more than 100 %: Liu and Layland.
  std::printf("\"chains\": [%s]}\n",
              rows(tasks, [&](std::size_t i, const Task& t) {
                return " -> " + name(i) + ".run\", \"worst_case_us\": " + us(t.period_us) +
                       ", \"lower_bound_us\": " + us(t.wcet_us()) + ", \"optimal\": false";
              }).c_str());
}

void print_platform(int cpus) {
  std::printf("{\"schema\": \"xauto.platform\", \"version\": 1, \"name\": \"cores\", \"xpus\": [");
  for (int c = 0; c < cpus; ++c)
    std::printf("%s{\"id\": \"cpu%d\", \"type\": \"cpu\"}", c == 0 ? "" : ", ", c);
  std::puts("]}");
}

/// How late a thread is that nothing of XAuto's is above: the machine's own noise on each CPU.
class Noise {
 public:
  Noise() {
    cpu_set_t allowed;
    CPU_ZERO(&allowed);
    sched_getaffinity(0, sizeof allowed, &allowed);
    for (std::size_t c = 0; c < CPU_SETSIZE; ++c)
      if (CPU_ISSET(c, &allowed)) threads_.emplace_back([this, c] { watch(c); });
  }
  std::int64_t stop() {
    stop_ = true;
    for (std::thread& t : threads_) t.join();
    threads_.clear();
    return worst_ns_;
  }

 private:
  void watch(std::size_t cpu) {
    cpu_set_t only;
    CPU_ZERO(&only);
    CPU_SET(cpu, &only);
    sched_setaffinity(0, sizeof only, &only);
    sched_param priority{};
    priority.sched_priority = 90;
    sched_setscheduler(0, SCHED_FIFO, &priority);
    for (std::int64_t next = clock_ns(CLOCK_MONOTONIC); !stop_;) {
      next += 10'000'000;
      const timespec until{next / 1'000'000'000, next % 1'000'000'000};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
      const std::int64_t late = clock_ns(CLOCK_MONOTONIC) - next;
      for (std::int64_t worst = worst_ns_; late > worst;)
        if (worst_ns_.compare_exchange_weak(worst, late)) break;
    }
  }
  std::atomic<bool> stop_{false};
  std::atomic<std::int64_t> worst_ns_{0};
  std::vector<std::thread> threads_;
};

void write_log(const std::string& path, const std::vector<Task>& tasks,
               const std::vector<std::vector<Job>>& jobs, std::int64_t noise_ns) {
  FILE* file = std::fopen(path.c_str(), "w");
  if (file == nullptr) return;
  std::int64_t first = INT64_MAX;
  for (const auto& of : jobs)
    for (const Job& job : of) first = std::min(first, job.nominal_ns);
  std::fprintf(file, "noise %lld\n", static_cast<long long>(noise_ns));
  const auto ns = [](std::int64_t v) { return static_cast<long long>(v); };
  for (std::size_t i = 0; i < tasks.size(); ++i)
    for (const Job& job : jobs[i])
      std::fprintf(file, "job t%zu %d %llu %lld %lld %lld %lld\n", i, tasks[i].cpu,
                   static_cast<unsigned long long>(job.sequence), ns(job.nominal_ns - first),
                   ns(job.end_ns - first), ns(job.cpu_ended_ns), ns(job.cpu_began_ns));
  std::fclose(file);
}

}  // namespace

int main(int argc, char** argv) {
  int cpus = 4;
  std::string path;
  for (int i = 1; i < argc; ++i)
    if (std::strcmp(argv[i], "--cpus") == 0 && i + 1 < argc) cpus = std::atoi(argv[++i]);
  if (cpus < 1 || cpus > kThreads || kThreads % cpus != 0) {
    std::fprintf(stderr, "periodic_cpu: --cpus %d: 1, 2, 3, 4, 6 or 12\n", cpus);
    return 2;
  }
  const std::vector<Task> tasks = tasks_on(cpus);
  for (int i = 1; i < argc; ++i) {
    const std::string flag = argv[i];
    if (flag == "--app-json") return print_app(tasks), 0;
    if (flag == "--platform-json") return print_platform(cpus), 0;
    if (flag == "--policy-json" && i + 1 < argc) return print_policy(tasks, argv[i + 1]), 0;
    if (flag == "--set") {
      for (std::size_t t = 0; t < tasks.size(); ++t)
        std::printf("task t%zu %lld\n", t, static_cast<long long>(tasks[t].period_us));
      return 0;
    }
    if (flag == "--log" && i + 1 < argc) path = argv[++i];
  }
  xauto::App app("periodic");
  std::vector<std::vector<Job>> jobs(tasks.size());  // each by its execution thread
  for (std::size_t i = 0; i < tasks.size(); ++i) {
    jobs[i].reserve(1 << 16);
    const xauto::Topic<int> in(name(i)), out(name(i) + "/out");
    app.add_source(in, std::chrono::microseconds(tasks[i].period_us),
                   [](std::uint64_t k) { return static_cast<int>(k); });
    xauto::XNode<State> node(name(i) + ".run");
    node.add_impl(
        xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },
        [&log = jobs[i], burn_ns = tasks[i].burn_us * 1000](State& state,
                                                            const xauto::Input& input) {
          ++state.done;
          const std::int64_t since = clock_ns(CLOCK_THREAD_CPUTIME_ID);
          std::int64_t now = since;
          for (; now - since < burn_ns; now = clock_ns(CLOCK_THREAD_CPUTIME_ID))
            for (int spin = 0; spin < 500; ++spin) asm volatile("");
          log.push_back(
              {input.sequence(), input.origin().count(), clock_ns(CLOCK_MONOTONIC), since, now});
        });
    xauto::XModule<State> module(name(i) + "M");
    module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
    app.add_module(module);
  }
  Noise noise;
  app.on_end([&] {
    const std::int64_t worst_ns = noise.stop();
    if (!path.empty()) write_log(path, tasks, jobs, worst_ns);
  });
  const int status = app.main(1, argv);
  noise.stop();
  return status;
}
