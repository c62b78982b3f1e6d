// SPDX-License-Identifier: Apache-2.0
// What it costs a worker to say that its next job has another priority: the store into the mapped
// BPF map that the sched_ext scheduler reads, against sched_setattr(2), which SCHED_FIFO needs.
// Both in turn, in one run; medians over batches, so that a preempted batch does not count.
//   cpu_priority [--json]      as root; without BPF the store goes to ordinary memory, as it says
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "kernel/run_maps.h"
#include "kernel/thread_slots.h"

namespace {

using Clock = std::chrono::steady_clock;

constexpr int kBatches = 301, kPerBatch = 2000;

/// As the kernel knows it; glibc of Debian 12 has no wrapper.
struct Attributes {
  std::uint32_t size = sizeof(Attributes), policy = 0;
  std::uint64_t flags = 0;
  std::int32_t nice = 0;
  std::uint32_t priority = 0;
  std::uint64_t runtime = 0, deadline = 0, period = 0;
};

double batch_ns(const std::function<void(int)>& many) {
  const auto begin = Clock::now();
  many(kPerBatch);
  return std::chrono::duration<double, std::nano>(Clock::now() - begin).count() / kPerBatch;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<long>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

}  // namespace

int main(int argc, char** argv) {
  using xauto::kernel::RunMaps;
  using xauto::kernel::ThreadSlots;
  const bool json = argc > 1 && std::strcmp(argv[1], "--json") == 0;

  auto maps = RunMaps::create(std::to_string(getpid()) + "-bench", 16, 1);
  ThreadSlots slots = ThreadSlots::unobserved();
  if (maps) {
    auto attached = ThreadSlots::attach(xauto::UniqueFd(dup(maps->fd("slots"))),
                                        xauto::UniqueFd(dup(maps->fd("threads"))));
    if (attached) slots = std::move(*attached);
  } else {
    std::fprintf(stderr, "cpu_priority: %s\n", maps.error().to_string().c_str());
  }
  const xauto::kernel::ThreadSlot slot = slots.take(0);
  if (auto entered = slots.enter(slot); !entered) {
    std::fprintf(stderr, "cpu_priority: %s\n", entered.error().to_string().c_str());
    return 1;
  }

  Attributes attributes;
  attributes.policy = SCHED_FIFO;
  attributes.priority = 2;
  const bool fifo = syscall(SYS_sched_setattr, 0, &attributes, 0) == 0;
  if (!fifo) attributes.policy = SCHED_OTHER;

  std::vector<double> store, call;
  std::uint64_t sequence = 0;
  bool waited_for = false;
  for (int b = 0; b < kBatches; ++b) {
    store.push_back(batch_ns([&](int n) {
      for (int i = 0; i < n; ++i)
        waited_for |= slot.tell(static_cast<std::uint32_t>(i & 15), ++sequence);
    }));
    call.push_back(batch_ns([&](int n) {
      for (int i = 0; i < n; ++i) {
        if (fifo)
          attributes.priority = 2 + static_cast<std::uint32_t>(i & 1);
        else
          attributes.nice = i & 1;
        syscall(SYS_sched_setattr, 0, &attributes, 0);
      }
    }));
  }
  slots.leave(slot);
  const double store_ns = median(store), call_ns = median(call);
  const char* kind = fifo ? "SCHED_FIFO" : "SCHED_OTHER, nice";
  if (json)
    std::printf(
        "{\"store_ns\": %.1f, \"sched_setattr_ns\": %.1f, \"ratio\": %.1f, \"mapped\": %s}\n",
        store_ns, call_ns, call_ns / store_ns, slots.observed() ? "true" : "false");
  else
    std::printf(
        "changing the priority of the next job, median of %d batches of %d\n"
        "  store into %-18s %8.1f ns\n  sched_setattr (%s)%*s %8.1f ns\n  ratio %29.1f\n",
        kBatches, kPerBatch, slots.observed() ? "a mapped BPF map" : "ordinary memory", store_ns,
        kind, static_cast<int>(14 - std::strlen(kind)), "", call_ns, call_ns / store_ns);
  return waited_for ? 1 : 0;  // never: nobody schedules this thread
}
