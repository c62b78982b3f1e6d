// SPDX-License-Identifier: Apache-2.0
// App::run in a process of somebody else's, this test: real daemons, emulated XPUs, twice in one
// process, two side by side, told to stop. No time is measured.
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <xauto/emu.h>
#include <xauto/xauto.h>

#include "kernel/bpf_sys.h"
#include "kernel/policy_map.h"
#include "kernel/run_folder.h"
#include "model/json.h"
#include "model/json_value.h"
#include "model/periodic.h"

#include "tests/unit/tables_of.h"

namespace xauto {
namespace {

using namespace std::chrono_literals;

struct State {
  int value = 0;
};

/// What an init owns: a context of this run's emulator.
struct Engine {
  Engine(emu::Context c, XpuId id) : context(std::move(c)), xpu(std::move(id)) {}
  emu::Context context;
  XpuId xpu;
};

/// camera (pushed or polled) -> M (m1 on gpu0, emulated; m2 on cpu0, emulated)
class Fixture {
 public:
  explicit Fixture(const std::string& name, bool push = false) : app(name) {
    const auto init = [this](const XpuId& xpu) {
      auto context = emu::Context::open(xpu);
      if (!context) throw std::runtime_error(context.error().to_string());
      const SchedHandle handle = context->handle();
      ++alive;
      auto engine = std::unique_ptr<Engine>(new Engine(std::move(*context), xpu));
      return own(std::move(engine), handle);
    };
    const auto exec = [this](Engine& engine, State& state, const Input& input) -> Status {
      state.value = input.get(camera);
      while (state.value == block_at) std::this_thread::sleep_for(1h);
      while (busy) std::this_thread::sleep_for(1ms);
      if (engine.xpu.type == XPU::CPU) cpu = engine.xpu.index;
      return engine.context.run(100us);
    };
    XNode<State> m1("m1"), m2("m2");
    m1.add_impl(XPU::GPU, init, exec);
    m2.add_impl(XPU::CPU, init, exec);
    XModule<State> module("M");
    module.add_node(m1).add_node(m2).add_input_topic(camera).add_output_topic(result,
                                                                              &State::value);
    app.add_module(module);
    if (push)
      source = std::make_unique<Source<int>>(app.add_source(camera, pushed(1ms)));
    else
      app.add_source(camera, 1ms, [](std::uint64_t k) { return static_cast<int>(k); });
    app.on_message(result, [this](const int& value, std::uint64_t) {
      sum += value;
      ++results;
    });
  }

  /// `loop`: there is a module of that name, too, which fires by the clock. `instance`: M's name.
  [[nodiscard]] RunOptions options(bool loop = false, const std::string& instance = "") const {
    AppSpec spec;
    spec.name = "fixture";
    spec.xnodes = {{"m1", "M", {{"gpu", 100}}}, {"m2", "M", {{"cpu", 100}}}};
    spec.xnodes[0].sources = {0};
    spec.edges = {{0, 1}};
    spec.one_at_a_time = true;
    spec.sources = {{"camera", kNoRate}};
    if (!instance.empty())
      for (XNodeSpec& xnode : spec.xnodes) {
        xnode.module = instance;
        xnode.name = instance + "/" + xnode.name;
      }
    if (loop) {
      spec.xnodes.push_back({"count", "LOOP", {{"cpu", 100}}, {1}});
      spec.sources.push_back({"LOOP/every", kNoRate});
    }
    complete_modules(spec);
    complete_chains(spec);
    Platform platform;
    platform.name = "tiny";
    platform.xpus = {{"cpu0", "cpu"}, {"gpu0", "gpu", true, 50, 1000}};
    PriorityPlan policy;
    policy.app = spec.name;
    policy.app_hash = spec.hash();
    policy.method = "heft";
    policy.platform = platform.name;
    policy.placements = {{1, 2}, {0, 1}};
    if (loop) policy.placements.push_back({0, 3});
    return RunOptions()
        .app(to_json(spec))
        .platform(to_json(platform))
        .policy(to_json(by_priorities(policy, spec), spec, platform))
        .emulate()
        .activations(20)
        .lockstep();
  }

