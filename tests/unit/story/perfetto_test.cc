// SPDX-License-Identifier: Apache-2.0
// Trace files read back: by the generated classes, by protoc with the schema (the golden) and by
// protoc without it. Perfetto's own trace_processor is no Debian package.
#include "story/perfetto.h"

#include <cstdlib>
#include <fstream>
#include <map>
#include <random>
#include <set>

#include <gtest/gtest.h>
#include <unistd.h>

#include "story/page.h"
#include "story/perfetto.pb.h"
#include "story/trace_reader.h"

#include "../golden_cases.h"
#include "tiny_run.h"

namespace xauto::story {
namespace {

namespace proto = ::xauto::perfetto;
using test::golden;
using test::kNone;
using test::slurp;
using test::Tiny;

struct Slice {
  std::string name;
  std::uint64_t begin = 0, end = 0;
  int depth = 0;
  std::map<std::string, std::string> args;
};

/// The file as a viewer reads it. Fails the test on whatever a viewer would have to repair.
struct Viewed {
  std::map<std::uint64_t, std::string> names;
  std::map<std::uint64_t, std::uint64_t> parents;
  std::map<std::string, std::vector<Slice>> slices;  ///< by track's path
  std::map<std::string, std::vector<std::pair<std::uint64_t, std::int64_t>>> counters;
  std::vector<std::string> instants;
  struct End {
    std::uint64_t ts;
    std::string name;
  };
  std::map<std::uint64_t, std::pair<End, End>> flows;
  bool lossy = false;
  int packets = 0;

  std::string path(std::uint64_t track) const {
    const auto parent = parents.find(track);
    return (parent == parents.end() ? "" : path(parent->second) + "/") + names.at(track);
  }

  explicit Viewed(const std::string& bytes) { read(bytes); }
  void read(const std::string& bytes) {
    proto::Trace trace;
    EXPECT_TRUE(trace.ParseFromString(bytes));
    packets = trace.packet_size();
    std::map<std::uint64_t, std::vector<Slice>> open;
    std::uint64_t last = 0;
    std::set<std::uint64_t> sources, sinks;
    EXPECT_TRUE(trace.packet_size() > 0 && trace.packet(0).first_packet_on_sequence());
    lossy = trace.packet_size() > 0 && trace.packet(0).previous_packet_dropped() != 0;
    for (const proto::TracePacket& packet : trace.packet()) {
      EXPECT_NE(packet.trusted_packet_sequence_id(), 0u);
      if (packet.first_packet_on_sequence()) last = 0;  // a file that was put behind
      if (packet.has_track_descriptor()) {
        const auto& track = packet.track_descriptor();
        EXPECT_TRUE(names.emplace(track.uuid(), track.name()).second);
        if (track.has_parent_uuid()) {
          EXPECT_TRUE(names.count(track.parent_uuid())) << "the parent comes first";
          parents[track.uuid()] = track.parent_uuid();
        }
        continue;
      }
      const auto& event = packet.track_event();
      ASSERT_TRUE(names.count(event.track_uuid()));
      EXPECT_GE(packet.timestamp(), last) << "times go forward";
      last = packet.timestamp();
      auto& stack = open[event.track_uuid()];
      switch (event.type()) {
        case proto::TrackEvent::TYPE_SLICE_BEGIN: {
          EXPECT_FALSE(event.name().empty());
          Slice slice{event.name(), last, 0, static_cast<int>(stack.size()), {}};
          for (const auto& arg : event.debug_annotations())
            slice.args[arg.name()] =
                arg.has_string_value() ? arg.string_value() : std::to_string(arg.int_value());
          stack.push_back(std::move(slice));
          break;
        }
        case proto::TrackEvent::TYPE_SLICE_END:
          ASSERT_FALSE(stack.empty()) << "an end without a begin on " << path(event.track_uuid());
          stack.back().end = last;
          slices[path(event.track_uuid())].push_back(std::move(stack.back()));
          stack.pop_back();
          break;
        case proto::TrackEvent::TYPE_INSTANT:
          instants.push_back(event.name());
          break;
        case proto::TrackEvent::TYPE_COUNTER:
          counters[path(event.track_uuid())].emplace_back(last, event.counter_value());
          break;
        default:
          ADD_FAILURE() << "event of no type";
      }
      for (const std::uint64_t flow : event.flow_ids()) {
        EXPECT_TRUE(sources.insert(flow).second) << "an arrow begins once";
        flows[flow].first = {last, event.name()};
      }
      for (const std::uint64_t flow : event.terminating_flow_ids()) {
        EXPECT_TRUE(sources.count(flow)) << "an arrow begins before it ends";
        EXPECT_TRUE(sinks.insert(flow).second) << "an arrow ends once";
        flows[flow].second = {last, event.name()};
      }
    }
    EXPECT_EQ(sources, sinks);
    for (const auto& [track, stack] : open)
      EXPECT_TRUE(stack.empty()) << "left open on " << path(track);
  }

