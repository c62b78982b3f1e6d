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
  Platform here = platform_of(Hardware::here(table), "here", table);
  const int absent = here.find("fpga0");
  ASSERT_GE(absent, 0);
  EXPECT_EQ(here.xpus[static_cast<std::size_t>(absent)].emulated, std::optional(true));
  EXPECT_EQ(probed().verdict, kernel::Verdict::kMissing);
  EXPECT_EQ(probed().found, "no xdma device node");
  std::ofstream(node) << "";
  here = platform_of(Hardware::here(table), "here", table);
  const Xpu fpga = here.xpus[static_cast<std::size_t>(here.find("fpga0"))];
  EXPECT_FALSE(fpga.emulated.has_value());
  EXPECT_EQ(fpga.preempt_us, 77);
  EXPECT_EQ(probed().verdict, kernel::Verdict::kOk);
  EXPECT_TRUE(Hardware::here(table).has(here, static_cast<std::size_t>(here.find("fpga0")), table));

  // Scheduled by its discipline, suspended by its backend.
  EXPECT_EQ(discipline_of(fpga, false, false, table), Discipline::kPreemptive);
  auto backend = make_backend({fpga, {"fpga0", XPU("fpga"), 0}}, table);
  ASSERT_TRUE(backend);
  ASSERT_TRUE((*backend)->preempt(SchedHandle::gate()));
  EXPECT_EQ(suspended, 1);
  ASSERT_TRUE((*backend)->restore(SchedHandle::gate()));
  EXPECT_EQ(suspended, 0);
  fs::remove(node);
  EXPECT_EQ(discipline_of(fpga, false, false, table), Discipline::kGate) << "it is gone";
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

TEST(Kind, NvgpusWorkIsSuspendedByTheModuleElseByItsProcessElseByNobody) {
  const fs::path root = fs::temp_directory_path() / ("xauto-ways-" + std::to_string(getpid()));
  fs::remove_all(root);
  const auto chosen = [&](const char* type) {
    const Way* way = way_of(kind_of(type), root.string());
    return way == nullptr ? std::string("gate") : way->name;
  };
  EXPECT_EQ(chosen("gpu"), "gate");
  fs::create_directories(root / "dev/nvgpu/igpu0");
  std::ofstream(root / "dev/nvgpu/igpu0/tsg") << "";
  EXPECT_EQ(chosen("gpu"), "own");
  EXPECT_EQ(chosen("dla"), "gate");
  const auto doctor = [&] {
    for (const kernel::Finding& f :
         kernel::probe(root.string(), kernel::Permitted::of_this_process(), devices()))
      if (f.id == "gpu") return f.meaning;
    return std::string();
  };
  EXPECT_EQ(doctor(),
            "a Jetson's GPU, suspended by each process itself: one that hangs resumes nobody until "
            "it is killed");
  fs::create_directories(root / "proc");
  std::ofstream(root / "proc/modules") << "xauto 16384 0 - Live 0x0\n";
  EXPECT_EQ(chosen("gpu"), "xauto.ko");
  EXPECT_EQ(doctor(), "a Jetson's GPU, suspended by xauto.ko");
  EXPECT_EQ(chosen("dla"), "xauto.ko");
  fs::remove_all(root);
}