  const Topic<int> camera{"camera"}, result{"result"};
  App app;
  std::unique_ptr<Source<int>> source;
  std::atomic<int> alive{0}, results{0}, sum{0};
  std::atomic<int> block_at{-1};  ///< the message whose exec never returns
  std::atomic<int> cpu{-1};       ///< where m2 ran last
  std::atomic<bool> busy{false};  ///< an exec goes on
};

TEST(Run, TwiceInOneProcess) {
  Fixture f("a");
  for (int run = 1; run <= 2; ++run) {
    const auto report = f.app.run(f.options());
    ASSERT_TRUE(report) << report.error().to_string();
    EXPECT_TRUE(report->good()) << report->json();
    EXPECT_EQ(report->releases(), 20u);
    EXPECT_EQ(report->lost(), 0u);
    EXPECT_EQ(report->modules(), std::vector<std::string>{"M"});
    EXPECT_EQ(report->results("M"), 20u);
    EXPECT_EQ(report->lost("M"), 0u);
    EXPECT_EQ(report->results("no such module"), 0u);
    EXPECT_GT(report->p50().count(), 0);
    EXPECT_GE(report->max(), report->p99());
    EXPECT_NE(report->json().find("\"releases\":20"), std::string::npos) << report->json();
    EXPECT_EQ(f.results.load(), 20 * run);
    EXPECT_EQ(f.sum.load(), 190 * run);
    EXPECT_EQ(f.alive.load(), 2 * run);
  }
}

Platform two_cpus_and_a_gpu() {
  Platform platform;
  platform.name = "tiny";
  platform.xpus = {{"cpu0", "cpu"}, {"cpu1", "cpu"}, {"gpu0", "gpu", true, 50, 1000}};
  return platform;
}

/// "city": m2 on cpu0; "highway", all of it slower: on cpu1. WCETs that no stall of this machine passes,
/// unless others are given.
class WithTables : public Fixture {
 public:
  explicit WithTables(std::int64_t wcet_us = 10'000'000, const std::vector<Condition>& when = {})
      : Fixture("a", true) {
    AppSpec spec;
    spec.name = "fixture";
    spec.xnodes = {{"m1", "M", {{"gpu", wcet_us}}}, {"m2", "M", {{"cpu", wcet_us}}}};
    spec.xnodes[0].sources = {0};
    spec.edges = {{0, 1}};
    spec.one_at_a_time = true;
    spec.sources = {{"camera", kNoRate}};
    complete_modules(spec);
    complete_chains(spec);
    const Platform platform = two_cpus_and_a_gpu();
    Tables tables;
    tables.app = spec.name;
    tables.app_hash = spec.hash();
    tables.platform = platform.name;
    tables.scenarios = {{.name = "city", .when = when},
                        {.name = "highway", .wcet_scale_pct = {{"cpu", 200}, {"gpu", 200}}}};
    tables.tables = {test::table_of(spec, "near", {2, 0}, {wcet_us, 2 * wcet_us}),
                     test::table_of(spec, "far", {2, 1}, {2 * wcet_us, 4 * wcet_us})};
    for (const int table : {0, 1}) test::serve(tables, spec, table);
    for (const int from : {0, 1}) tables.handovers.push_back({from, 1 - from, {4 * wcet_us}});
    text = to_json(tables, spec, platform);
    with_tables = RunOptions()
                      .app(to_json(spec))
                      .platform(to_json(platform))
                      .policy(text)
                      .emulate()
                      .activations(0);
  }
  /// Publishes until `done`, and waits for each result.
  template <class Done>
  void drive(Done done) {
    while (!done()) {
      const int before = results;
      ASSERT_TRUE(source->publish(next++));
      while (results == before) std::this_thread::sleep_for(1ms);
    }
  }

