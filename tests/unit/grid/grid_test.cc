// SPDX-License-Identifier: Apache-2.0
// The time line of the releases, and what a run by keys refuses.
#include "grid/grid.h"

#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "model/periodic.h"

namespace xauto::runtime {
namespace {

/// front, rear -> A ─► B;  tick -> C, which samples B's. B also hears rear.
class Example {
 public:
  Example() {
    for (const char* name : {"front", "rear", "tick"}) {
      detail::SourceSpec source;
      source.topic = *detail::topic_spec(Topic<int>(name));
      source.period = {33'333};
      source.make = [](std::uint64_t, detail::MessageMemory*) {
        return std::make_shared<const int>(0);
      };
      spec_.sources.push_back(source);
    }
    module("A", {"front", "rear"}, {}, "a");
    module("B", {"a", "rear"}, {}, "b");
    module("C", {"tick"}, {"b"}, "c");

    AppSpec& app = session.app;
    app.name = "example";
    app.sources = {{"front", {100'000, 3}, 2000, 0, 0},
                   {"rear", {100'000, 3}, 5000, 0, 0},
                   {"tick", {20'000}, 0, 0, 0}};
    app.xnodes = {{"A1", "A", {{"cpu", 1000}}, {0, 1}},
                  {"B1", "B", {{"cpu", 1000}}},
                  {"C1", "C", {{"cpu", 1000}}, {2}}};
    app.edges = {{0, 1}};
    app.samples = {{1, 2}};
    complete_modules(app);
    complete_chains(app);
    session.keys.emplace();
    session.keys->placements = {{0, {10'000}}, {0, {200'000}}, {0, {5'000}}};
  }

  [[nodiscard]] Graph graph() const { return Graph::build(spec_).value(); }
  [[nodiscard]] Result<Grid> grid() const { return Grid::make(graph(), session); }
  [[nodiscard]] std::string refusal() const {
    const auto made = grid();
    return made ? "" : made.error().what;
  }

  Session session;

 private:
  void module(const char* name, const std::vector<std::string>& inputs,
              const std::vector<std::string>& samples, const std::string& output) {
    auto spec = std::make_shared<detail::XModuleSpec>();
    spec->name = name;
    spec->make_state = [] { return std::make_shared<int>(); };
    auto node = detail::make_xnode(std::string(name) + "1");
    detail::add_impl(
        *node, XPU::CPU,
        {[](auto&&...) { return SchedHandle::gate(); }, [](auto&&...) { return Status(); }});
    spec->nodes.push_back(node);
    for (const std::string& input : inputs)
      spec->inputs.push_back(*detail::topic_spec(Topic<int>(input)));
    for (const std::string& sample : samples)
      spec->samples.push_back({*detail::topic_spec(Topic<int>(sample)), 0});
    spec->outputs.push_back({*detail::topic_spec(Topic<int>(output)), {}});
    spec_.modules.push_back(spec);
  }
  detail::AppSpecErased spec_;
};

TEST(Grid, ReleasesDoNotDrift) {
  const Grid::Source camera{{100'000, 3}, 2'000'000, 0};  // 30 Hz
  EXPECT_EQ(camera.due_ns(0), 2'000'000);
  EXPECT_EQ(camera.due_ns(1), 35'333'333);
  EXPECT_EQ(camera.due_ns(3), 102'000'000);
  EXPECT_EQ(camera.due_ns(30ull * 3600 * 24 * 365), 2'000'000 + 3600ll * 24 * 365 * 1'000'000'000);
  const Grid::Source ntsc{{100'100, 3}, 0, 0};  // 30000/1001 Hz
  EXPECT_EQ(ntsc.due_ns(30'000), 1001ll * 1'000'000'000);
}

TEST(Grid, IsAppJsonsWhereTheProgramSaysOtherwise) {
  const Example example;
  const auto grid = example.grid();
  ASSERT_TRUE(grid) << grid.error().to_string();
  EXPECT_TRUE(grid->periodic);
  EXPECT_EQ(grid->sources[0].due_ns(3), 102'000'000);
  // The component is released with front, the earlier of the two; rear's message is 3 ms younger.
  EXPECT_EQ(grid->shift_ns[0], (std::vector<std::int64_t>{0, 3'000'000}));
  EXPECT_EQ(grid->shift_ns[1], (std::vector<std::int64_t>{0, 3'000'000}));
  EXPECT_EQ(grid->shift_ns[2], (std::vector<std::int64_t>{0}));
  EXPECT_EQ(grid->depth[1], 200'000u / 33'333 + 2) << "so many releases come within B's key";
}

TEST(Grid, RefusesWhatWouldNotBeThePlan) {
  Example example;
  example.session.releases.period_us = 1000;
  EXPECT_NE(example.refusal().find("would change what the policy was made for"), std::string::npos);
  example.session.releases.period_us = 0;
  example.session.app.modules[1].max_in_flight = 2;
  EXPECT_NE(example.refusal().find("XModule 'B' has max_in_flight 2"), std::string::npos);
  example.session.app.modules[1].max_in_flight = 1;
  example.session.app.sources[2].name = "tock";
  EXPECT_NE(example.refusal().find("has no source 'tick'"), std::string::npos);
}

/// B fires by A's and by rear. A waits for rear, too, so the plan knows when B is ready. It would
/// not if A did not.
TEST(Grid, RefusesAJoinThatThePlanDoesNotKnow) {
  Example example;
  EXPECT_EQ(example.refusal(), "");
  Graph graph = example.graph();
  graph.modules[0].inputs = {0};  // A no longer hears rear
  const auto late = Grid::make(graph, example.session);
  ASSERT_FALSE(late);
  EXPECT_NE(late.error().what.find("XModule 'B' fires by topic 'rear'"), std::string::npos);
  example.session.app.sources[1].offset_us = 2000;  // with front, and never late
  EXPECT_TRUE(Grid::make(graph, example.session));
  example.session.app.sources[1].jitter_us = 1;
  EXPECT_FALSE(Grid::make(graph, example.session));
}

TEST(Grid, WithoutRatesAllReleaseAtTheProgramsLongestPeriod) {
  Example example;
  AppSpec& app = example.session.app;
  app.one_at_a_time = true;
  for (SourceSpec& source : app.sources) source = {source.name, kNoRate};
  const auto grid = example.grid();
  ASSERT_TRUE(grid) << grid.error().to_string();
  EXPECT_TRUE(grid->periodic);
  EXPECT_TRUE(grid->one_at_a_time);
  std::int64_t longest = 0;
  for (const SourceSpec& source : example.graph().sources)
    longest = std::max(longest, source.period.floor_us());
  for (const Grid::Source& source : grid->sources)
    EXPECT_NEAR(static_cast<double>(source.period_ns()), 1000.0 * static_cast<double>(longest),
                1000);
  example.session.releases.period_us = 7;
  EXPECT_EQ(example.grid()->sources[0].due_ns(2), 14'000);
}

}  // namespace
}  // namespace xauto::runtime