  std::multiset<std::string> arrows() const {
    std::multiset<std::string> out;
    for (const auto& [id, ends] : flows) out.insert(ends.first.name + " > " + ends.second.name);
    return out;
  }
};

const std::string kRoot = "tiny on two: xauto/";

TEST(Perfetto, HasATrackForEachXpuModuleAndChain) {
  Tiny tiny;
  tiny.release(0, 0);
  const Viewed viewed(tiny.file());
  std::set<std::string> paths;
  for (const auto& [track, name] : viewed.names) paths.insert(viewed.path(track));
  for (const char* path :
       {"releases", "run/cpu0", "run/gpu0", "chains/see", "chains/all", "modules/CAM",
        "modules/BIG", "done", "counters/gpu0 jobs suspended", "counters/activations dropped",
        "counters/deadlines missed", "counters/trace events lost"})
    EXPECT_TRUE(paths.count(kRoot + path)) << path;
}

TEST(Perfetto, APreemptedJobIsCutAndSaysByWhom) {
  Tiny tiny;
  tiny.release(0, 0);
  const Viewed viewed(tiny.file());
  const auto& gpu = viewed.slices.at(kRoot + "run/gpu0");
  std::vector<std::string> names;
  for (const Slice& slice : gpu) {
    names.push_back((slice.depth == 0 ? "" : "in it: ") + slice.name);
  }
  EXPECT_EQ(names,
            (std::vector<std::string>{"big.infer", "switch: big.infer", "in it: switch: big.infer",
                                      "cam.infer", "big.infer"}));
  EXPECT_EQ(gpu.back().args.at("preempted_by"), "cam.infer");
  EXPECT_EQ(gpu.back().args.at("part"), "2");
  EXPECT_EQ(gpu.back().args.at("waited_us"), std::to_string((8 - 4) + (315 - 114)));
  EXPECT_EQ(gpu[3].args.at("waited_for"), "big.infer");
  EXPECT_EQ(gpu[3].end, 1'318'000u) << "cut where the next one begins, not at its late FINISH";

  std::map<std::string, int> states;
  for (const Slice& slice : viewed.slices.at(kRoot + "modules/BIG"))
    if (slice.depth == 2) ++states[slice.name];
  EXPECT_EQ(states, (std::map<std::string, int>{
                        {"waiting", 1}, {"running", 2}, {"switching", 2}, {"suspended", 1}}));
}

TEST(Perfetto, AJobThatIsLetOnDuringTheSwitchIsNotCut) {
  Tiny tiny;
  tiny.publish(0, 0);
  tiny.at(1, XAUTO_EV_RUN, 0, 2, 1, 1);
  tiny.at(100, XAUTO_EV_RUN, 0, 1, 0, 1);
  tiny.at(101, XAUTO_EV_SUSPEND, 0, 2, 1, 1);
  tiny.at(130, XAUTO_EV_SUSPENDED, 0, 2, 1, 1);
  tiny.at(300, XAUTO_EV_FINISH, 0, 1, 0, 1);
  std::map<std::string, std::uint64_t> length;
  const Viewed viewed(tiny.file());
  for (const Slice& slice : viewed.slices.at(kRoot + "run/gpu0"))
    length[slice.name] = slice.end - slice.begin;
  EXPECT_EQ(length,
            (std::map<std::string, std::uint64_t>{
                {"big.infer", 99'000}, {"switch: big.infer", 29'000}, {"cam.infer", 200'000}}));
}

TEST(Perfetto, ASwitchThatBeganBeforeTheNextJobGoesOnInsideIt) {
  Tiny tiny;
  tiny.publish(0, 0);
  tiny.at(1, XAUTO_EV_RUN, 0, 2, 1, 1);
  tiny.at(98, XAUTO_EV_SUSPEND, 0, 2, 1, 1);
  tiny.at(100, XAUTO_EV_RUN, 0, 1, 0, 1);
  tiny.at(130, XAUTO_EV_SUSPENDED, 0, 2, 1, 1);
  tiny.at(300, XAUTO_EV_FINISH, 0, 1, 0, 1);
  tiny.at(310, XAUTO_EV_RUN, 0, 0, 0, 0);
  const Viewed viewed(tiny.file());
  std::string seen;
  for (const Slice& s : viewed.slices.at(kRoot + "run/gpu0"))
    seen += s.name + " " + std::to_string(s.begin / 1000 - 1000) + "-" +
            std::to_string(s.end / 1000 - 1000) + " in " + std::to_string(s.depth) + "\n";
  EXPECT_EQ(seen,
            "big.infer 1-98 in 0\nswitch: big.infer 98-100 in 0\n"
            "switch: big.infer 100-130 in 1\ncam.infer 100-300 in 0\n");
}

TEST(Perfetto, ArrowsGoFromTheReleaseAlongTheEdgesToTheOutputs) {
  Tiny tiny;
  tiny.release(0, 0);
  tiny.release(2000, 1);
  EXPECT_EQ(
      Viewed(tiny.file()).arrows(),
      (std::multiset<std::string>{"release 0 > cam.pre", "cam.pre > cam.infer", "cam.infer > CAM 0",
                                  "release 0 > big.infer", "big.infer > BIG 0",
                                  "release 1 > cam.pre", "cam.pre > cam.infer", "cam.infer > CAM 1",
                                  "release 1 > big.infer", "big.infer > BIG 1"}));
}

TEST(Perfetto, FilesOfTwoHostsOneBehindTheOtherHaveArrowsAcross) {
  Tiny front, rear;  // CAM is on one, BIG on the other
  for (Tiny* part : {&front, &rear}) {
    part->app.edges.emplace_back(1, 2);
    part->app.xnodes[2].sources.clear();
    part->scene.modules[0].sink = false;
  }
  front.scene.title = "host front";
  front.scene.elsewhere = {"", "rear"};
  front.scene.rows[1].here = false;  // a GPU of the other host
  rear.scene.title = "host rear";
  rear.scene.group = 2;
  rear.scene.elsewhere = {"front", ""};
  for (std::uint64_t seq = 0; seq < 2; ++seq) {
    const auto us = static_cast<std::int64_t>(2000 * seq);
    front.publish(us, seq);
    front.activate(us + 1, seq, 0, us);
    for (const std::uint16_t xnode : {std::uint16_t{0}, std::uint16_t{1}}) {
      front.at(us + 10 + 100 * xnode, XAUTO_EV_RUN, seq, xnode, 0, 0);
      front.at(us + 90 + 100 * xnode, XAUTO_EV_FINISH, seq, xnode, 0, 0);
    }
    front.at(us + 200, XAUTO_EV_DONE, seq, kNone, 0);
    rear.at(us + 400, XAUTO_EV_ACTIVATE, seq, kNone, 1);
    rear.at(us + 400, XAUTO_EV_TAKE, static_cast<std::uint64_t>(1'000'000 + us * 1000), kNone, 1,
            kNone, 0);
    rear.at(us + 410, XAUTO_EV_RUN, seq, 2, 1, 1);
    rear.at(us + 700, XAUTO_EV_FINISH, seq, 2, 1, 1);
    rear.at(us + 701, XAUTO_EV_DONE, seq, kNone, 1);
  }
  const Viewed both(front.file() + rear.file());
  EXPECT_EQ(both.arrows(), (std::multiset<std::string>{
                               "release 0 > cam.pre", "cam.pre > cam.infer", "release 1 > cam.pre",
                               "cam.pre > cam.infer", "cam.infer > big.infer",
                               "cam.infer > big.infer", "big.infer > BIG 0", "big.infer > BIG 1"}));
  EXPECT_EQ(both.slices.at("host rear/run/gpu0").front().args.at("messages"),
            "cam.infer 0 of host front");
  EXPECT_TRUE(both.slices.contains("host front/run/cpu0"));
  EXPECT_FALSE(both.slices.contains("host front/run/gpu0"));
  EXPECT_TRUE(both.slices.contains("host rear/run/gpu0"));
  EXPECT_FALSE(both.slices.contains("host rear/modules/CAM"));
}

TEST(Perfetto, WhatIsNotKnownToBeTakenHasNoArrow) {
  Tiny tiny;
  tiny.release(0, 0);
  std::erase_if(tiny.trace.events,
                [](const trace::Event& event) { return event.kind == XAUTO_EV_TAKE; });
  EXPECT_EQ(
      Viewed(tiny.file()).arrows(),
      (std::multiset<std::string>{"CAM 0 > cam.pre", "cam.pre > cam.infer", "cam.infer > CAM 0",
                                  "BIG 0 > big.infer", "big.infer > BIG 0"}));
}

TEST(Perfetto, CountsWhatWaitsIsSuspendedDroppedAndLate) {
  Tiny tiny;
  tiny.app.deadline_us = 700;
  tiny.release(0, 0);
  tiny.release(2000, 1);
  tiny.publish(4000, 2);
  tiny.at(4001, XAUTO_EV_DROP, 2, kNone, 0, kNone, XAUTO_DROP_OVERRUN);
  tiny.at(4002, XAUTO_EV_DROP, 2, kNone, 1, kNone, XAUTO_DROP_UPSTREAM);
  const Viewed viewed(tiny.file());
  const auto& suspended = viewed.counters.at(kRoot + "counters/gpu0 jobs suspended");
  ASSERT_EQ(suspended.size(), 5u);
  EXPECT_EQ(suspended[1], (std::pair<std::uint64_t, std::int64_t>{1'114'000, 1}));
  EXPECT_EQ(suspended[4].second, 0);
  EXPECT_EQ(viewed.counters.at(kRoot + "counters/activations dropped").back().second, 2);
  EXPECT_EQ(viewed.counters.at(kRoot + "counters/deadlines missed").back().second, 2)
      << "321 us are in time, 721 are not, and nothing came of the last release";
  EXPECT_EQ(viewed.counters.at(kRoot + "counters/trace events lost").back().second, 0);
  EXPECT_FALSE(viewed.lossy);
}

TEST(Perfetto, SaysWhenEventsWereLost) {
  Tiny tiny;
  tiny.release(0, 0);
  tiny.trace.lost = 3;
  tiny.at(800, XAUTO_EV_RUN, 0, 99, 0, 0);  // no such XNode
  tiny.at(800, XAUTO_EV_RUN, 0, 0, 1, 0);   // not an XNode of this module
  tiny.at(800, 77, 0, 0, 0, 0);             // no such kind
  const Viewed viewed(tiny.file());
  EXPECT_TRUE(viewed.lossy);
  EXPECT_EQ(viewed.counters.at(kRoot + "counters/trace events lost").front().second, 6);
  EXPECT_EQ(viewed.instants.front(), "INCOMPLETE: 6 events were lost");
}

TEST(Perfetto, JobsThatShareAnXpuGetLanes) {
  Tiny tiny;
  tiny.scene.rows[1].exclusive = false;
  tiny.publish(0, 0);
  tiny.at(1, XAUTO_EV_RUN, 0, 1, 0, 1);
  tiny.at(2, XAUTO_EV_RUN, 0, 2, 1, 1);
  tiny.at(5, XAUTO_EV_FINISH, 0, 1, 0, 1);
  tiny.at(9, XAUTO_EV_FINISH, 0, 2, 1, 1);
  const Viewed viewed(tiny.file());
  int lanes = 0;
  for (const auto& [track, name] : viewed.names) lanes += name == "gpu0" ? 1 : 0;
  EXPECT_EQ(lanes, 2);
  std::map<std::string, std::uint64_t> length;
  for (const Slice& slice : viewed.slices.at(kRoot + "run/gpu0"))
    length[slice.name] = slice.end - slice.begin;
  EXPECT_EQ(length,
            (std::map<std::string, std::uint64_t>{{"cam.infer", 4000}, {"big.infer", 7000}}));
}

TEST(Perfetto, ATraceCutShortAnywhereIsStillAPicture) {
  Tiny whole;
  whole.release(0, 0);
  whole.release(2000, 1);
  for (std::size_t n = 1; n < whole.trace.events.size(); ++n) {
    Tiny cut = whole;
    cut.trace.events.resize(n);
    (void)Viewed(cut.file());
    Tiny hole = whole;
    hole.trace.events.erase(hole.trace.events.begin() + static_cast<std::ptrdiff_t>(n));
    (void)Viewed(hole.file());
  }
}

TEST(Perfetto, ATraceOfNonsenseIsStillAPicture) {
  std::mt19937 random(7);
  const auto below = [&](std::uint32_t n) { return static_cast<std::uint16_t>(random() % n); };
  for (int round = 0; round < 100; ++round) {
    Tiny tiny;
    tiny.scene.rows[1].exclusive = round % 2 == 0;
    tiny.release(0, 0);
    std::int64_t us = 800;
    for (int i = 0; i < 120; ++i) {
      us += below(3);
      const std::uint16_t xnode = below(3);
      tiny.at(us, below(13), below(3), xnode, xnode == 2 ? 1 : 0, below(2), below(5));
    }
    (void)Viewed(tiny.file());
  }
}

TEST(Perfetto, AnEmptyTraceIsAnError) {
  const Tiny tiny;
  const auto story = story_of(tiny.app, tiny.platform, tiny.scene.modules, tiny.trace);
  ASSERT_FALSE(story);
  EXPECT_EQ(story.error().what, "the run left no event");
}

TEST(Perfetto, ATraceOfAnotherAppIsAnError) {
  Tiny tiny;
  tiny.at(1, XAUTO_EV_RUN, 0, 99, 0, 0);
  const auto story = story_of(tiny.app, tiny.platform, tiny.scene.modules, tiny.trace);
  ASSERT_FALSE(story);
  EXPECT_NE(story.error().what.find("none of the run's 1 events fits"), std::string::npos);
}

TEST(Perfetto, NamesThatAreNoUtf8AreMendedAndClocksAreShifted) {
  PerfettoWriter out;
  const auto track = out.add_track(PerfettoWriter::kNoParent, "gr\xc3\xbcn \xff\xc3");
  out.instant(track, 5, "\xe2\x82", {});
  proto::Trace trace;
  ASSERT_TRUE(trace.ParseFromString(out.write(1000)));
  EXPECT_EQ(trace.packet(0).track_descriptor().name(), "gr\xc3\xbcn ??");
  EXPECT_EQ(trace.packet(1).track_event().name(), "??");
  EXPECT_EQ(trace.packet(1).timestamp(), 1005u);
  ASSERT_TRUE(trace.ParseFromString(out.write(-1000)));
  EXPECT_EQ(trace.packet(1).timestamp(), 0u);
}

// ---- read back by `xauto report`

TEST(Report, ThePageHoldsTheNumbersAndEscapesNames) {
  Tiny tiny;
  tiny.scene.title = "<img src=x>: xauto";
  tiny.release(0, 0);
  tiny.release(2000, 1);
  const auto trace = read_trace(tiny.file(), "t.pftrace");
  ASSERT_TRUE(trace) << trace.error().to_string();
  const std::string page = page_html({{"x'/ü.pftrace", *trace}});
  EXPECT_EQ(page.find("<img"), std::string::npos);
  for (const char* text : {"xauto: slowest release, 0, took 0.72 ms",
                           "off the XPU for 0.214 ms, preempted by cam.infer 0",
                           "p50 0.72, p99 -, max 0.72 of 2 results",
                           "href='x%27/%C3%BC.pftrace'>ü.pftrace</a>", "search there for “all 0”"})
    EXPECT_NE(page.find(text), std::string::npos) << text;
  // Neither script nor network.
  for (const char* text : {"<script", "<link", " src='", "://"})
    EXPECT_EQ(page.find(text), std::string::npos) << text;
}

/// Two changes of the scenario, the second of which the run's report does not have (any more).
TEST(Report, ThePageAndTheTraceTellChangesOfTheScenario) {
  Tiny tiny;
  Tables tables;
  tables.scenarios = {Scenario{"fast"}, Scenario{"slow & hot"}};
  tables.tables = {{"table 0"}, {"table 1"}};
  tiny.scene.tables = &tables;
  tiny.scene.verdict = "worst cases: kept";
  tiny.scene.scenarios = {{"fast", "table 0", 17}, {"slow & hot", "table 1", 0}};
  tiny.scene.changes = {{1, "fast", "slow & hot", "lane", 640, 900}};
  tiny.release(0, 0);
  tiny.at(999, XAUTO_EV_SWITCH, 1, 1, 1, kNone,
          1 | static_cast<std::uint32_t>(Why::kOverrun) << 16);
  tiny.release(1000, 1);
  tiny.at(1999, XAUTO_EV_SWITCH, 2, kNone, 0, kNone,
          0 | static_cast<std::uint32_t>(Why::kBack) << 16);
  tiny.release(2000, 2);
  const auto trace = read_trace(tiny.file(), "t.pftrace");
  ASSERT_TRUE(trace) << trace.error().to_string();
  EXPECT_EQ(trace->verdict, "worst cases: kept");
  ASSERT_EQ(trace->scenarios.size(), 2u);
  EXPECT_EQ(trace->scenarios[0].releases, 17);
  EXPECT_EQ(trace->scenarios[1].name, "slow & hot");
  ASSERT_EQ(trace->changes.size(), 2u);
  const TraceChange &first = trace->changes[0], &second = trace->changes[1];
  EXPECT_EQ(first.release, 1);
  EXPECT_EQ(first.from + " " + first.to + " " + first.table + " " + first.why,
            "fast slow & hot table 1 overrun: cam.infer");
  EXPECT_EQ(first.spanned_us, 640);
  EXPECT_EQ(first.worst_case_us, 900);
  EXPECT_EQ(second.from + " " + second.to + " " + second.table + " " + second.why,
            "slow & hot fast table 0 back");
  EXPECT_EQ(second.spanned_us, -1);
  EXPECT_EQ(second.worst_case_us, -1);
  const std::string page = page_html({{"", *trace}});
  for (const char* text :
       {"Changes of the scenario: 2<", "overrun: cam.infer", "slow &amp; hot",
        "<td>0.64 of lane</td><td>0.90</td>", "<td>17</td>", "worst cases: kept"})
    EXPECT_NE(page.find(text), std::string::npos) << text;
  tiny.scene.tables = nullptr;
  const auto one_policy = read_trace(tiny.file(), "t.pftrace");
  ASSERT_TRUE(one_policy);
  EXPECT_EQ(page_html({{"", *one_policy}}).find("Scenarios"), std::string::npos);
}

/// What the whole run counted stands in the line of its policy; a strip has a dot per release, and a line per bound.
TEST(Report, AChainHasItsCountsAndLines) {
  Tiny tiny;
  tiny.scene.counts = {{"see", 300, 310, 320, 330, 325, 100, 350, 7, 2, true}};
  tiny.release(0, 0);
  tiny.release(2000, 1);
  const auto trace = read_trace(tiny.file(), "t.pftrace");
  ASSERT_TRUE(trace);
  const std::string page = page_html({{"", *trace}});
  for (const char* text :
       {"p50 0.31, p99 0.32, max 0.33 of 300 results", "claimed 0.33: <b class='bad'>exceeded</b>",
        "7 missed the deadline", "2 lost", "from source sensor, deadline 0.35 ms"})
    EXPECT_NE(page.find(text), std::string::npos) << text;
  const std::string see = page.substr(page.find("<h2>see</h2>"));
  const std::string strip = see.substr(0, see.find("</svg>"));
  EXPECT_EQ(count(strip, "<circle"), 2);
  for (const char* css : {"class='bound'", "class='claim'", "class='deadline'"})
    EXPECT_EQ(count(strip, css), 1) << css;
}

/// A run without a result has no strip, no axis and no waterfall; several runs of a chain share one panel.
TEST(Report, NothingIsDrawnOfNothing) {
  ReadTrace none;
  none.title = "a on p: one";
  none.counts = {{"lane", 0}};
  const std::string page = page_html({{"", none}});
  for (const char* text : {"<svg", "<details", "class='axis'", "busy"})
    EXPECT_EQ(page.find(text), std::string::npos) << text;
  EXPECT_NE(page.find("p50 -, p99 -, max - of 0 results"), std::string::npos);
  EXPECT_EQ(count(page_html({{"", none}, {"", none}}), "<h2>lane</h2>"), 1);
  EXPECT_NE(page_html({}).find("</html>"), std::string::npos);
}

TEST(Report, BrokenUtf8DoesNotBreakThePage) {
  ReadTrace trace;
  trace.title = "\xff\xfe<b>";
  EXPECT_NE(page_html({{"", trace}}).find("<h1>??&lt;b&gt;</h1>"), std::string::npos);
}

TEST(Report, FilesThatAreNoTraceOfOursAreRefused) {
  Tiny tiny;
  tiny.release(0, 0);
  const std::string good = tiny.file();
  const auto refused = [](const std::string& bytes) {
    const auto trace = read_trace(bytes, "t.pftrace");
    EXPECT_FALSE(trace);
    if (trace) return std::string();
    EXPECT_EQ(trace.error().code, ErrorCode::kInvalid);
    return trace.error().to_string();
  };
  EXPECT_EQ(refused(""), "t.pftrace: is empty\n  hint: did the run end before it wrote it?");
  EXPECT_NE(refused("{\"schema\": 1}").find("is no Perfetto trace"), std::string::npos);
  EXPECT_NE(refused(good.substr(0, good.size() - 1)).find("was broken off"), std::string::npos);
  PerfettoWriter other;
  const auto track = other.add_track(PerfettoWriter::kNoParent, "another tool's");
  EXPECT_NE(refused(other.write(0)).find("was not written by `xauto run"), std::string::npos);
  other.end(track, 1);
  EXPECT_NE(refused(other.write(0)).find("that never began"), std::string::npos);
}

TEST(Report, ADamagedTraceIsReadOrRefused) {
  Tiny tiny;
  tiny.release(0, 0);
  const std::string good = tiny.file();
  std::mt19937 random(11);
  for (int round = 0; round < 2000; ++round) {
    std::string bytes = good;
    for (int k = 0; k < 3; ++k) bytes[random() % bytes.size()] = static_cast<char>(random() & 0xff);
    if (const auto trace = read_trace(bytes, "t.pftrace")) (void)page_html({{"t", *trace}});
  }
}

// ---- other readers

std::string protoc(const std::string& arguments, const std::string& bytes) {
  // ctest runs each test in a process of its own, two at a time.
  const std::string base = ::testing::TempDir() + "xauto_perfetto." + std::to_string(getpid());
  const std::string in = base + ".pftrace", out = base + ".txt";
  std::ofstream(in, std::ios::binary) << bytes;
  const std::string command = std::string(XAUTO_PROTOC) + " " + arguments + " <" + in + " >" + out;
  EXPECT_EQ(std::system(command.c_str()), 0) << command;
  const std::string text = slurp(out);
  for (const std::string& file : {in, out}) std::filesystem::remove(file);
  return text;
}

TEST(Perfetto, ATinyRunIsWrittenAsItAlwaysWas) {
  Tiny tiny;
  tiny.release(0, 0);
  const std::string text = protoc("--decode=xauto.perfetto.Trace -I " XAUTO_SOURCE_DIR
                                  "/lib " XAUTO_SOURCE_DIR "/lib/story/perfetto.proto",
                                  tiny.file());
  const auto expected = golden() / "tiny.pftrace.txt";
  if (std::getenv("XAUTO_UPDATE_GOLDEN") != nullptr)
    std::ofstream(expected, std::ios::binary) << text;
  EXPECT_EQ(slurp(expected), text) << "XAUTO_UPDATE_GOLDEN=1 writes it; read the diff";
}

TEST(Perfetto, AReaderWithoutOurSchemaSeesTheFormatsFieldNumbers) {
  Tiny tiny;
  tiny.release(0, 0);
  const std::string bytes = tiny.file();
  const std::string raw = protoc("--decode_raw", bytes);
  int packets = 0, others = 0, tracks = 0, events = 0;
  for (std::size_t at = 0; at < raw.size(); at = raw.find('\n', at) + 1) {
    packets += raw.compare(at, 4, "1 {\n") == 0 ? 1 : 0;
    others += raw[at] != ' ' && raw[at] != '}' && raw.compare(at, 4, "1 {\n") != 0 ? 1 : 0;
    tracks += raw.compare(at, 7, "  60 {\n") == 0 ? 1 : 0;
    events += raw.compare(at, 7, "  11 {\n") == 0 ? 1 : 0;
  }
  EXPECT_EQ(packets, Viewed(bytes).packets);
  EXPECT_EQ(others, 0) << "a Trace is packets and nothing else";
  EXPECT_EQ(tracks + events, packets);
  EXPECT_NE(raw.find("\n    47: 0x0000000000000001\n"), std::string::npos)
      << "flow_ids are fixed64";
  EXPECT_NE(raw.find("\n    48: 0x0000000000000001\n"), std::string::npos);
}

}  // namespace
}  // namespace xauto::story