  std::string text;
  RunOptions with_tables;
  int next = 0;
};

/// Of this process's only run, as bpftool would show it: "m1 gpu0 priority 2; ..."; "" without the right to bpf(2).
std::string deployed() {
  std::string text;
  for (const std::string& run : kernel::RunFolder::alive()) {
    if (run.rfind(std::to_string(getpid()) + "-", 0) != 0) continue;
    const auto map = kernel::PolicyMap::open(run);
    for (const xauto_bpf_policy& row : map ? map->rows() : std::vector<xauto_bpf_policy>())
      text += std::string(row.xnode) + " " + row.xpu + " " + row.by + " " +
              std::to_string(row.value) + "; ";
  }
  return text;
}

TEST(Run, ThePolicyIsInAMapWhereBpfIsPermittedAndGoesWithTheRun) {
  Fixture f("a");
  std::string seen;
  f.app.on_start([&] { seen = deployed(); });
  const auto report = f.app.run(f.options());
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(seen, kernel::may_use_bpf() ? "m1 gpu0 priority 2; m2 cpu0 priority 1; " : "");
  EXPECT_EQ(deployed(), "");
}

TEST(Run, TablesByWhatTheProgramAsksFor) {
  const auto on = [](const char* xpu) {
    const bool may = kernel::may_use_bpf();
    EXPECT_EQ(deployed().find(std::string("m2 ") + xpu + " ") != std::string::npos, may)
        << deployed();
  };
  WithTables f;
  EXPECT_NE(f.app.request_mode("highway").error().what.find("no run goes on"), std::string::npos);
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      f.drive([&] { return f.cpu == 0; });
      const Status unknown = f.app.request_mode("motorway");
      ASSERT_FALSE(unknown);
      EXPECT_EQ(unknown.error().code, ErrorCode::kNotFound);
      ASSERT_TRUE(f.app.request_mode("highway"));
      const int on_time = f.next;
      f.drive([&] { return f.cpu == 1; });
      EXPECT_EQ(f.next, on_time + 1) << "the next release has the other table";
      on("cpu1");
      ASSERT_TRUE(f.app.request_mode(""));
      f.drive([&] { return f.cpu == 0; });
      on("cpu0");
      f.app.stop();
    });
  });
  const auto report = f.app.run(f.with_tables);
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->good()) << report->json();
  const Json told = Json::parse(report->json()).value();
  EXPECT_EQ(told.at("num_switches").integer(), 2);
  EXPECT_EQ(told.at("claims").at("exceeded").boolean(), false) << report->json();
  std::vector<std::string> switches;
  for (const Json& one : told.at("switches").elements())
    switches.push_back(one.at("to").text().value() + " " + one.at("table").text().value() + " " +
                       one.at("why").text().value());
  EXPECT_EQ(switches, (std::vector<std::string>{"highway far asked", "city near asked"}));
  EXPECT_FALSE(f.app.request_mode("highway")) << "the run is over";
}

TEST(Run, AMessageMayAskForAScenario) {
  constexpr int kTunnel = 3;
  WithTables f;
  f.app.on_message(f.camera, [&](const int& message, std::uint64_t) {
    if (message == kTunnel) {
      EXPECT_TRUE(f.app.request_mode("highway"));
    }
  });
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      f.drive([&] { return f.cpu == 1; });
      f.app.stop();
    });
  });
  const auto report = f.app.run(f.with_tables);
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(f.next, kTunnel + 2) << "the next release has the other table";
  const Json told = Json::parse(report->json()).value();
  ASSERT_EQ(told.at("num_switches").integer(), 1);
  for (const Json& one : told.at("switches").elements()) EXPECT_EQ(one.at("why").text(), "asked");
}

/// The same of an app with rates: keys that nothing here is late for.
RunOptions with_tables_of_keys(std::int64_t settles_us,
                               std::optional<std::int64_t> of_change_us = 40'000'000,
                               std::int64_t wcet_us = 1'000'000, bool loses_a_cpu = false) {
  AppSpec spec;
  spec.name = "fixture";
  spec.xnodes = {{"m1", "M", {{"gpu", wcet_us}}}, {"m2", "M", {{"cpu", wcet_us}}}};
  spec.xnodes[0].sources = {0};
  spec.edges = {{0, 1}};
  spec.sources = {{"camera", {2000}}};
  spec.sources[0].jitter_us = 900 * wcet_us / 1000;
  spec.modules = {{"M", 1, false}};
  spec.clocks = {{"main", 0}};
  spec.chains = {{"all", 0, 1, {}, 1}};
  const Platform platform = two_cpus_and_a_gpu();
  Tables tables;
  tables.app = spec.name;
  tables.app_hash = spec.hash();
  tables.platform = platform.name;
  tables.scenarios = {{.name = "city"},
                      {.name = "highway", .wcet_scale_pct = {{"cpu", 200}, {"gpu", 200}}}};
  if (loses_a_cpu) tables.scenarios[1].lost = {"cpu0"};
  for (const int times : {1, 2}) {
    tables.tables.push_back(test::table_of(spec, times == 1 ? "near" : "far", {2, times - 1},
                                           {(times + 1) * wcet_us, (2 * times + 1) * wcet_us}));
    tables.tables.back().keys.chains[0].worst_case_us = 30'000'000;
    test::serve(tables, spec, times - 1);
  }
  for (const int from : {0, 1})
    tables.handovers.push_back({from, 1 - from, {of_change_us}, settles_us});
  return RunOptions()
      .app(to_json(spec))
      .platform(to_json(platform))
      .policy(to_json(tables, spec, platform))
      .emulate()
      .activations(0);
}

