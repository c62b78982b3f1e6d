// SPDX-License-Identifier: Apache-2.0
// What it costs to suspend a CUDA context through NVIDIA's RM driver (backend `rm`, docs/backends.md), whether it
// holds, and which of CUDA's calls wait for a context that is suspended. run.sh builds it and starts it with
// libxauto_watch.so. A PART is a process of its own: what hangs ends there.
//
//   suspend KERNELS.ptx PART [KIND BLOCKS]
//
//     costs KIND BLOCKS  compute, stream, poll or idle: 300 suspensions of 2 ms, at instants that drift
//     beside             a job of 3 ms, alone, beside another context, and with that one suspended
//     lasting            suspended for 5 s
//     calls              CUDA's calls in a suspended context, and in another one
//     hang               suspended until it is killed
//     once               a context, and a job
//     load               computes until it is killed
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <future>
#include <iterator>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <unistd.h>

#include <xauto/cuda.h>

#include "kernel/rm_queues.h"

namespace {

using namespace std::chrono_literals;
using xauto::cuda::Context;
using xauto::kernel::QueueFile;
using xauto::kernel::RmQueues;
using Clock = std::chrono::steady_clock;

constexpr int kTimes = 300, kThreads = 256;

[[noreturn]] void give_up(const std::string& why) {
  std::printf("failed: %s\n", why.c_str());
  std::exit(1);
}
void must(const xauto::Status& done) {
  if (!done) give_up(done.error().to_string());
}
void must(CUresult done, const char* call) {
  must(xauto::cuda::checked(done, call));
}

double us(Clock::duration time) {
  return std::chrono::duration<double, std::micro>(time).count();
}
double since_us(Clock::time_point begin) {
  return us(Clock::now() - begin);
}

void tell(const char* what, std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const auto at = [&](double q) {
    return values[static_cast<std::size_t>(q * double(values.size() - 1))];
  };
  std::printf("  %-28s n %3zu   min %8.1f   p50 %8.1f   p99 %8.1f   max %8.1f us\n", what,
              values.size(), values.front(), at(0.5), at(0.99), values.back());
}

/// A context of its own, with what runs in it and what RM has for it.
class Gpu {
 public:
  explicit Gpu(const std::string& ptx) {
    const std::vector<QueueFile> before = xauto::kernel::find_rm_groups();
    auto made = Context::create(0);
    if (!made) give_up(made.error().to_string());
    context_ = std::move(made.value());
    const Context::Scope scope(*context_);
    must(cuModuleLoadData(&module_, ptx.c_str()), "cuModuleLoadData");
    must(cuMemAlloc(&buffer_, 1u << 28), "cuMemAlloc");
    void* host = nullptr;
    must(cuMemHostAlloc(&host, 4096, CU_MEMHOSTALLOC_DEVICEMAP), "cuMemHostAlloc");
    std::memset(host, 0, 4096);
    must(cuMemHostGetDevicePointer(&shared_, host, 0), "cuMemHostGetDevicePointer");
    counter_ = static_cast<std::atomic<unsigned long long>*>(host);
    stop_ = reinterpret_cast<std::atomic<int>*>(static_cast<char*>(host) + kStopAt);
    (void)job_us(1000);  // the first one opens more
    for (const QueueFile& group : xauto::kernel::find_rm_groups())
      if (std::find(before.begin(), before.end(), group) == before.end())
        if (auto taken = queues_.take(group)) groups_.push_back(taken.value());
    if (groups_.empty()) give_up("libxauto_watch.so has seen no channel group");
  }

  /// Runs until `end`; returns once it runs.
  void begin(const std::string& kind, unsigned blocks = 264) {
    const Context::Scope scope(*context_);
    stop_->store(0);
    const unsigned long long before = counter_->load();
    launch("reset", 1, 1, nullptr);
    CUdeviceptr stop = shared_ + kStopAt;
    void* arguments[] = {&shared_, &stop, &buffer_};
    launch(kind.c_str(), blocks, kThreads, arguments);
    while (counter_->load() < before + 100) {
    }
  }
  void end() {
    stop_->store(1);
    must(context_->synchronize());
  }
  double job_us(unsigned long long iterations) {
    const Context::Scope scope(*context_);
    void* arguments[] = {&iterations, &buffer_};
    const Clock::time_point begin = Clock::now();
    launch("work", 264, kThreads, arguments);
    must(context_->synchronize());
    return since_us(begin);
  }
  void launch(const char* kernel, unsigned blocks, unsigned threads, void** arguments) {
    CUfunction function = nullptr;
    must(cuModuleGetFunction(&function, module_, kernel), kernel);
    must(cuLaunchKernel(function, blocks, 1, 1, threads, 1, 1, 0, context_->stream(), arguments,
                        nullptr),
         kernel);
  }

