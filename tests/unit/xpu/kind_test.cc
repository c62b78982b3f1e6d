// SPDX-License-Identifier: Apache-2.0
// The table of XPU kinds: what it says of those we know, and that a new kind is one row and one
// backend.
#include "xpu/kind.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "xpu/presence.h"

namespace xauto::xpu {
namespace {

namespace fs = std::filesystem;

// ---- a backend of a kind that the tree does not know ---------------------------------------------

int suspended = 0;

class Fpga final : public Backend {
 public:
  Status preempt(const SchedHandle&) override {
    ++suspended;
    return {};
  }
  Status restore(const SchedHandle&) override {
    --suspended;
    return {};
  }
};

Result<std::unique_ptr<Backend>> make_fpga(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<Fpga>());
}

TEST(Kind, ANewOneIsARowAndABackend) {
  const fs::path node = fs::temp_directory_path() / ("xauto-fpga-" + std::to_string(getpid()));
  fs::remove(node);
  std::vector<Kind> table = kinds();
  table.push_back({.type = "fpga",
                   .nodes = {node.string()},
                   .ways = {{.name = "fpga.ko", .backend = make_fpga}},
                   .preempt_us = 77,
                   .timeslice_us = 500,
                   .what = "a board's FPGA",
                   .driver = "xdma",
                   .advice = "needs the board"});

  // Found by its node, in what doctor probes and in the machine's platform.
  const auto probed = [&] {
    for (const kernel::Finding& f :
         kernel::probe("", kernel::Permitted::of_this_process(), devices(table)))
      if (f.id == "fpga") return f;
    return kernel::Finding{};
  };
  Platform here = platform_of(Machine::here(table), "here", table);
  const int absent = here.find("fpga0");
  ASSERT_GE(absent, 0);
  EXPECT_EQ(here.xpus[static_cast<std::size_t>(absent)].emulated, std::optional(true));
  EXPECT_EQ(probed().verdict, kernel::Verdict::kMissing);
  EXPECT_EQ(probed().found, "no xdma device node");
  std::ofstream(node) << "";
  here = platform_of(Machine::here(table), "here", table);
  const Xpu fpga = here.xpus[static_cast<std::size_t>(here.find("fpga0"))];
  EXPECT_FALSE(fpga.emulated.has_value());
  EXPECT_EQ(fpga.preempt_us, 77);
  EXPECT_EQ(probed().verdict, kernel::Verdict::kOk);
  EXPECT_TRUE(Machine::here(table).has(here, static_cast<std::size_t>(here.find("fpga0")), table));
  fs::remove(node);

  // Scheduled by its discipline, suspended by its backend.
  EXPECT_EQ(discipline_of(fpga, false, false, table), Discipline::kPreemptive);
  auto backend = make_backend({fpga, {"fpga0", XPU("fpga"), 0}}, table);
  ASSERT_TRUE(backend);
  ASSERT_TRUE((*backend)->preempt(SchedHandle::gate()));
  EXPECT_EQ(suspended, 1);
  ASSERT_TRUE((*backend)->restore(SchedHandle::gate()));
  EXPECT_EQ(suspended, 0);
}

TEST(Kind, TheDisciplineIsThePlatformsThenTheEmulatorsThenTheRows) {
  EXPECT_EQ(discipline_of({"cpu0", "cpu"}, false), Discipline::kKernel);
  EXPECT_EQ(discipline_of({"cpu0", "cpu"}, false, true), Discipline::kPreemptive)
      << "by keys: Linux has none";
  EXPECT_EQ(discipline_of({"gpu0", "gpu"}, false, true), discipline_of({"gpu0", "gpu"}, false));
  EXPECT_EQ(discipline_of({"cpu0", "cpu"}, true), Discipline::kPreemptive);
  EXPECT_EQ(discipline_of({"cpu0", "cpu", false}, true), Discipline::kGate);
  EXPECT_EQ(discipline_of({"cpu0", "cpu", false}, false), Discipline::kGate);
  EXPECT_EQ(discipline_of({"npu0", "npu"}, false), Discipline::kPreemptive);
  EXPECT_EQ(discipline_of({"gpu0", "gpu"}, false),
            kernel::module_is_loaded() ? Discipline::kPreemptive : Discipline::kGate);
}

TEST(Kind, AnXpuOfTheAppsOwnSaysHowItIsSuspended) {
  const Xpu npu{"npu0", "npu"};
  const XpuId id{"npu0", XPU("npu"), 0};
  const auto backend = std::move(*make_backend({npu, id}));
  int paused = 0;
  const SchedHandle handle = SchedHandle::custom(
      [&]() -> Status {
        if (paused > 0) throw std::runtime_error("no");
        ++paused;
        return {};
      },
      [&]() -> Status {
        --paused;
        return {};
      });
  EXPECT_TRUE(backend->attach(handle));
  EXPECT_TRUE(backend->preempt(handle));
  EXPECT_EQ(paused, 1);
  const Status thrown = backend->preempt(handle);
  ASSERT_FALSE(thrown);
  EXPECT_EQ(thrown.error().what, "suspend threw: no");
  EXPECT_TRUE(backend->restore(handle));
  EXPECT_EQ(paused, 0);
  for (const SchedHandle& other : {SchedHandle::gate(), SchedHandle::thread()})
    EXPECT_FALSE(backend->attach(other)) << other.kind_name();
  const Xpu gated{"npu0", "npu", false};
  EXPECT_TRUE((*make_backend({gated, id}))->attach(SchedHandle::gate()));
}

TEST(Kind, ARealCoreRunsThreadsOnly) {
  const Xpu cpu{"cpu0", "cpu"};
  const auto backend = std::move(*make_backend({cpu, {"cpu0", XPU::CPU, 0}}));
  EXPECT_TRUE(backend->on_thread());
  EXPECT_TRUE(backend->attach(SchedHandle::thread()));
  int context = 0;
  EXPECT_FALSE(backend->attach(SchedHandle::cuda_context(&context)));
  EXPECT_FALSE(backend->preempt(SchedHandle::thread())) << "that is the kernel's";
}

}  // namespace
}  // namespace xauto::xpu