TEST(Run, TablesOfKeysChangeWithoutAPauseAndKeepTheOrder) {
  Fixture f("a");
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      const auto wait_for = [&](int cpu) {
        while (f.cpu != cpu) std::this_thread::sleep_for(1ms);
      };
      wait_for(0);
      ASSERT_TRUE(f.app.request_mode("highway"));
      wait_for(1);
      ASSERT_TRUE(f.app.request_mode(""));
      wait_for(0);
      f.app.stop();
    });
  });
  const auto report = f.app.run(with_tables_of_keys(0));
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->lost("M"), 0u) << report->json();
  const Json told = Json::parse(report->json()).value();
  EXPECT_EQ(told.at("num_switches").integer(), 2) << report->json();
  EXPECT_EQ(told.at("claims").at("exceeded").boolean(), false) << report->json();
  EXPECT_NE(told.at("claims").at("of").text()->find("by the policy's keys"), std::string::npos);
  for (const Json& one : told.at("switches").elements())
    EXPECT_EQ(one.at("held_us").integer(), 0) << "nobody waits";
  const int n = f.results;
  EXPECT_EQ(f.sum.load(), n * (n - 1) / 2) << "each release once";
}

TEST(Run, TablesOfKeysDoNotChangeBeforeTheChangeBeforeHasSettled) {
  Fixture f("a");
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      while (f.cpu != 0) std::this_thread::sleep_for(1ms);
      ASSERT_TRUE(f.app.request_mode("highway"));
      while (f.cpu != 1) std::this_thread::sleep_for(1ms);
      ASSERT_TRUE(f.app.request_mode(""));
      const int before = f.results;
      while (f.results < before + 20) std::this_thread::sleep_for(1ms);
      EXPECT_EQ(f.cpu, 1);
      f.app.stop();
    });
  });
  const auto report = f.app.run(with_tables_of_keys(1'000'000'000));
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  const Json told = Json::parse(report->json()).value();
  EXPECT_EQ(told.at("num_switches").integer(), 1) << report->json();
  EXPECT_NE(report->json().find("kept a table that no longer fits"), std::string::npos)
      << report->json();
}

/// Of a change of which nothing is claimed: sensors leave out what comes while it drains.
TEST(Run, AChangeThatClaimsNothingDrainsAndThenTheNextTableIsClaimed) {
  Fixture f("a");
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      while (f.cpu != 0) std::this_thread::sleep_for(1ms);
      ASSERT_TRUE(f.app.request_mode("highway"));
      while (f.cpu != 1) std::this_thread::sleep_for(1ms);
      f.app.stop();
    });
  });
  const auto report = f.app.run(with_tables_of_keys(0, std::nullopt, 50'000));
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->lost("M"), 0u) << report->json();
  EXPECT_EQ(report->json().find("have no worst case"), std::string::npos) << report->json();
  const Json told = Json::parse(report->json()).value();
  ASSERT_EQ(told.at("num_switches").integer(), 1) << report->json();
  // Two stages of 100 ms at their longer WCETs, and what may be under way of 2 ms releases.
  EXPECT_GT(*told.at("switches").elements()[0].at("held_us").integer(), 200'000) << report->json();
}

/// What hangs on an XPU that is lost may never end: nobody waits for it.
TEST(Run, AChangeInWhichAnXpuIsLostDoesNotDrainAndNothingIsClaimedAfterIt) {
  Fixture f("a");
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      while (f.cpu != 0) std::this_thread::sleep_for(1ms);
      ASSERT_TRUE(f.app.request_mode("highway"));
      while (f.cpu != 1) std::this_thread::sleep_for(1ms);
      f.app.stop();
    });
  });
  const auto report = f.app.run(with_tables_of_keys(0, std::nullopt, 1'000'000, true));
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_NE(report->json().find("1 changes of the table have no worst case"), std::string::npos)
      << report->json();
}

/// What this process says on stderr, as long as this lives.
class Heard {
 public:
  Heard() : path_(::testing::TempDir() + "heard." + std::to_string(getpid())), before_(dup(2)) {
    const int file = open(path_.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_APPEND, 0600);
    dup2(file, 2);
    close(file);
  }
  ~Heard() {
    dup2(before_, 2);
    close(before_);
    std::filesystem::remove(path_);
  }
  Heard(const Heard&) = delete;
  Heard& operator=(const Heard&) = delete;
  void wait_for(const std::string& words) const {
    for (;; std::this_thread::sleep_for(1ms)) {
      std::ifstream file(path_);
      if (std::string(std::istreambuf_iterator<char>(file), {}).find(words) != std::string::npos)
        return;
    }
  }

 private:
  std::string path_;
  int before_;
};