  void suspend() { must(queues_.suspend(groups_)); }
  void resume() { must(queues_.resume(groups_)); }
  void again() { queues_.again(); }
  [[nodiscard]] unsigned long long count() const { return counter_->load(); }
  [[nodiscard]] const Context& context() const { return *context_; }
  [[nodiscard]] std::size_t num_groups() const { return groups_.size(); }

 private:
  static constexpr int kStopAt = 64;
  std::unique_ptr<Context> context_;
  CUmodule module_ = nullptr;
  CUdeviceptr buffer_ = 0, shared_ = 0;
  std::atomic<unsigned long long>* counter_ = nullptr;
  std::atomic<int>* stop_ = nullptr;
  RmQueues queues_;
  std::vector<RmQueues::Handle> groups_;
};

void drift(int i) {
  std::this_thread::sleep_for(std::chrono::microseconds(1000 + i * 7919 % 1777));
}

void costs(const std::string& ptx, const std::string& kind, unsigned blocks) {
  Gpu gpu(ptx);
  const bool idle = kind == "idle";
  if (!idle) gpu.begin(kind, blocks);
  std::vector<double> suspend, resume, runs;
  unsigned long long while_suspended = 0;
  const int times = kind == "poll" ? kTimes / 5 : kTimes;  // each takes tens of ms
  for (int i = 0; i < times; ++i) {
    Clock::time_point begin = Clock::now();
    gpu.suspend();
    suspend.push_back(since_us(begin));
    const unsigned long long count = gpu.count();
    std::this_thread::sleep_for(2ms);
    while_suspended += gpu.count() - count;
    begin = Clock::now();
    gpu.resume();
    resume.push_back(since_us(begin));
    while (!idle && gpu.count() == count) {
    }
    runs.push_back(since_us(begin));
    drift(i);
  }
  std::printf("%s, %u blocks of %d threads; %zu channel groups\n", kind.c_str(), blocks, kThreads,
              gpu.num_groups());
  tell("suspend", suspend);
  tell("resume", resume);
  if (idle) return;
  tell("from resume until it counts", runs);
  std::printf("  counted while suspended: %llu\n", while_suspended);
  gpu.end();
}

void beside(const std::string& ptx) {
  Gpu other(ptx), gpu(ptx);
  (void)gpu.job_us(100'000);
  const auto iterations = static_cast<unsigned long long>(100'000 * 3000 / gpu.job_us(100'000));
  std::vector<double> alone, shared, suspended, whole;
  for (int i = 0; i < 100; ++i) alone.push_back(gpu.job_us(iterations));
  other.begin("compute");
  for (int i = 0; i < 100; ++i) shared.push_back(gpu.job_us(iterations));
  for (int i = 0; i < 100; ++i) {
    drift(i);
    const Clock::time_point begin = Clock::now();
    other.suspend();
    suspended.push_back(gpu.job_us(iterations));
    whole.push_back(since_us(begin));
    other.resume();
  }
  other.end();
  std::printf("a job of 3 ms\n");
  tell("alone", alone);
  tell("beside another context", shared);
  tell("with that one suspended", suspended);
  tell("... and the suspension", whole);
}

void lasting(const std::string& ptx) {
  Gpu gpu(ptx);
  gpu.begin("compute");
  gpu.suspend();
  const unsigned long long count = gpu.count();
  for (int i = 0; i < 100; ++i) {
    std::this_thread::sleep_for(50ms);
    gpu.again();
  }
  std::printf("suspended for 5 s: counted %llu in it", gpu.count() - count);
  gpu.resume();
  std::this_thread::sleep_for(20ms);
  std::printf(", goes on after it: %s\n", gpu.count() > count ? "yes" : "no");
  gpu.end();
}

/// In `gpu`'s context while `suspended` is. A call that waits is let go on.
void call(Gpu& suspended, Gpu& gpu, const char* name, const std::function<void(Gpu&)>& what) {
  suspended.begin("compute");
  suspended.suspend();
  const Clock::time_point begin = Clock::now();
  auto done = std::async(std::launch::async, [&] {
    const Context::Scope scope(gpu.context());
    what(gpu);
  });
  const bool waits = done.wait_for(500ms) != std::future_status::ready;
  const double took = since_us(begin);
  suspended.resume();
  const bool goes_on = waits && done.wait_for(500ms) == std::future_status::ready;
  suspended.end();
  done.wait();
  if (waits)
    std::printf("  %-32s waits, %s\n", name,
                goes_on ? "until the context is resumed" : "until the context's kernel has ended");
  else
    std::printf("  %-32s %.0f us\n", name, took);
}

void calls(const std::string& ptx) {
  Gpu a(ptx), b(ptx);
  static char bytes[1 << 20];
  const auto memory = [] {
    CUdeviceptr p = 0;
    must(cuMemAlloc(&p, sizeof bytes), "cuMemAlloc");
    return p;
  };
  for (Gpu* gpu : {&a, &b}) {
    std::printf("%s\n", gpu == &a ? "in the context that is suspended"
                                  : "in another context of the process");
    call(a, *gpu, "cuMemAlloc", [&](Gpu&) { (void)memory(); });
    call(a, *gpu, "cuMemFree", [&](Gpu&) { must(cuMemFree(memory()), "cuMemFree"); });
    call(a, *gpu, "cuMemHostAlloc", [](Gpu&) {
      void* p = nullptr;
      must(cuMemHostAlloc(&p, sizeof bytes, 0), "cuMemHostAlloc");
    });
    call(a, *gpu, "cuMemcpyHtoDAsync", [&](Gpu& in) {
      must(cuMemcpyHtoDAsync(memory(), bytes, sizeof bytes, in.context().stream()),
           "cuMemcpyHtoDAsync");
    });
    call(a, *gpu, "cuModuleLoadData", [&](Gpu&) {
      CUmodule module = nullptr;
      must(cuModuleLoadData(&module, ptx.c_str()), "cuModuleLoadData");
    });
    call(a, *gpu, "cuStreamCreate", [](Gpu&) {
      CUstream stream = nullptr;
      must(cuStreamCreate(&stream, CU_STREAM_NON_BLOCKING), "cuStreamCreate");
    });
    call(a, *gpu, "cuLaunchKernel", [](Gpu& in) { in.launch("reset", 1, 1, nullptr); });
    call(a, *gpu, "cuStreamSynchronize", [](Gpu& in) { must(in.context().synchronize()); });
  }
  std::printf("elsewhere in the process\n");
  std::unique_ptr<Context> made;
  call(a, b, "cuCtxCreate", [&](Gpu&) {
    if (auto context = Context::create(0)) made = std::move(context.value());
  });
  call(a, b, "cuCtxDestroy", [&](Gpu&) { made.reset(); });
}

void hang(const std::string& ptx) {
  Gpu gpu(ptx);
  gpu.begin("compute");
  gpu.suspend();
  std::printf("suspended until it is killed\n");
  std::fflush(stdout);
  for (;;) pause();
}

void once(const std::string& ptx) {
  const Clock::time_point begin = Clock::now();
  Gpu gpu(ptx);
  std::printf("a context after %.0f ms", since_us(begin) / 1000);
  std::printf(", a job in %.0f us\n", gpu.job_us(100'000));
}

void load(const std::string& ptx) {
  Gpu gpu(ptx);
  gpu.begin("compute");
  for (;;) pause();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) give_up("usage: suspend KERNELS.ptx PART [KIND BLOCKS]");
  std::ifstream file(argv[1]);
  const std::string ptx{std::istreambuf_iterator<char>(file), {}}, part = argv[2];
  if (ptx.empty()) give_up(std::string("cannot read ") + argv[1]);
  if (!xauto::kernel::rm_is_watched()) give_up("start it with LD_PRELOAD=libxauto_watch.so");
  if (part == "costs" && argc == 5)
    costs(ptx, argv[3], static_cast<unsigned>(std::max(1, std::atoi(argv[4]))));
  else if (part == "beside")
    beside(ptx);
  else if (part == "lasting")
    lasting(ptx);
  else if (part == "calls")
    calls(ptx);
  else if (part == "hang")
    hang(ptx);
  else if (part == "once")
    once(ptx);
  else if (part == "load")
    load(ptx);
  else
    give_up("no part '" + part + "'");
}