/// Where the platform states levels, the app's own queues have them; else work is suspended as before.
TEST(Kind, ALevelInThePlatformAsksForTheAppsOwnQueues) {
  const fs::path node = fs::temp_directory_path() / ("xauto-levels-" + std::to_string(getpid()));
  std::ofstream(node) << "";
  std::vector<Kind> table = kinds();
  for (Kind& kind : table)
    if (kind.driver == "nvidia") {
      kind.nodes = {node.string()};
      ASSERT_EQ(kind.ways.front().name, "streams") << "of choice";
      kind.ways.front().ask = [] { return 6; };
    }
  Xpu gpu{.id = "gpu0", .type = "gpu", .preemptive = true};
  EXPECT_EQ(discipline_of(gpu, false, false, table), Discipline::kPreemptive);
  EXPECT_TRUE(is_watched(gpu, false, table));
  EXPECT_FALSE(orders_one_process(gpu, false, table));
  gpu.levels = 4;
  EXPECT_EQ(discipline_of(gpu, false, false, table), Discipline::kLevels);
  EXPECT_EQ(levels_of(gpu, false, table), 4);
  EXPECT_FALSE(is_watched(gpu, false, table));
  EXPECT_TRUE(orders_one_process(gpu, false, table));
  EXPECT_NE(caveat_of(gpu, false, table).find("CUDA calls a hint"), std::string::npos);
  const auto backend = make_backend({gpu, {"gpu0", XPU::GPU, 0}}, table);
  ASSERT_TRUE(backend);
  EXPECT_FALSE((*backend)->attach(SchedHandle::cuda_context(&gpu)));
  int level = -1;
  const SchedHandle handle = SchedHandle::on_levels([&](int on) -> Status {
    level = on;
    return {};
  });
  EXPECT_TRUE((*backend)->attach(handle));
  EXPECT_TRUE((*backend)->level(handle, 3));
  EXPECT_EQ(level, 3);
  gpu.preemptive = false;
  EXPECT_EQ(discipline_of(gpu, false, false, table), Discipline::kGate);

  const Platform here = platform_of(Hardware::here(table), "here", table);
  const Xpu& found = here.xpus[static_cast<std::size_t>(here.find("gpu0"))];
  EXPECT_EQ(found.levels, 6) << "a file of this machine states them";
  EXPECT_TRUE(found.preemptive);
  EXPECT_EQ(found.preempt_us, 0) << "what is waited for is in the WCETs";
  EXPECT_FALSE(found.preempt_measured);
  EXPECT_NE(unmeasured(found).find("`xauto profile` times"), std::string::npos);
  for (const kernel::Finding& f :
       kernel::probe("", kernel::Permitted::of_this_process(), devices(table)))
    if (f.id == "gpu") {
      EXPECT_NE(f.meaning.find("\"levels\": 6"), std::string::npos) << f.meaning;
    }
  fs::remove(node);

  Xpu own{.id = "npu0", .type = "npu", .preemptive = true, .levels = 2};
  EXPECT_EQ(discipline_of(own, false), Discipline::kLevels) << "an XPU of the app's";
  EXPECT_EQ(levels_of(own, false), 2);
}

TEST(Kind, ATypeMayHaveARowForEachDriver) {
  const fs::path node = fs::temp_directory_path() / ("xauto-driver-" + std::to_string(getpid()));
  std::vector<Kind> table = kinds();
  table.push_back({.type = "dla",
                   .nodes = {node.string()},
                   .ways = {{.name = "other", .backend = make_fpga}},
                   .preempt_us = 5,
                   .what = "another DLA",
                   .driver = "otherdla"});
  const auto probed = [&] {
    std::vector<kernel::Finding> found;
    for (const kernel::Finding& f :
         kernel::probe("", kernel::Permitted::of_this_process(), devices(table)))
      if (f.id == "dla") found.push_back(f);
    return found;
  };
  EXPECT_EQ(kind_of("dla", table).driver, "nvdla") << "none is here: the first";
  ASSERT_EQ(probed().size(), 1u);
  EXPECT_EQ(probed()[0].found, "no nvdla device node");
  std::ofstream(node) << "";
  EXPECT_EQ(kind_of("dla", table).driver, "otherdla");
  ASSERT_EQ(probed().size(), 1u);
  EXPECT_EQ(probed()[0].meaning, "another DLA, suspended by other");
  const Platform here = platform_of(Hardware::here(table), "here", table);
  EXPECT_EQ(here.instances_of("dla").size(), 1u);
  EXPECT_EQ(here.xpus[static_cast<std::size_t>(here.find("dla0"))].preempt_us, 5);
  fs::remove(node);
}

TEST(Kind, TheEmulatorModulesHaveWhatADriverSuspends) {
  const Xpu gpu{"gpu0", "gpu"}, cpu{"cpu0", "cpu"}, npu{"npu0", "npu"}, gated{"dla0", "dla", false};
  EXPECT_TRUE(is_by_modules(gpu));
  EXPECT_FALSE(is_by_modules(cpu));
  EXPECT_FALSE(is_by_modules(npu));
  EXPECT_FALSE(is_by_modules(gated)) << "nobody suspends it";
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