TEST(Run, AJobOutsideOfEveryScenarioIsNamedWhileItRunsAndNoReleaseComes) {
  WithTables f(20'000);
  const Heard heard;
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      f.busy = true;
      ASSERT_TRUE(f.source->publish(0));
      heard.wait_for("outside of every scenario: XNode 'm1' had its XPU for ");
      EXPECT_EQ(f.results, 0);
      f.busy = false;
      f.app.stop();
    });
  });
  const auto report = f.app.run(f.with_tables);
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->releases(), 1u);
  EXPECT_NE(report->json().find("outside of every scenario: XNode 'm1'"), std::string::npos);
}

TEST(Run, EachClockOfNoScenarioIsNamedThoughNoReleaseComes) {
  const std::string clock = ::testing::TempDir() + "clock." + std::to_string(getpid());
  const std::string other = clock + ".other";
  std::ofstream(clock) << "900";
  std::ofstream(other) << "900";
  WithTables f(10'000'000, {{clock, 900, {}, {}}, {other, 900, {}, {}}});
  const Heard heard;
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      f.drive([&] { return f.results > 0; });
      std::ofstream(clock) << "100";
      heard.wait_for("the machine's clocks and modes are those of no scenario: " + clock +
                     " is 100, 'city' needs at least 900");
      std::ofstream(other) << "200";
      heard.wait_for(other + " is 200, 'city' needs at least 900");
      f.app.stop();
    });
  });
  const auto report = f.app.run(f.with_tables);
  driver.join();
  std::filesystem::remove(clock);
  std::filesystem::remove(other);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->releases(), 1u);
  EXPECT_NE(report->json().find(" is 100, 'city' needs at least 900; 'city' is the least"),
            std::string::npos)
      << report->json();
}

TEST(Run, TablesOfAFileAndWhereTheyCannotBe) {
  WithTables f;
  const std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("tables." + std::to_string(getpid()) + ".json");
  std::ofstream(path) << f.text;
  f.app.on_start([&] {
    for (int k = 0; k < 3; ++k) EXPECT_TRUE(f.source->publish(k));
  });
  const auto report = f.app.run(RunOptions(f.with_tables).policy(path).activations(3));
  std::filesystem::remove(path);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_NE(report->json().find("\"scenarios\":[{\"name\":\"city\",\"table\":\"near\""),
            std::string::npos)
      << report->json();
  const auto refused = f.app.run(RunOptions(f.with_tables).scheduling("timeshare"));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().where, "RunOptions::scheduling");
  const auto wrong =
      f.app.run(RunOptions(f.with_tables).policy(R"({"schema": "xauto.tables", "version": 1})"));
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().where.find("RunOptions::policy"), 0u) << wrong.error().to_string();
}

TEST(Run, AModuleUnderAnotherNameAndThenUnderItsOwn) {
  Fixture f("a");
  const auto named = f.app.run(
      f.options(false, "left")
          .deployment(
              R"({"schema": "xauto.deployment", "version": 1, "app": "fixture", "instances": {"left": "M"},
          "modules": {"left": {"remap": {"result": "result"}}}})"));
  ASSERT_TRUE(named) << named.error().to_string();
  EXPECT_TRUE(named->good()) << named->json();
  EXPECT_EQ(named->modules(), std::vector<std::string>{"left"});
  EXPECT_EQ(f.results.load(), 20);
  const auto own = f.app.run(f.options());
  ASSERT_TRUE(own) << own.error().to_string();
  EXPECT_EQ(own->modules(), std::vector<std::string>{"M"});
  EXPECT_EQ(f.results.load(), 40);
}

struct Beat {
  int number = 0;
};

TEST(Run, AModuleFiresByTheClock) {
  Fixture f("a");
  const Topic<int> beats("beats");
  XModule<Beat> loop("LOOP"), twice("TWICE");
  XNode<Beat> count("count");
  std::atomic<int> seen{0};
  count.add_impl(
      XPU::CPU,
      [](const XpuId& id) {
        auto context = emu::Context::open(id).value();
        const SchedHandle handle = context.handle();
        return own(std::make_unique<emu::Context>(std::move(context)), handle);
      },
      [&](emu::Context&, Beat&, const Input& input) {
        EXPECT_LE(seen.load(), static_cast<int>(input.sequence()));
        ++seen;
      });
  f.app.add_module(loop.add_node(count).add_output_topic(beats, &Beat::number));
  loop.every(2ms);  // a handle: also after it was added
  ASSERT_TRUE(f.app.check());
  ASSERT_TRUE(f.app.check()) << "its source is added once";
  const auto report = f.app.run(f.options(true).activations(4));
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_EQ(report->results("LOOP"), 4u) << report->json();
  EXPECT_EQ(seen.load(), 4);
  EXPECT_EQ(report->results("M"), 4u) << "app.json states no rates: they release together";

  App other("b");
  other.add_module(twice.add_node(count).every(1ms).every(2ms));
  const Status wrong = other.check();
  ASSERT_FALSE(wrong);
  EXPECT_NE(wrong.error().what.find("fires by the clock twice"), std::string::npos);
}

