// SPDX-License-Identifier: Apache-2.0
// Models of Amalthea: one of ours (tests/golden/amalthea), and what a hostile one may hold.
#include "import/amalthea.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include <gtest/gtest.h>

#include "base/index.h"
#include "model/json.h"

#include "import/xml.h"

namespace xauto::import {
namespace {

#ifdef XAUTO_HAVE_EXPAT

using Times = decltype(XNodeSpec::wcet_us);

struct Made {
  ImportedApp app;
  std::vector<std::string> lines;
  [[nodiscard]] bool says(const std::string& words) const {
    const auto has = [&](const std::string& line) { return line.find(words) != std::string::npos; };
    return std::ranges::any_of(lines, has) ||
           std::ranges::any_of(app.todo, [&](const Todo& t) { return has(t.what); });
  }
  [[nodiscard]] const XNodeSpec& xnode(const std::string& name) const {
    const int x = app.app.find(name);
    EXPECT_GE(x, 0) << name;
    return app.app.xnodes[at(std::max(0, x))];
  }
  [[nodiscard]] std::vector<std::string> pairs(const std::vector<std::pair<int, int>>& all) const {
    std::vector<std::string> names;
    for (const auto& [u, v] : all)
      names.push_back(app.app.xnodes[at(u)].name + ">" + app.app.xnodes[at(v)].name);
    std::ranges::sort(names);
    return names;
  }
};

std::string fusion() {
  std::ifstream file(std::string(XAUTO_SOURCE_DIR) + "/tests/golden/amalthea/fusion.amxmi");
  return {std::istreambuf_iterator<char>(file), {}};
}

Made made_of(const std::string& text) {
  Made made;
  const auto model = parse_amalthea({{"model", text}});
  EXPECT_TRUE(model) << model.error().to_string();
  if (!model) return made;
  auto app = amalthea_app(*model, {"app", 0}, made.lines);
  EXPECT_TRUE(app) << app.error().to_string();
  if (!app) return made;
  const auto again = parse_imported(to_json(*app), "again");
  EXPECT_TRUE(again && to_json(*again) == to_json(*app));
  made.app = std::move(*app);
  return made;
}

std::string without(std::string text, const std::string& from, const std::string& to,
                    const std::string& instead = "") {
  const std::size_t begin = text.find(from);
  EXPECT_NE(begin, std::string::npos) << from;
  const std::size_t end = text.find(to, begin);
  EXPECT_NE(end, std::string::npos) << to;
  return text.replace(begin, end + to.size() - begin, instead);
}

TEST(Amalthea, TicksBecomeTimesBySlowestUnit) {
  const Made made = made_of(fusion());
  // 2,000,000 ticks on cores of 2 and 1 GHz; a histogram's and a switch's worst; twice the same runnable.
  EXPECT_EQ(made.xnode("Camera").wcet_us, (Times{{"cpu", 2000}}));
  EXPECT_EQ(made.xnode("Net").wcet_us, (Times{{"cpu", 80'000}, {"gpu", 10'000}}));
  EXPECT_EQ(made.xnode("Net").typical_us, (TypicalTimes{{"cpu", 70'000}, {"gpu", 9000}}));
  EXPECT_EQ(made.xnode("Camera.2").wcet_us, (Times{{"cpu", 3000}}));
  EXPECT_EQ(made.xnode("Control").wcet_us, (Times{{"cpu", 1600}}));
  EXPECT_EQ(made.xnode("Control").typical_us, (TypicalTimes{{"cpu", 660}}));
  EXPECT_EQ(made.xnode("Wheel").wcet_us, (Times{{"cpu", 13}}));
  EXPECT_TRUE(made.says("no upper bound"));
}

TEST(Amalthea, TriggersAndEventsAreEdgesAndLabelsSamples) {
  const Made made = made_of(fusion());
  EXPECT_EQ(made.pairs(made.app.app.edges),
            (std::vector<std::string>{"Camera>Net", "Net>Camera.2"}));
  // Of the model's chain; without it of all labels that tasks of other rates share.
  EXPECT_EQ(made.pairs(made.app.app.samples), std::vector<std::string>{"Camera.2>Control"});
  const Made all = made_of(without(without(fusion(), "<eventChains", "</eventChains>"), "<timingC",
                                   "</timingConstraints>"));
  EXPECT_EQ(all.pairs(all.app.app.samples),
            (std::vector<std::string>{"Camera.2>Control", "Wheel>Control"}));
}

TEST(Amalthea, StimuliAreSourcesAndLimitsDeadlines) {
  const Made made = made_of(fusion());
  const AppSpec& app = made.app.app;
  ASSERT_EQ(app.sources.size(), 3u);
  EXPECT_EQ(app.sources[0], (SourceSpec{"each_40ms", {40'000, 1}, 0, 250, 0}));
  EXPECT_EQ(app.sources[1], (SourceSpec{"each_10ms", {10'000, 1}, 3000, 0, 0}));
  EXPECT_EQ(app.sources[2], (SourceSpec{"ticks", {5000, 1}, 0, 0, 1}));
  ASSERT_EQ(app.chains.size(), 2u);
  EXPECT_EQ(app.chains[0], (ChainSpec{"brake", 0, app.find("Control"), 100'000, 1}));
  EXPECT_EQ(app.chains[1], (ChainSpec{"Control", 1, app.find("Control"), 10'000, 1}));
  EXPECT_TRUE(made.says("comes 5000 to 7000 us after the last"));
  EXPECT_TRUE(made.says("no chain ends in"));
}

TEST(Amalthea, UnitsAreAPlatform) {
  const auto model = parse_amalthea({{"model", fusion()}});
  ASSERT_TRUE(model);
  const Platform platform = amalthea_platform(*model, "soc");
  ASSERT_EQ(platform.xpus.size(), 3u);
  EXPECT_EQ(platform.xpus[1].id, "cpu1");
  EXPECT_EQ(platform.xpus[2].id, "gpu0");
  EXPECT_FALSE(platform.xpus[2].preempt_measured);
}

TEST(Amalthea, AFileOf07IsReadToo) {
  const Made made = made_of(R"(<am:Amalthea xmlns:am="http://app4mc.eclipse.org/amalthea/0.7.2">
    <swModel>
      <tasks name="T" stimuli="often?type=Sporadic"><callGraph><graphEntries xsi:type="am:CallSequence">
        <calls xsi:type="am:TaskRunnableCall" runnable="R%201?type=Runnable"/></graphEntries></callGraph></tasks>
      <runnables name="R 1"><runnableItems xsi:type="am:RunnableInstructions"><default xsi:type="am:InstructionsDeviation"><deviation>
        <lowerBound xsi:type="am:LongObject" value="400"/><upperBound xsi:type="am:LongObject" value="60000"/>
        <distribution xsi:type="am:WeibullEstimators" pRemainPromille="5.0E-4"><mean xsi:type="am:LongObject" value="2000"/></distribution>
      </deviation></default></runnableItems></runnables>
    </swModel>
    <hwModel><coreTypes name="C" instructionsPerCycle="2"/><system><quartzes name="Q"><frequency value="1.0E8"/></quartzes>
      <cores name="C0" coreType="C?type=CoreType"><prescaler quartz="Q?type=Quartz"/></cores></system></hwModel>
    <stimuliModel><stimuli xsi:type="am:Sporadic" name="often"><stimulusDeviation><lowerBound value="1700" unit="us"/>
      <upperBound value="1800" unit="us"/></stimulusDeviation></stimuli></stimuliModel></am:Amalthea>)");
  EXPECT_EQ(made.xnode("T").wcet_us, (Times{{"cpu", 300}}));  // 60,000 at two per cycle of 100 MHz
  EXPECT_EQ(made.xnode("T").typical_us, (TypicalTimes{{"cpu", 10}}));
  EXPECT_EQ(made.app.app.sources.at(0).period, (Period{1700, 1}));
}

TEST(Amalthea, WhatIsNotKnownIsAsked) {
  // Of one source nothing, but a rate of the others; of a part no time; no units.
  const Made made = made_of(without(
      without(without(fusion(), "<hwModel>", "</hwModel>"), "<nextOccurrence", "</nextOccurrence>"),
      "<runnables name=\"Grab\">", "</runnables>"));
  EXPECT_TRUE(made.says("how often does 'ticks' come (RelativePeriodicStimulus)"));
  EXPECT_TRUE(made.says("how long does 'Camera' take"));
  EXPECT_TRUE(made.says("has no processing units"));
  EXPECT_TRUE(made.says("runnable 'Grab' is called and not in the model"));
  // And without any rate there are no samples.
  std::string none = fusion();
  for (const char* rate : {"each_40ms", "each_10ms", "ticks"})
    none = without(none, std::string("name=\"") + rate + "\">", "</stimuli>",
                   std::string("name=\"") + rate + "\"/>");
  EXPECT_TRUE(made_of(none).app.app.one_at_a_time);
}

TEST(Amalthea, CirclesEndSomewhere) {
  // Runnables and tasks that call and trigger themselves and each other.
  std::string text = fusion();
  text = without(text, "runnable=\"Filter?type=Runnable\"", "/>",
                 "runnable=\"Steer?type=Runnable\"/>");
  EXPECT_TRUE(made_of(text).says("'Steer' calls itself"));
  text = without(fusion(), "stimuli=\"each_40ms?", "Stimulus\"",
                 "stimuli=\"again?type=InterProcessStimulus\"");
  text = without(
      text, "<items xsi:type=\"am:SetEvent\">", "</items>",
      "<items xsi:type=\"am:InterProcessTrigger\" stimulus=\"again?type=InterProcessStimulus\"/>");
  const Made made = made_of(text);
  EXPECT_EQ(made.app.app.xnodes.size(), 2u);
  EXPECT_TRUE(made.says("or itself does: it is left out"));
}

TEST(Amalthea, CallsThatDoubleAtEachStepAreBounded) {
  std::string text =
      "<am:Amalthea><swModel><tasks name=\"T\" stimuli=\"s\"><callGraph><items "
      "xsi:type=\"am:RunnableCall\" "
      "runnable=\"r0\"/></callGraph></tasks>";
  for (int n = 0; n < 60; ++n) {
    const std::string call =
        "<items xsi:type=\"am:RunnableCall\" runnable=\"r" + std::to_string(n + 1) + "\"/>";
    text += "<runnables name=\"r" + std::to_string(n) + "\"><callGraph>" + call + call +
            "<items xsi:type=\"am:LabelAccess\" data=\"l\"/>" +
            (n == 30 ? "<items xsi:type=\"am:InterProcessTrigger\" stimulus=\"x\"/>" : "") +
            "</callGraph></runnables>";
  }
  text +=
      "</swModel><stimuliModel><stimuli xsi:type=\"am:PeriodicStimulus\" name=\"s\"><recurrence "
      "value=\"1\" unit=\"ms\"/>"
      "</stimuli></stimuliModel></am:Amalthea>";
  const auto model = parse_amalthea({{"model", text}});
  ASSERT_TRUE(model);
  std::vector<std::string> lines;
  (void)amalthea_app(*model, {"app", 0}, lines);
}

TEST(Xml, EntitiesDepthAndDamageAreRefused) {
  std::string deep;
  for (int n = 0; n < 100; ++n) deep += "<a>";
  for (const std::string& text :
       {std::string("<!DOCTYPE a [<!ENTITY b \"c\">]><a>&b;</a>"),
        std::string("<!DOCTYPE a SYSTEM \"file:///etc/passwd\"><a/>"), deep, std::string("<a"),
        std::string(), std::string("<a></b>"), std::string("<a>&b;</a>"), std::string("<a/><a/>")})
    EXPECT_FALSE(parse_xml(text, "f")) << text;
  const auto root = parse_xml("<a b='1'><c d='&lt;'/></a>", "f");
  ASSERT_TRUE(root);
  ASSERT_NE(root->child("c"), nullptr);
  EXPECT_EQ((*root->child("c"))["d"], "<");
}

TEST(Amalthea, AModelThatIsChangedIsRefusedOrRead) {
  const std::string whole = fusion();
  std::mt19937 random(3);
  std::size_t read = 0;
  for (int n = 0; n < 300; ++n) {
    std::string text = whole;
    for (int b = 0; b < 2; ++b) {
      const std::size_t where = random() % text.size();
      if (random() % 2 == 0)
        text[where] = whole[random() % whole.size()];
      else
        text.erase(where, random() % 40);
    }
    const auto model = parse_amalthea({{"model", text}});
    std::vector<std::string> lines;
    if (!model) continue;
    if (const auto app = amalthea_app(*model, {"app", 0}, lines)) {
      EXPECT_TRUE(parse_imported(to_json(*app), "again"));
      ++read;
    }
  }
  EXPECT_GT(read, 20u);
}

#else

TEST(Amalthea, SaysThatItWasBuiltWithoutExpat) {
  const auto root = parse_xml("<a/>", "f");
  ASSERT_FALSE(root);
  EXPECT_NE(root.error().what.find("without Expat"), std::string::npos);
}

#endif

}  // namespace
}  // namespace xauto::import
