// SPDX-License-Identifier: Apache-2.0
// Reactions and stories of a run that is small enough to know every number of by heart.
#include "story/reactions.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "story/chain_story.h"
#include "story/run_trace.h"
#include "story/trace_reader.h"

namespace xauto::story {
namespace {

constexpr std::uint16_t kUnset = XAUTO_EV_NONE;

/// CAM (cam.x, camera every 10 ms, released 2 ms after the grid) is sampled by CTL (ctl.x, ctl.y,
/// tick every 5 ms), and samples what CTL did: a circle.
struct Loop {
  AppSpec app;
  Platform platform{"p", {{"cpu0", "cpu"}, {"cpu1", "cpu"}}};
  Scene scene;
  Policy keys;
  trace::Recording trace;

  Loop() {
    app.name = "loop";
    app.sources = {{"camera", {10'000}, 2'000}, {"tick", {5'000}}};
    app.xnodes = {{"cam.x", "CAM", {{"cpu", 1'000}}, {0}},
                  {"ctl.x", "CTL", {{"cpu", 400}}, {1}},
                  {"ctl.y", "CTL", {{"cpu", 100}}}};
    app.edges = {{1, 2}};
    app.modules = {{"CAM", 2}, {"CTL"}};
    app.samples = {{0, 1}, {2, 0}};
    app.chains = {{"see", 0, 2}, {"beat", 1, 2}, {"inside", 1, 1}};
    keys = {"loop",
            app.hash(),
            "p",
            "test",
            {{0, {3'000, 4'000}, {500}}, {1, {1'000}}, {1, {1'500}}},
            {{"see", 9'000, 100}, {"beat", 1'500, 500}, {"inside", 1'000, 400}},
            0};
    scene.title = "loop on p";
    scene.rows = {{"cpu0", true}, {"cpu1", true}};
    scene.row_of = {0, 1};
    scene.modules = {{"CAM", false}, {"CTL", true}};
    scene.keys = &keys;
    scene.claims = keys.chains;
    scene.verdict = "worst cases: kept";
  }
  void at(std::int64_t us, std::uint16_t kind, std::uint64_t seq, std::uint16_t module = kUnset,
          std::uint16_t xnode = kUnset, std::uint16_t xpu = kUnset, std::uint32_t arg = 0) {
    trace.events.push_back(
        {static_cast<std::uint64_t>(1'000'000 + us * 1000), seq, xnode, module, xpu, kind, arg, 0});
  }
  static std::uint64_t ns(std::int64_t us) {
    return static_cast<std::uint64_t>(1'000'000 + us * 1000);
  }
  void release(int source, std::uint64_t k, std::uint32_t mark = 0) {
    at(source == 0 ? 2'000 + static_cast<std::int64_t>(k) * 10'000
                   : static_cast<std::int64_t>(k) * 5'000,
       XAUTO_EV_PUBLISH, k, kUnset, kUnset, kUnset,
       XAUTO_TAKE_SOURCE | mark | static_cast<std::uint32_t>(source));
  }
  /// Taken at `us`, run from `begin` to `end`; `read`: the number of CTL's that it samples.
  void camera(std::uint64_t k, std::int64_t us, std::int64_t begin, std::int64_t end,
              std::uint64_t read = XAUTO_SAMPLE_NONE) {
    at(us, XAUTO_EV_ACTIVATE, k, 0);
    at(us, XAUTO_EV_TAKE, ns(2'000 + static_cast<std::int64_t>(k) * 10'000), 0, kUnset, kUnset,
       XAUTO_TAKE_SOURCE);
    at(us, XAUTO_EV_READY, k, 0, 0, 0);
    at(begin, XAUTO_EV_SAMPLE, read, 0, kUnset, kUnset, 1);
    at(begin, XAUTO_EV_RUN, k, 0, 0, 0);
    at(end, XAUTO_EV_FINISH, k, 0, 0, 0);
    at(end + 1, XAUTO_EV_DONE, k, 0);
  }
  void control(std::uint64_t k, std::int64_t begin, std::uint64_t read, bool told = true) {
    const std::int64_t us = static_cast<std::int64_t>(k) * 5'000;
    at(us, XAUTO_EV_ACTIVATE, k, 1);
    at(us, XAUTO_EV_TAKE, ns(us), 1, kUnset, kUnset, XAUTO_TAKE_SOURCE | 1);
    at(us, XAUTO_EV_READY, k, 1, 1, 1);
    if (told) at(begin, XAUTO_EV_SAMPLE, read, 1, kUnset, kUnset, 0);
    at(begin, XAUTO_EV_RUN, k, 1, 1, 1);
    at(begin + 400, XAUTO_EV_FINISH, k, 1, 1, 1);
    at(begin + 400, XAUTO_EV_READY, k, 1, 2, 1);
    at(begin + 410, XAUTO_EV_RUN, k, 1, 2, 1);
    at(begin + 500, XAUTO_EV_FINISH, k, 1, 2, 1);
    at(begin + 501, XAUTO_EV_DONE, k, 1);
  }
  /// `urgent`: the camera's release that is.
  void run(int urgent = -1) {
    for (std::uint64_t k = 0; k < 6; ++k) release(1, k);
    for (std::uint64_t k = 0; k < 3; ++k)
      release(0, k, static_cast<int>(k) == urgent ? XAUTO_RELEASE_URGENT : 0);
    control(0, 10, XAUTO_SAMPLE_NONE);
    camera(0, 2'010, 2'500, 3'400, 0);
    control(1, 5'020, 0);
    control(2, 10'030, 0);
    camera(1, 12'010, 12'500, 15'900, 2);  // ends after CTL 3 has read
    control(3, 15'010, 0);
    control(4, 20'010, 1);
    std::stable_sort(trace.events.begin(), trace.events.end(),
                     [](const auto& a, const auto& b) { return a.ts_ns < b.ts_ns; });
  }
  [[nodiscard]] Story story() const {
    const auto story = story_of(app, platform, scene.modules, trace);
    EXPECT_TRUE(story) << story.error().to_string();
    return *story;
  }
  [[nodiscard]] std::vector<std::string> reactions() const {
    std::vector<std::string> lines;
    for (const Reaction& r : reactions_of(app, story()))
      lines.push_back(app.chains[static_cast<std::size_t>(r.chain)].name + " " +
                      std::to_string(r.number) + " " + std::to_string(r.us()));
    return lines;
  }
};

using Lines = std::vector<std::string>;

TEST(Reactions, EndWithTheFirstJobThatKnowsTheRelease) {
  Loop loop;
  loop.run();
  // CTL's own message comes back to it through CAM: that is not taken for something old. The first
  // of the camera that it hears of is not counted: it had not begun before.
  EXPECT_EQ(loop.reactions(), (Lines{"see 1 8511", "beat 0 511", "beat 1 521", "beat 2 531",
                                     "beat 3 511", "beat 4 511", "inside 0 410", "inside 1 420",
                                     "inside 2 430", "inside 3 410", "inside 4 410"}));
}

TEST(Reactions, AReleaseThatNoResultHadCountsUntilTheNextOne) {
  Loop loop;
  for (std::uint64_t k : {0, 1, 2}) loop.release(0, k);
  for (std::uint64_t k : {0, 6}) loop.release(1, k);
  loop.camera(0, 2'010, 2'500, 3'400);
  loop.control(1, 5'020, 0);
  loop.camera(2, 22'010, 22'500, 23'400);
  loop.control(6, 30'000, 2);
  std::stable_sort(loop.trace.events.begin(), loop.trace.events.end(),
                   [](const auto& a, const auto& b) { return a.ts_ns < b.ts_ns; });
  const Lines lines = loop.reactions();
  EXPECT_EQ((Lines{lines.begin(), lines.begin() + 2}), (Lines{"see 1 18501", "see 2 8501"}));
}

TEST(Reactions, WhatTheTraceDoesNotTellIsLeftOut) {
  Loop loop;
  loop.run();
  loop.trace.overwritten = 5;  // what CTL 1 knew may have been known before
  EXPECT_EQ(loop.reactions().front(), "see 1 8511");
  // The activation that published what CTL 4 has read is gone: nothing is said of it.
  std::erase_if(loop.trace.events, [](const auto& e) {
    return e.module == 0 && e.seq == 1 && e.kind == XAUTO_EV_DONE;
  });
  EXPECT_NE(loop.reactions().front().substr(0, 3), "see");
  loop.app.sources.clear();  // nothing is known of when
  EXPECT_TRUE(reactions_of(loop.app, loop.story()).empty());
}

TEST(Reactions, AWindowIsFromReleaseAndHoldToTheKey) {
  Loop loop;
  loop.run();
  const Story story = loop.story();
  std::size_t seen = 0;
  for (const JobStory& job : story.jobs) {
    const auto window = window_of(loop.app, loop.keys, story, job);
    ASSERT_TRUE(window);
    const std::int64_t n = static_cast<std::int64_t>(job.sequence);
    if (job.xnode == 0) {  // its component's only source: the offset is the component's
      EXPECT_EQ(window->begin_ns, 1'000'000 + (2'000 + n * 10'000 + 500) * 1000);
      EXPECT_EQ(window->key_ns, 1'000'000 + (2'000 + n * 10'000 + (n == 1 ? 4'000 : 3'000)) * 1000);
    } else {
      EXPECT_EQ(window->begin_ns, 1'000'000 + n * 5'000 * 1000);
    }
    ++seen;
  }
  EXPECT_EQ(seen, 12u);
}

/// What hears of it by edges; not CTL, which samples.
TEST(Reactions, KeysAndHoldsOfAnUrgentReleaseAreEarlier) {
  Loop loop;
  loop.app.chains.push_back({"alone", 0, 0});
  loop.run(1);
  // A mark that app.json does not allow is the trace's error.
  EXPECT_FALSE(loop.story().releases.front().urgent);
  for (const Activation& a : loop.story().activations) EXPECT_EQ(a.urgent_source, -1);
  loop.app.sources[0].urgent = UrgentSpec{600, 10'000};
  const Story story = loop.story();
  int seen = 0;
  for (const JobStory& job : story.jobs) {
    const bool urgent = job.xnode == 0 && job.sequence == 1;
    EXPECT_EQ(story.activations[static_cast<std::size_t>(job.activation)].urgent_source,
              urgent ? 0 : -1);
    if (!urgent) continue;
    ++seen;
    const auto window = window_of(loop.app, loop.keys, story, job);
    ASSERT_TRUE(window);
    EXPECT_EQ(window->begin_ns, window->released_ns);  // a hold of 500 us: no longer than that
    EXPECT_EQ(window->key_ns, window->released_ns + 3'400'000);
  }
  EXPECT_EQ(seen, 1);
  for (const Reaction& r : reactions_of(loop.app, story))
    EXPECT_EQ(r.urgent, r.chain == 3 && r.number == 1) << r.chain << " " << r.number;
}

/// Two activations of CAM are in flight, and end in order.
TEST(Reactions, SeveralActivationsInFlightAreKeptApart) {
  Loop loop;
  loop.release(0, 0), loop.release(0, 1);
  for (const std::uint64_t k : {0, 1}) {
    const auto us = static_cast<std::int64_t>(k) * 10'000;
    loop.at(2'010 + us, XAUTO_EV_ACTIVATE, k, 0);
    loop.at(2'010 + us, XAUTO_EV_TAKE, Loop::ns(2'000 + us), 0, kUnset, kUnset, XAUTO_TAKE_SOURCE);
    loop.at(2'020 + us, XAUTO_EV_READY, k, 0, 0, 0);
  }
  loop.at(13'000, XAUTO_EV_RUN, 0, 0, 0, 0);
  loop.at(14'000, XAUTO_EV_FINISH, 0, 0, 0, 0);
  loop.at(14'001, XAUTO_EV_DONE, 0, 0);
  loop.at(14'010, XAUTO_EV_RUN, 1, 0, 0, 0);
  loop.at(15'000, XAUTO_EV_FINISH, 1, 0, 0, 0);
  loop.at(15'001, XAUTO_EV_DONE, 1, 0);
  const Story story = loop.story();
  ASSERT_EQ(story.activations.size(), 2u);
  ASSERT_EQ(story.jobs.size(), 2u);
  for (std::size_t k = 0; k < 2; ++k) {
    EXPECT_EQ(story.activations[k].fate, Fate::kDone);
    EXPECT_TRUE(story.jobs[k].complete);
    EXPECT_EQ(story.jobs[k].activation, static_cast<int>(k));
  }
  const auto bytes = perfetto_trace(loop.app, loop.scene, story, 0);
  ASSERT_TRUE(bytes) << bytes.error().to_string();
  EXPECT_TRUE(read_trace(*bytes, "t"));
  // With one state two are a damaged trace: the first one's end is unknown.
  loop.app.modules[0].max_in_flight = 1;
  EXPECT_EQ(loop.story().activations[0].fate, Fate::kUnknown);
}

struct Told : Loop {
  ReadTrace read;
  Told() {
    run();
    const auto bytes = perfetto_trace(app, scene, story(), 0);
    EXPECT_TRUE(bytes) << bytes.error().to_string();
    auto back = read_trace(bytes.value_or(std::string()), "t");
    EXPECT_TRUE(back) << back.error().to_string();
    read = std::move(*back);
  }
};

TEST(ChainStory, GoesBackThroughSamplesToTheSensors) {
  const Told told;
  ASSERT_EQ(told.read.reactions.size(), 3u);
  EXPECT_EQ(told.read.verdict, "worst cases: kept");
  const TraceReactions& see = told.read.reactions.front();
  EXPECT_EQ(see.note, "from source camera; worst case 9000 us, bound 100 us");
  const auto story = story_of(told.read, see, *worst_of(see));
  ASSERT_TRUE(story) << story.error().to_string();
  EXPECT_EQ(story->number, 1);
  EXPECT_EQ(story->reaction_us, 8'511);
  EXPECT_EQ(story->of, 1);
  // CTL 4 read CAM 1, which had read CTL 2, which had read CAM 0, which had read CTL 0.
  Lines jobs;
  for (const StoryJob& job : story->jobs)
    jobs.push_back(job.xnode + " " + std::to_string(job.number));
  EXPECT_EQ(jobs, (Lines{"ctl.x 0", "ctl.y 0", "cam.x 0", "ctl.x 2", "ctl.y 2", "cam.x 1",
                         "ctl.x 4", "ctl.y 4"}));
  const StoryJob& ctl = story->jobs[6];
  EXPECT_EQ(ctl.xpu, "cpu1");
  EXPECT_EQ(ctl.ready_us, 8'000);
  EXPECT_EQ(ctl.began_us, 8'010);
  EXPECT_EQ(ctl.ended_us, 8'410);
  EXPECT_EQ(ctl.ran_us, 400);
  EXPECT_EQ(ctl.released_us, 8'000);
  EXPECT_EQ(ctl.key_us, 9'000);
  EXPECT_EQ(ctl.lateness_us, -590);
  ASSERT_EQ(ctl.reads.size(), 1u);
  EXPECT_EQ(ctl.reads[0].read, "CAM");
  EXPECT_EQ(ctl.reads[0].number, 1);
  EXPECT_EQ(ctl.reads[0].age_us, 8'010);
  const StoryJob& cam = story->jobs[5];
  EXPECT_EQ(cam.lateness_us, 15'900 - (12'000 + 4'000));
  EXPECT_EQ(story->jobs[0].reads[0].number, -1);
  Lines sensors;
  for (const StorySensor& s : story->sensors)
    sensors.push_back(s.source + " " + std::to_string(s.number) + " " +
                      std::to_string(s.released_us));
  EXPECT_EQ(sensors, (Lines{"tick 0 -12000", "camera 0 -10000", "tick 2 -2000", "camera 1 0",
                            "tick 4 8000"}));
  const std::string text = story_text(*story);
  EXPECT_NE(text.find("see: release 1 took 8.511 ms, the longest of 1"), std::string::npos) << text;
  EXPECT_NE(text.find("read CAM 1, 8.010 ms after its release"), std::string::npos) << text;
  EXPECT_NE(text.find("read of CAM: nothing"), std::string::npos) << text;
}

/// "running 8410..8510 ctl.y", of a release's whole time.
Lines way_of(const ChainStory& story) {
  Lines lines;
  for (const Spent& spent : story.way)
    lines.push_back(
        std::string(to_string(spent.on)) + " " + std::to_string(spent.begin_us) + ".." +
        std::to_string(spent.end_us) +
        (spent.job < 0 ? "" : " " + story.jobs[static_cast<std::size_t>(spent.job)].xnode));
  return lines;
}

/// By hand, from the events of Loop::run: CAM 1 is ready at 12.010, runs from 12.500 to 15.900, and CTL 4 at 20 reads it.
TEST(ChainStory, AllTimeOfAReleaseIsAccountedFor) {
  Loop loop;
  loop.run();
  const auto finish = std::find_if(
      loop.trace.events.begin(), loop.trace.events.end(),
      [](const auto& e) { return e.kind == XAUTO_EV_FINISH && e.module == 0 && e.seq == 1; });
  trace::Event others = *finish;
  others.kind = XAUTO_EV_NO_CORE;
  others.arg = 300;
  loop.trace.events.insert(finish, others);
  const auto bytes = perfetto_trace(loop.app, loop.scene, loop.story(), 0);
  ASSERT_TRUE(bytes);
  const auto read = read_trace(*bytes, "t");
  ASSERT_TRUE(read);
  const TraceReactions& see = read->reactions.front();
  const auto story = story_of(*read, see, *worst_of(see));
  ASSERT_TRUE(story);
  EXPECT_EQ(
      way_of(*story),
      (Lines{"source late 0..10", "waiting 10..500 cam.x", "running 500..3600 cam.x",
             "not run by the kernel 3600..3900 cam.x", "made, and not yet taken 3900..8000 cam.x",
             "waiting 8000..8010 ctl.x", "running 8010..8410 ctl.x", "waiting 8410..8420 ctl.y",
             "running 8420..8510 ctl.y", "made, and not yet taken 8510..8511 ctl.y"}));
  EXPECT_EQ(way_text(*story),
            "8.511 ms: 4.101 made, and not yet taken, 3.590 running, 0.510 waiting, "
            "0.300 not run by the kernel");
  EXPECT_NE(reasons_of(story->jobs[5]).find("for 0.300 ms the kernel ran others on its core"),
            std::string::npos);
}

TEST(ChainStory, WhatIsDamagedIsRefused) {
  Told told;
  TraceReactions& see = told.read.reactions.front();
  see.releases.front().activation = 77;
  const auto story = story_of(told.read, see, see.releases.front());
  ASSERT_FALSE(story);
  EXPECT_NE(story.error().to_string().find("see, release 1"), std::string::npos);
  see.releases.clear();
  EXPECT_EQ(worst_of(see), nullptr);
}

/// A camera's release comes 48 ms late. The planner's timer fired before, so it found the one before; what it
/// reads next is made of the release after.
TEST(ChainStory, TellsTheReleaseThatCameLateAndWhoReadTooEarly) {
  constexpr std::int64_t kMs = 1'000'000;
  ReadTrace trace;
  trace.rows = {"cpu0", "cpu1"};
  trace.releases = {{5, 0, "camera"}, {6, 50 * kMs, "camera"}};
  const auto job = [&](const std::string& name, int row, std::int64_t n, std::int64_t begin_ms,
                       std::int64_t end_ms) -> TraceSlice& {
    TraceSlice slice;
    slice.name = slice.module = name;
    slice.category = "run";
    slice.row = row;
    slice.begin_ns = begin_ms * kMs;
    slice.end_ns = end_ms * kMs;
    slice.release = n;
    slice.activation = static_cast<std::int64_t>(trace.run.size());
    trace.run.push_back(slice);
    return trace.run.back();
  };
  TraceSample nothing_new{"det", 4, 40 * kMs, -1, -1, -1};
  job("plan", 1, 1, 40, 42).samples = {nothing_new};
  TraceSlice& late = job("det", 0, 5, 48, 49);
  late.releases = {0};
  late.released_ns = 1;  // 0 is "not told"
  TraceSlice& next = job("det", 0, 6, 51, 52);
  next.releases = {1};
  TraceSample newest{"det", 6, 90 * kMs, 40'000, 2, -1};
  job("plan", 1, 2, 90, 95).samples = {newest};
  TraceReactions chain{"see", "", -1, {{5, 0, 95'000, "plan", 3, false}}};
  const auto story = story_of(trace, chain, chain.releases.front());
  ASSERT_TRUE(story.has_value()) << story.error().to_string();
  ASSERT_EQ(story->jobs.size(), 2U);
  ASSERT_EQ(story->own.size(), 1U);
  EXPECT_EQ(story->own[0].number, 5);
  EXPECT_EQ(reasons_of(story->own[0]), "its source came 48.000 ms after the release");
  ASSERT_EQ(story->missed.size(), 1U);
  EXPECT_EQ(story->missed[0].number, 1);
  const std::string text = story_text(*story);
  EXPECT_NE(text.find("its source came 48.000 ms after"), std::string::npos) << text;
  EXPECT_NE(text.find("without release 5:"), std::string::npos) << text;
  EXPECT_EQ(way_of(*story),
            (Lines{"missed, waiting for the next release 0..50000", "source late 50000..51000",
                   "running 51000..52000 det", "made, and not yet taken 52000..90000 det",
                   "running 90000..95000 plan"}));
}

TEST(ChainStory, WaitingIsSaidWithTheShareOfEach) {
  EXPECT_EQ(waited_text(100, {}), "waited 0.100 ms, nobody had the XPU");
  EXPECT_EQ(waited_text(100, {{"a", 95}}), "waited 0.100 ms for a");
  EXPECT_EQ(waited_text(100, {{"a", 30}}),
            "waited 0.100 ms for a (0.030); for 0.070 ms of it nobody had the XPU");
  EXPECT_EQ(waited_text(50, {{"a", 20}, {"b", 10}, {"c", 9}, {"d", 6}, {"e", 5}}),
            "waited 0.050 ms for a (0.020), b (0.010), c (0.009) and 2 others");
}

TEST(ChainStory, AHoldIsTheReasonUntilItEnds) {
  StoryJob job;
  job.ready_us = 1'000;
  job.held_until_us = 3'000;
  job.began_us = 3'500;
  job.ended_us = 4'500;
  job.ran_us = 1'000;
  EXPECT_EQ(reasons_of(job), "held until 3.000 by its policy; waited 0.500 ms, nobody had the XPU");
  job.began_us = 3'010;
  job.ended_us = 4'010;
  EXPECT_EQ(reasons_of(job), "held until 3.000 by its policy");
  job.held_until_us = 900;
  EXPECT_EQ(reasons_of(job), "waited 2.010 ms, nobody had the XPU");
}

}  // namespace
}  // namespace xauto::story