/// FIRST -> SECOND, which takes three periods. How often FIRST began before SECOND had ended: the stages' own word.
int times_met(Period period, bool one_at_a_time) {
  const Topic<int> camera("camera"), between("between"), result("result");
  std::atomic<int> open{0}, met{0};
  const auto init = [](const XpuId& id) {
    auto context = emu::Context::open(id).value();
    const SchedHandle handle = context.handle();
    return own(std::make_unique<emu::Context>(std::move(context)), handle);
  };
  XNode<State> begin("begin"), end("end");
  begin.add_impl(XPU::CPU, init, [&](emu::Context&, State&, const Input&) {
    met += open.fetch_add(1) > 0 ? 1 : 0;
  });
  end.add_impl(XPU::CPU, init, [&](emu::Context& context, State&, const Input&) {
    EXPECT_TRUE(context.run(3ms));
    --open;
  });
  XModule<State> first("FIRST"), second("SECOND");
  App app("chain");
  app.add_module(
      first.add_node(begin).add_input_topic(camera).add_output_topic(between, &State::value));
  app.add_module(
      second.add_node(end).add_input_topic(between).add_output_topic(result, &State::value));
  app.add_source(camera, 1ms, [](std::uint64_t k) { return static_cast<int>(k); });

  AppSpec spec;
  spec.name = "chain";
  spec.xnodes = {{"begin", "FIRST", {{"cpu", 100}}}, {"end", "SECOND", {{"cpu", 3000}}}};
  spec.xnodes[0].sources = {0};
  spec.edges = {{0, 1}};
  spec.one_at_a_time = one_at_a_time;
  spec.sources = {{"camera", period}};
  complete_modules(spec);
  complete_chains(spec);
  Platform platform;
  platform.name = "two";
  platform.xpus = {{"cpu0", "cpu"}, {"cpu1", "cpu"}};
  PriorityPlan policy;
  policy.app = spec.name;
  policy.app_hash = spec.hash();
  policy.method = "heft";
  policy.platform = platform.name;
  policy.placements = {{0, 2}, {1, 1}};
  const auto report = app.run(RunOptions()
                                  .app(to_json(spec))
                                  .platform(to_json(platform))
                                  .policy(to_json(by_priorities(policy, spec), spec, platform))
                                  .emulate()
                                  .activations(20));
  EXPECT_TRUE(report && report->results("SECOND") > 0)
      << (report ? report->json() : report.error().to_string());
  return met;
}

TEST(Run, ReleasesMeetWhereTheyHaveARateAndNowhereElse) {
  EXPECT_EQ(times_met(kNoRate, true), 0);
  EXPECT_GT(times_met(Period{1000}, false), 0) << "the same program, which shows that it would see";
}

TEST(Run, TwoAppsSideBySideHaveTheirOwnDaemons) {
  Fixture a("a"), b("b");
  Result<RunReport> of_a = fail(ErrorCode::kInternal, "not run"), of_b = of_a;
  std::thread one([&] { of_a = a.app.run(a.options()); });
  std::thread other([&] { of_b = b.app.run(b.options().activations(30)); });
  one.join();
  other.join();
  ASSERT_TRUE(of_a) << of_a.error().to_string();
  ASSERT_TRUE(of_b) << of_b.error().to_string();
  EXPECT_TRUE(of_a->good()) << of_a->json();
  EXPECT_TRUE(of_b->good()) << of_b->json();
  EXPECT_EQ(a.results.load(), 20);
  EXPECT_EQ(b.results.load(), 30);
}

TEST(Run, StopFromAnotherThreadDrains) {
  Fixture f("a", true);
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      int k = 0;
      while (f.source->publish(k++)) {
        if (k == 40) f.app.stop();
        std::this_thread::sleep_for(1ms);
      }
    });
  });
  const auto report = f.app.run(f.options().activations(0));
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete()) << report->json();
  EXPECT_EQ(report->releases(), static_cast<std::uint64_t>(f.results.load()));
  EXPECT_GT(f.results.load(), 0);
  EXPECT_FALSE(f.source->publish(1));
  f.app.stop();  // nothing runs: nothing happens
}

