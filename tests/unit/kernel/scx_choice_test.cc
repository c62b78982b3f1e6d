// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "kernel/scx_scheduler.h"
#include "kernel/thread_slots.h"
#include "kernel/tracer.h"

namespace xauto::kernel {
namespace {

namespace fs = std::filesystem;

/// A folder that stands for / on some machine.
class FakeRoot {
 public:
  FakeRoot() {
    static int number = 0;
    root_ = fs::temp_directory_path() /
            ("xauto-scx-" + std::to_string(getpid()) + "-" + std::to_string(number++));
    fs::create_directories(root_);
  }
  ~FakeRoot() { fs::remove_all(root_); }
  FakeRoot& file(const std::string& path, const std::string& text) {
    fs::create_directories((root_ / path).parent_path());
    std::ofstream(root_ / path) << text << "\n";
    return *this;
  }
  [[nodiscard]] std::string path() const { return root_.string(); }

 private:
  fs::path root_;
};

TEST(ScxClusters, AreTheCpusThatShareTheLastCache) {
  FakeRoot orin;  // two of its clusters; CPU 5 is away
  const std::string cpus = "sys/devices/system/cpu/cpu";
  for (int cpu = 0; cpu < 8; ++cpu) {
    if (cpu == 5) continue;
    const std::string own = cpus + std::to_string(cpu);
    orin.file(own + "/cache/index0/level", "1")
        .file(own + "/cache/index0/shared_cpu_list", std::to_string(cpu))
        .file(own + "/cache/index1/level", "3")
        .file(own + "/cache/index1/shared_cpu_list", cpu < 4 ? "0-3" : "4,6-7");
  }
  EXPECT_EQ(scx_clusters(orin.path(), 8), (std::vector<std::uint8_t>{0, 0, 0, 0, 4, 5, 4, 4}));

  FakeRoot packages;  // a kernel that tells no caches
  for (int cpu = 0; cpu < 2; ++cpu)
    packages.file(cpus + std::to_string(cpu) + "/topology/package_cpus_list", "0-1");
  EXPECT_EQ(scx_clusters(packages.path(), 2), (std::vector<std::uint8_t>{0, 0}));
}

TEST(ScxDump, TheLastOneIsKeptAndSaysWhoseItIs) {
  const FakeRoot root;
  EXPECT_FALSE(kept_scx_dump(root.path()));
  ASSERT_TRUE(keep_scx_dump(root.path(), "12-0", "a stall", "much\nmore\n"));
  ASSERT_TRUE(keep_scx_dump(root.path(), "34-0", "an error", "less\n"));
  const auto kept = kept_scx_dump(root.path(), "34-0");
  ASSERT_TRUE(kept);
  EXPECT_EQ(kept->about, "run 34-0: an error");
  EXPECT_EQ(fs::file_size(root.path() + kept->path), kept->about.size() + 1 + 5);
  EXPECT_TRUE(kept_scx_dump(root.path()));
  EXPECT_FALSE(kept_scx_dump(root.path(), "12-0"));
}

TEST(ScxRefusal, NamesWhatTheMachineLacks) {
  FakeRoot bare;
  EXPECT_NE(scx_refusal(bare.path()).find("no sched_ext"), std::string::npos);

  FakeRoot realtime;
  realtime.file("sys/kernel/sched_ext/state", "disabled").file("sys/kernel/realtime", "1");
  EXPECT_NE(scx_refusal(realtime.path()).find("PREEMPT_RT"), std::string::npos);

  FakeRoot taken;
  taken.file("sys/kernel/sched_ext/state", "enabled")
      .file("sys/kernel/sched_ext/root/ops", "scx_simple")
      .file("sys/kernel/btf/vmlinux", "");
  EXPECT_EQ(scx_refusal(taken.path()), "another sched_ext scheduler is loaded: 'scx_simple'");

  FakeRoot without_btf;
  without_btf.file("sys/kernel/sched_ext/state", "disabled");
  EXPECT_NE(scx_refusal(without_btf.path()).find("no BTF"), std::string::npos);

  FakeRoot good;
  good.file("sys/kernel/sched_ext/state", "disabled").file("sys/kernel/btf/vmlinux", "");
  EXPECT_EQ(scx_refusal(good.path()), "");
}

TEST(ScxMode, IsPartialOnlyWhereEveryCpuOfThePolicyIsIsolated) {
  FakeRoot some;
  some.file("sys/devices/system/cpu/isolated", "2-3,7");
  EXPECT_TRUE(choose_scx_mode(some.path(), {.cpus = {2, 3, 7}}).partial);
  const ScxChoice full = choose_scx_mode(some.path(), {.cpus = {2, 4}});
  EXPECT_FALSE(full.partial);
  EXPECT_NE(full.why.find("CPU 4 is not isolated"), std::string::npos);
  EXPECT_FALSE(choose_scx_mode(some.path(), {}).partial);
  FakeRoot none;
  none.file("sys/devices/system/cpu/isolated", "");
  EXPECT_FALSE(choose_scx_mode(none.path(), {.cpus = {1}}).partial);
  EXPECT_TRUE(choose_scx_mode(none.path(), {.mode = ScxMode::kPartial}).partial);
}

TEST(CpuList, ReadsRangesAndStopsAtNonsense) {
  EXPECT_EQ(parse_cpu_list("0-2,5"), (std::vector<int>{0, 1, 2, 5}));
  EXPECT_EQ(parse_cpu_list("3"), (std::vector<int>{3}));
  EXPECT_TRUE(parse_cpu_list("").empty());
  EXPECT_EQ(parse_cpu_list("1,x"), (std::vector<int>{1}));
  EXPECT_TRUE(parse_cpu_list("5-2").empty());
  EXPECT_TRUE(parse_cpu_list("-3").empty());
  EXPECT_TRUE(parse_cpu_list("99999999999").empty());
  EXPECT_TRUE(parse_cpu_list("0-4000000000").empty());
}

TEST(ScxExit, TellsReasonAndMessageOnceItHasEnded) {
  xauto_bpf_sched sched{};
  EXPECT_FALSE(scx_exit_of(sched));
  sched.exit_kind = 1026;
  std::string("runnable task stall").copy(sched.exit_reason, sizeof sched.exit_reason);
  std::string("spinner[7] failed to run for 12 s").copy(sched.exit_msg, sizeof sched.exit_msg);
  EXPECT_EQ(*scx_exit_of(sched), "runnable task stall (spinner[7] failed to run for 12 s)");
  std::fill(std::begin(sched.exit_reason), std::end(sched.exit_reason), 'x');  // not ended by 0
  EXPECT_EQ(scx_exit_of(sched)->substr(0, 64), std::string(64, 'x'));
}

TEST(Quantile, IsTheUpperEdgeOfItsBucket) {
  __u64 buckets[XAUTO_BPF_BUCKETS] = {};
  EXPECT_EQ(quantile_us(buckets, 500), 0u);
  buckets[3] = 90;  // 8..16 us
  buckets[10] = 10;
  EXPECT_EQ(quantile_us(buckets, 500), 16u);
  EXPECT_EQ(quantile_us(buckets, 900), 16u);
  EXPECT_EQ(quantile_us(buckets, 901), 2048u);
  EXPECT_EQ(quantile_us(buckets, 1000), 2048u);
}

TEST(ThreadSlot, TellsAJobInOneWordAndKeepsThePriorityAfterItsEnd) {
  xauto_bpf_slot memory{};
  const ThreadSlot slot(&memory);
  EXPECT_EQ(slot.xnode(), -1);
  EXPECT_FALSE(slot.tell(7, 42));
  EXPECT_EQ(memory.job, XAUTO_BPF_JOB(7, 42));
  EXPECT_EQ(slot.xnode(), 7);
  slot.end();
  EXPECT_EQ(slot.xnode(), 7);
  EXPECT_NE(memory.job & XAUTO_BPF_JOB_ENDED, 0u);
  EXPECT_EQ(memory.job & XAUTO_BPF_JOB_SEQ, 42u);
  memory.waiting = 1;
  EXPECT_TRUE(slot.tell(0, ~0ull)) << "somebody waits";
  EXPECT_EQ(slot.xnode(), 0) << "a sequence number that is too long stays in its bits";
  EXPECT_EQ(memory.job & XAUTO_BPF_JOB_ENDED, 0u);
}

TEST(ThreadSlot, CountsTheTimeThatJobsHoldTheXpuWithoutSuspensions) {
  xauto_bpf_slot memory{};
  const ThreadSlot slot(&memory);
  slot.has_xpu(100);
  slot.gave_xpu(150);
  slot.gave_xpu(170);  // FINISH after SUSPENDED
  slot.has_xpu(200);
  slot.gave_xpu(230);
  EXPECT_EQ(memory.busy_ns, 80u);
  slot.begin(300);
  EXPECT_EQ(memory.since_ns, 300u);
  EXPECT_EQ(memory.jobs, 1u);
}

TEST(ThreadSlots, WithoutBpfGiveMemoryThatNobodyLooksAt) {
  ThreadSlots slots = ThreadSlots::unobserved();
  const ThreadSlot first = slots.take(3), second = slots.take(4);
  EXPECT_FALSE(slots.observed());
  EXPECT_EQ(slots.index(first), -1);
  EXPECT_FALSE(first.tell(1, 1));
  EXPECT_EQ(second.xnode(), -1);
  ASSERT_TRUE(slots.enter(first));
  EXPECT_EQ(first.tid(), static_cast<std::uint32_t>(gettid()));
  slots.leave(first);
  EXPECT_EQ(first.tid(), 0u);
}

}  // namespace
}  // namespace xauto::kernel
