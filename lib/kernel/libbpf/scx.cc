// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <thread>

#include "base/first_line.h"
#include "base/log.h"
#include "kernel/libbpf/session.h"
#include "kernel/scx_scheduler.h"

#include "xauto_scx.skel.h"

namespace xauto::kernel {
namespace {

/// enum scx_ops_flags: the same value from 6.12 on.
constexpr std::uint64_t kSwitchPartial = 1u << 3;
constexpr const char* kScx = "/sys/kernel/sched_ext";
constexpr auto kEnableLimit = std::chrono::seconds(5);

}  // namespace

struct ScxScheduler::Loaded {
  xauto_scx* object = nullptr;
  bpf_link* link = nullptr;
  bpf_link* exited = nullptr;
  ~Loaded() {
    bpf_link__destroy(link);
    bpf_link__destroy(exited);
    xauto_scx__destroy(object);
  }
};

ScxScheduler::ScxScheduler() = default;
ScxScheduler::ScxScheduler(ScxScheduler&&) noexcept = default;
ScxScheduler::~ScxScheduler() = default;

std::string ScxScheduler::dump() const {
  const auto& dump = loaded_->object->data_dump->exit_dump;
  return {dump, strnlen(dump, sizeof dump)};
}

Result<ScxScheduler> ScxScheduler::load(const RunMaps& maps, const ScxOptions& options) {
  constexpr int kTries = 10;
  for (int i = 1;; ++i) {
    auto scheduler = load_once(maps, options);
    if (scheduler || i == kTries || !scx_asks_restart(maps.sched())) return scheduler;
    log::debug("the scheduler is loaded again: {}", scheduler.error().to_string());
    const auto limit = std::chrono::steady_clock::now() + kEnableLimit;
    while (first_line(std::string(kScx) + "/state") != "disabled" &&
           std::chrono::steady_clock::now() < limit)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

Result<ScxScheduler> ScxScheduler::load_once(const RunMaps& maps, const ScxOptions& options) {
  if (std::string refusal = scx_refusal(""); !refusal.empty())
    return fail(ErrorCode::kUnavailable, std::move(refusal));
  // Up to the greatest number, since there may be gaps: each CPU has a state and a queue.
  XAUTO_ASSIGN(const std::size_t cpus, possible_cpus());
  if (cpus > XAUTO_BPF_MAX_CPUS)
    return fail(ErrorCode::kUnavailable, std::to_string(cpus) + " CPUs; the scheduler knows " +
                                             std::to_string(XAUTO_BPF_MAX_CPUS));
  ScxScheduler scheduler;
  scheduler.choice_ = choose_scx_mode("", options);
  scheduler.loaded_ = std::make_unique<Loaded>();
  Loaded& loaded = *scheduler.loaded_;

  // Before anything looks at the CPUs: the kernel refuses us if one comes or goes after this.
  const std::uint64_t seen =
      std::strtoull(first_line(std::string(kScx) + "/hotplug_seq").c_str(), nullptr, 10);
  const LibbpfMessages messages;
  loaded.object = xauto_scx__open();
  if (loaded.object == nullptr) return libbpf_failed("opening the scheduler", errno);
  auto& constants = *loaded.object->rodata;
  constants.nr_cpus = static_cast<unsigned>(cpus);
  constants.mode = scheduler.choice_.partial ? XAUTO_BPF_MODE_PARTIAL : XAUTO_BPF_MODE_FULL;
  constants.floor_permille = options.floor_permille;
  constants.floor_burst_us = options.floor_burst_us;
  constants.xnode_slice_us = options.xnode_slice_us;
  constants.age_ms = options.age_ms;
  const std::vector<std::uint8_t> clusters = scx_clusters("", cpus);
  std::copy(clusters.begin(), clusters.end(), constants.cluster_of);
  // The watchdog's clock is the tick, which is also the coarse clock's.
  timespec tick{};
  clock_getres(CLOCK_MONOTONIC_COARSE, &tick);
  constants.rescue_jiffies = static_cast<unsigned long>(options.timeout_ms / 2) * 1'000'000 /
                             static_cast<unsigned long>(std::max(tick.tv_nsec, 1'000'000L / 4));
  constants.timeout_ms = options.timeout_ms;
  auto* ops = loaded.object->struct_ops.xauto_ops;
  ops->timeout_ms = options.timeout_ms;
  ops->hotplug_seq = seen;
  if (scheduler.choice_.partial) ops->flags |= kSwitchPartial;
  for (bpf_map* map :
       {loaded.object->maps.head, loaded.object->maps.table, loaded.object->maps.slots,
        loaded.object->maps.jobs, loaded.object->maps.sched, loaded.object->maps.counts,
        loaded.object->maps.threads})
    XAUTO_TRY(reuse(map, maps));
  const VerifierLog verifier(loaded.object->obj);
  const int load_error = xauto_scx__load(loaded.object);
  verifier.write();
  if (load_error != 0) return libbpf_failed("the kernel did not accept the scheduler", load_error);
  loaded.exited = bpf_program__attach(loaded.object->progs.xauto_exited);
  if (loaded.exited == nullptr) return libbpf_failed("following the ends of threads", errno);
  // By hand: a skeleton of bpftool 7.5 attaches struct_ops only with a newer libbpf than Debian's.
  loaded.link = bpf_map__attach_struct_ops(loaded.object->maps.xauto_ops);
  if (loaded.link == nullptr) return libbpf_failed("enabling the scheduler", errno);

  // Attaching returns before the kernel has switched over. What was asked for is read back.
  const auto limit = std::chrono::steady_clock::now() + kEnableLimit;
  while (first_line(std::string(kScx) + "/state") != "enabled") {
    if (const auto exit = scx_exit_of(maps.sched()))
      return fail(ErrorCode::kUnavailable, "the kernel ended the scheduler: " + *exit);
    if (std::chrono::steady_clock::now() > limit)
      return fail(ErrorCode::kTimeout,
                  "the scheduler was attached but is not enabled after 5 s: '" +
                      first_line(std::string(kScx) + "/state") + "'");
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  const std::string ops_name = first_line(std::string(kScx) + "/root/ops");
  if (ops_name.rfind("xauto", 0) != 0)
    return fail(ErrorCode::kUnavailable, "the kernel runs scheduler '" + ops_name + "', not ours");
  if (const int fd = bpf_map__fd(loaded.object->maps.cpu_states); fd >= 0)
    XAUTO_TRY(maps.pin(fd, "cpu_states"));
  return scheduler;
}

}  // namespace xauto::kernel