TEST(Run, WhatIsWrongIsToldAndTheNextRunWorks) {
  Fixture f("a");
  const auto error = [&](const RunOptions& options) {
    const auto report = f.app.run(options);
    EXPECT_FALSE(report);
    return report ? std::string() : report.error().to_string();
  };
  EXPECT_NE(error(RunOptions()).find("RunOptions::app: is needed"), std::string::npos);
  EXPECT_NE(error(f.options().policy("")).find("RunOptions::policy: is needed"), std::string::npos);
  EXPECT_NE(error(f.options().policy("{}")).find("RunOptions::policy"), std::string::npos);
  EXPECT_NE(error(f.options().scheduling("best")).find("'best'"), std::string::npos);
  EXPECT_NE(error(f.options().overload("queue:0")).find("RunOptions::overload"), std::string::npos);
  EXPECT_NE(error(f.options().cpu_sched("ext")).find("xauto run"), std::string::npos);
  EXPECT_NE(error(f.options().real()).find("contradicts"), std::string::npos);
  EXPECT_NE(error(f.options().programs("/nowhere")).find("xauto-coordinator"), std::string::npos);
  EXPECT_NE(error(f.options().deployment(
                      R"({"schema":"xauto.deployment","version":1,"app":"fixture",
                          "defaults":{"isolate":true}})"))
                .find("processes of their own"),
            std::string::npos);
  EXPECT_TRUE(f.app.run(f.options()));
}

TEST(Run, OneAppDoesNotRunTwiceAtOnce) {
  Fixture f("a", true);
  Result<RunReport> second = fail(ErrorCode::kInternal, "not run");
  f.app.on_start([&] {
    std::thread([&] { second = f.app.run(f.options()); }).join();
    f.app.stop();
  });
  ASSERT_TRUE(f.app.run(f.options().activations(0)));
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().what, "it runs already");
}

/// A host that reaps every child, or wants to hear of none, takes our daemons' exit statuses away.
TEST(Run, AHostThatReapsChildrenItselfDoesNotDisturb) {
  struct sigaction ignore {
  }, before{};
  ignore.sa_handler = SIG_IGN;
  sigaction(SIGCHLD, &ignore, &before);
  std::atomic<bool> done{false};
  std::thread reaper([&] {
    while (!done) {
      (void)waitpid(-1, nullptr, WNOHANG);
      std::this_thread::sleep_for(1ms);
    }
  });
  Fixture f("a");
  const auto report = f.app.run(f.options());
  done = true;
  reaper.join();
  sigaction(SIGCHLD, &before, nullptr);
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->good()) << report->json();
}

/// Our children that run `program`; a daemon is a child of the thread that started it.
std::vector<pid_t> children(const std::string& program) {
  std::vector<pid_t> found;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::ifstream list(task.path() / "children");
    for (pid_t pid = 0; list >> pid;) {
      std::string path;
      std::getline(std::ifstream("/proc/" + std::to_string(pid) + "/cmdline"), path, '\0');
      if (path.ends_with("/" + program)) found.push_back(pid);
    }
  }
  return found;
}

TEST(Run, DaemonsThatDieAreStartedAgain) {
  Fixture f("a", true);
  std::thread driver;
  f.app.on_start([&] {
    driver = std::thread([&] {
      const std::vector<pid_t> coordinators = children("xauto-coordinator");
      const std::vector<pid_t> emulators = children("xauto-emud");
      EXPECT_EQ(coordinators.size(), 2u);
      EXPECT_EQ(emulators.size(), 1u);
      for (int k = 0; f.source->publish(k); ++k) {
        const int results = f.results;
        if (k == 5)
          for (const pid_t pid : coordinators) kill(pid, SIGKILL);
        if (k == 10)
          for (const pid_t pid : emulators) kill(pid, SIGKILL);
        if (k == 20) f.app.stop();
        for (int ms = 0; ms < 10'000 && f.results == results && k < 20; ++ms)
          std::this_thread::sleep_for(1ms);
      }
    });
  });
  const auto report = f.app.run(f.options().activations(0));
  driver.join();
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->complete()) << report->json();
  EXPECT_EQ(report->lost(), 0u) << report->json();
  EXPECT_GE(f.results.load(), 20);
  for (const char* who : {"xauto-coordinator of gpu0", "xauto-coordinator of cpu0", "xauto-emud"})
    EXPECT_NE(report->note().find(who), std::string::npos) << report->note();
  EXPECT_TRUE(children("xauto-coordinator").empty());
  EXPECT_TRUE(children("xauto-emud").empty());
}

TEST(Run, AnExecThatNeverReturnsEndsTheRunAndStaysBehind) {
  auto* f = new Fixture("a", true);  // its thread goes on using it
  static std::atomic<Fixture*> left_behind;
  left_behind = f;
  f->block_at = 2;
  f->app.on_start([&] {
    for (int k = 0; k < 3; ++k) EXPECT_TRUE(f->source->publish(k));
  });
  const auto report = f->app.run(f->options().activations(3));
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_FALSE(report->complete());
  EXPECT_EQ(f->results.load(), 2);
  EXPECT_EQ(report->releases(), 3u) << "the one that never ended, too";
  EXPECT_EQ(report->lost(), 1u) << report->json();
  EXPECT_NE(report->note().find("M@gpu0"), std::string::npos) << report->note();
  const auto next = f->app.run(f->options());
  ASSERT_FALSE(next);
  EXPECT_EQ(next.error().what, "an exec of its last run never returned");
  // Another app of this process is not concerned.
  Fixture other("b");
  const auto of_other = other.app.run(other.options());
  ASSERT_TRUE(of_other) << of_other.error().to_string();
  EXPECT_TRUE(of_other->good()) << of_other->json();
}

TEST(Run, SignalHandlersOfTheHostAreLeftAlone) {
  Fixture f("a");
  struct sigaction mine {
  }, after{};
  mine.sa_handler = [](int) {};
  struct sigaction before {};
  sigaction(SIGTERM, &mine, &before);
  ASSERT_TRUE(f.app.run(f.options()));
  sigaction(SIGTERM, nullptr, &after);
  EXPECT_EQ(after.sa_handler, mine.sa_handler);
  sigaction(SIGTERM, &before, nullptr);
}

TEST(Run, ContextsOutsideOfInitAndExecHaveNoEmulator) {
  const auto context = emu::Context::open({"gpu0", XPU::GPU, 0});
  ASSERT_FALSE(context);
  EXPECT_EQ(context.error().code, ErrorCode::kUnavailable);
}

/// Its state holds what `init` loads, `exec` takes the state alone, a module names its topic.
TEST(Run, ThePapersListingRuns) {
  struct Camera {
    std::shared_ptr<emu::Context> context;
    int value = 0;
  };
  App app("x");
  const auto init = [](Camera& state, const XpuId& xpu) {
    auto context = emu::Context::open(xpu);
    if (!context) throw std::runtime_error(context.error().to_string());
    state.context = std::make_shared<emu::Context>(std::move(*context));
    return state.context->handle();
  };
  XNode<Camera> m1("m1"), m2("m2");
  m1.add_impl(XPU::GPU, init, [](Camera& state) { return state.context->run(100us); });
  m2.add_impl(
      XPU::CPU,
      [](Camera&, const XpuId& xpu) {
        auto context = emu::Context::open(xpu);
        if (!context) throw std::runtime_error(context.error().to_string());
        const SchedHandle handle = context->handle();
        return own(std::make_unique<emu::Context>(std::move(*context)), handle);
      },
      [](emu::Context& context, Camera& state, const Input& input) {
        state.value = input.get<int>("camera");
        return context.run(100us);
      });
  const Topic<int> result("result");
  app.add_module(
      XModule<Camera>("M").add_node(m1).add_node(m2).add_input_topic("camera").add_output_topic(
          result, &Camera::value));
  app.add_source(Topic<int>("camera"), 1ms, [](std::uint64_t k) { return static_cast<int>(k); });
  std::atomic<int> sum{0};
  app.on_message(result, [&](const int& value, std::uint64_t) { sum += value; });
  const auto report = app.run(Fixture("a").options());
  ASSERT_TRUE(report) << report.error().to_string();
  EXPECT_TRUE(report->good()) << report->json();
  EXPECT_EQ(sum.load(), 190);
}

TEST(Run, AFailingInitIsTheRunsError) {
  App app("x");
  const Topic<int> camera("camera");
  XNode<State> m1("m1"), m2("m2");
  m1.add_impl(
      XPU::GPU, [](const XpuId&) -> SchedHandle { throw std::runtime_error("no weights"); },
      [](State&, const Input&) {});
  m2.add_impl(
      XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); }, [](State&, const Input&) {});
  XModule<State> module("M");
  module.add_node(m1).add_node(m2).add_input_topic(camera);
  app.add_module(module).add_source(camera, 1ms, [](std::uint64_t) { return 0; });
  const Fixture f("a");
  const auto report = app.run(f.options());
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().where, "init of XNode 'm1' on gpu0");
  EXPECT_EQ(report.error().what, "threw: no weights");
}

}  // namespace
}  // namespace xauto
