// SPDX-License-Identifier: Apache-2.0
#include "graph/graph.h"

#include <chrono>

#include <gtest/gtest.h>

#include <xauto/xauto.h>

namespace xauto {
namespace {

using namespace std::chrono_literals;

struct State {
  int value = 0;
};
const Topic<int> kIn("in"), kMid("mid"), kOut("out"), kOther("other");

SchedHandle no_handle(const XpuId&) {
  return SchedHandle::thread();
}
void nothing(State&, const Input&) {}

XNode<State> node(const std::string& name) {
  XNode<State> made(name);
  made.add_impl(XPU::CPU, no_handle, nothing);
  return made;
}

struct Builder {
  Builder() {
    app.add_source(kIn, 10ms, [](std::uint64_t) { return 0; });
  }
  std::string refusal() const {
    const Status status = app.check();
    return status ? "" : status.error().what;
  }
  App app{"test"};
};

TEST(Graph, ChainsAndTopicsGiveTheEdges) {
  Builder b;
  b.app.add_module(XModule<State>("A")
                       .add_node(node("a1"))
                       .add_node(node("a2"))
                       .add_input_topic(kIn)
                       .add_output_topic(kMid, &State::value));
  b.app.add_module(XModule<State>("B")
                       .add_node(node("b1"))
                       .add_input_topic(kMid)
                       .add_output_topic(kOut, &State::value));
  EXPECT_EQ(b.refusal(), "");
}

#define EXPECT_REFUSAL(builder, text) \
  EXPECT_NE((builder).refusal().find(text), std::string::npos) << (builder).refusal()

TEST(Graph, ATopicByItsNameCarriesWhatItsPublisherSays) {
  Builder by_name;
  by_name.app.add_module(
      XModule<State>("A").add_node(node("a")).add_input_topic("in").add_output_topic(
          kMid, &State::value));
  by_name.app.add_module(XModule<State>("B").add_node(node("b")).add_input_topic("mid"));
  EXPECT_EQ(by_name.refusal(), "");
  Builder nobody;
  nobody.app.add_module(XModule<State>("A").add_node(node("a")).add_input_topic("im"));
  EXPECT_REFUSAL(nobody, "reads topic 'im' by its name alone, and no Topic of that name says");
}

TEST(Graph, RefusesNamesThatNoFileHolds) {
  for (const auto& [name, text] :
       {std::pair<std::string, std::string>{"a\nb", "'a?b': the name has a control"},
        {"a\x1b[31m", "'a?[31m': the name has a control"},
        {"a\xc2\x9b", "the name has a control"},
        {"x\xff", "'x?': the name is no UTF-8"},
        {std::string(257, 'n'), "nnn...': the name is longer than 256"}}) {
    Builder b;
    b.app.add_module(XModule<State>(name).add_node(node("n")).add_input_topic(kIn));
    EXPECT_REFUSAL(b, text);
    Builder c;
    c.app.add_module(XModule<State>("M").add_node(node(name)).add_input_topic(kIn));
    EXPECT_REFUSAL(c, text);
  }
  Builder good;
  good.app.add_module(XModule<State>("Straße").add_node(node("检测")).add_input_topic(kIn));
  EXPECT_EQ(good.refusal(), "");
}

TEST(Graph, RefusesAPeriodThatNoFileHolds) {
  for (const auto& [period, text] :
       {std::pair(0us, "0 us"), std::pair(2h + 0us, "7200000000 us")}) {
    Builder b;
    b.app.add_source(Topic<int>("slow"), period, [](std::uint64_t) { return 0; });
    EXPECT_REFUSAL(b, std::string("the source of topic 'slow' has a period of ") + text);
  }
}

TEST(Graph, RefusesANodeAddedTwice) {
  Builder b;
  const auto twice = node("a1");
  b.app.add_module(XModule<State>("A").add_node(twice).add_node(twice).add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XNode 'a1' is added twice to XModule 'A'");
}

TEST(Graph, RefusesANodeInTwoModules) {
  Builder b;
  const auto shared = node("a1");
  b.app.add_module(XModule<State>("A").add_node(shared).add_input_topic(kIn));
  b.app.add_module(XModule<State>("B").add_node(shared).add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XNode 'a1' is in two XModules, 'A' and 'B'");
}

TEST(Graph, RefusesTwoImplementationsForOneXpu) {
  Builder b;
  b.app.add_module(XModule<State>("A")
                       .add_node(node("a1").add_impl(XPU::CPU, no_handle, nothing))
                       .add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XNode 'a1' has two implementations for 'cpu'");
}

TEST(Graph, RefusesANodeWithoutImplementation) {
  Builder b;
  b.app.add_module(XModule<State>("A").add_node(XNode<State>("a1")).add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XNode 'a1' has no implementation");
}

TEST(Graph, AVariantIsBesideItsXNodesOwnImplementation) {
  const auto with = [](const auto& add) {
    Builder b;
    XNode<State> made = node("a1");
    add(made);
    b.app.add_module(XModule<State>("A").add_node(made).add_input_topic(kIn));
    return b.refusal();
  };
  EXPECT_EQ(with([](XNode<State>& x) {
              x.add_variant("small", 60, XPU::CPU, no_handle, nothing)
                  .add_variant("small", 60, XPU::GPU, no_handle, nothing)
                  .add_variant("tiny", 1, XPU::CPU, no_handle, nothing);
            }),
            "");
  const auto says = [&](const std::string& text, const auto& add) {
    EXPECT_NE(with(add).find(text), std::string::npos) << with(add);
  };
  says("variant 'small' of XNode 'a1' has two implementations for 'cpu'", [](XNode<State>& x) {
    x.add_variant("small", 60, XPU::CPU, no_handle, nothing)
        .add_variant("small", 60, XPU::CPU, no_handle, nothing);
  });
  says("variant 'small' of XNode 'a1' has two qualities, 60 and 50 %", [](XNode<State>& x) {
    x.add_variant("small", 60, XPU::CPU, no_handle, nothing)
        .add_variant("small", 50, XPU::GPU, no_handle, nothing);
  });
  says("0 is not a quality from 1 to 100 %",
       [](XNode<State>& x) { x.add_variant("small", 0, XPU::CPU, no_handle, nothing); });
  says("a variant without a name",
       [](XNode<State>& x) { x.add_variant("", 60, XPU::CPU, no_handle, nothing); });
  Builder b;
  XNode<State> only("a1");
  only.add_variant("small", 60, XPU::CPU, no_handle, nothing);
  b.app.add_module(XModule<State>("A").add_node(only).add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XNode 'a1' has no implementation of its own, only variants");
}

TEST(Graph, NobodyWhoIsNeededWaitsForAnOptionalModule) {
  const auto refusal = [](bool sampled, bool both) {
    Builder b;
    b.app.add_module(XModule<State>("A")
                         .add_node(node("a1"))
                         .add_input_topic(kIn)
                         .add_output_topic(kMid, &State::value)
                         .optional());
    XModule<State> other("B");
    other.add_node(node("b1"));
    if (sampled)
      other.add_input_topic(kIn).add_sampled_topic(kMid);
    else
      other.add_input_topic(kMid);
    if (both) other.optional();
    b.app.add_module(other);
    return b.refusal();
  };
  EXPECT_NE(
      refusal(false, false)
          .find("XModule 'B' waits for XModule 'A', which is optional, and is not optional itself"),
      std::string::npos);
  EXPECT_EQ(refusal(false, true), "");
  EXPECT_EQ(refusal(true, false), "") << "it waits for nobody";
}

TEST(Graph, RefusesOneTopicWithTwoTypes) {
  Builder b;
  b.app.add_module(XModule<State>("A").add_node(node("a1")).add_input_topic(Topic<double>("in")));
  EXPECT_REFUSAL(b, "topic 'in' has two types: int (a source) and double (XModule 'A' reads it)");
}

TEST(Graph, RefusesTwoPublishers) {
  Builder b;
  for (const char* name : {"A", "B"})
    b.app.add_module(XModule<State>(name)
                         .add_node(node(name + std::string("1")))
                         .add_input_topic(kIn)
                         .add_output_topic(kMid, &State::value));
  EXPECT_REFUSAL(b, "topic 'mid' has two publishers: XModule 'A' and XModule 'B'");
}

TEST(Graph, RefusesATopicThatNobodyPublishes) {
  Builder b;
  b.app.add_module(XModule<State>("A").add_node(node("a1")).add_input_topic(kMid));
  EXPECT_REFUSAL(b, "topic 'mid' has no publisher, but XModule 'A' reads it");
}

TEST(Graph, RefusesACycleAndNamesIt) {
  Builder b;
  b.app.add_module(XModule<State>("A")
                       .add_node(node("a1"))
                       .add_input_topic(kIn)
                       .add_input_topic(kOut)
                       .add_output_topic(kMid, &State::value));
  b.app.add_module(XModule<State>("B")
                       .add_node(node("b1"))
                       .add_input_topic(kMid)
                       .add_output_topic(kOut, &State::value));
  EXPECT_REFUSAL(b, "cycle of XModules: A -> B -> A");
}

TEST(Graph, RefusesModulesThatCannotFireOrRun) {
  Builder b;
  b.app.add_module(XModule<State>("A").add_node(node("a1")));
  b.app.add_module(XModule<State>("B").add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XModule 'A' has no input topic: it would never fire");
  EXPECT_REFUSAL(b, "XModule 'B' has no XNode");
}

TEST(Graph, RefusesAnAppWithoutSource) {
  App app("empty");
  EXPECT_NE(app.check().error().what.find("no source"), std::string::npos);
}

TEST(Graph, RefusesAnObserverOfNothing) {
  Builder b;
  b.app.add_module(XModule<State>("A").add_node(node("a1")).add_input_topic(kIn));
  b.app.on_message(Topic<int>("nowhere"), [](int, std::uint64_t) {});
  EXPECT_REFUSAL(b, "on_message watches topic 'nowhere', which nobody publishes");
}

TEST(Graph, ASampledTopicFiresNobodyAndMayGoInACircle) {
  Builder b;
  b.app.add_source(kOther, 25ms, [](std::uint64_t) { return 0; });
  b.app.add_module(XModule<State>("A")
                       .add_node(node("a1"))
                       .add_input_topic(kIn)
                       .add_sampled_topic(kOut)
                       .add_output_topic(kMid, &State::value));
  b.app.add_module(XModule<State>("B")
                       .add_node(node("b1"))
                       .add_input_topic(kOther)
                       .add_sampled_topic(kMid, 5ms)
                       .add_output_topic(kOut, &State::value));
  EXPECT_EQ(b.refusal(), "") << "a circle through inputs would be one";
}

TEST(Graph, RefusesATopicThatIsSampledAndAnInput) {
  Builder b;
  b.app.add_module(XModule<State>("A")
                       .add_node(node("a1"))
                       .add_input_topic(kIn)
                       .add_sampled_topic(kIn)
                       .add_output_topic(kMid, &State::value));
  EXPECT_REFUSAL(b, "XModule 'A' reads topic 'in' twice");
}

TEST(Graph, RefusesAModuleThatOnlySamplesAndASampleThatNobodyPublishes) {
  Builder b;
  b.app.add_module(XModule<State>("A").add_node(node("a1")).add_sampled_topic(kMid, -1ns));
  EXPECT_REFUSAL(b, "XModule 'A' has no input topic: it would never fire");
  EXPECT_REFUSAL(b, "topic 'mid' has no publisher, but XModule 'A' reads it");
  EXPECT_REFUSAL(b, "samples topic 'mid' with a negative age");
}

TEST(Graph, AModuleHasTheParametersOfItsXNodesEachOnce) {
  const Parameter<int> level("level", 3, 0, 9);
  const Parameter<bool> on("on", true);
  detail::AppSpecErased app;
  app.name = "test";
  const auto module = detail::make_xmodule("A", [] { return std::make_shared<int>(); });
  const auto handle = detail::make_parameter("level", std::int64_t{3}, 0, 9);
  const auto xnode = detail::make_xnode("a1");
  detail::add_impl(*xnode, XPU::CPU, {});
  detail::add_parameter(*xnode, handle);
  detail::add_parameter(*xnode, detail::make_parameter("on", true));
  detail::add_node(*module, xnode);
  detail::add_parameter(*module, handle);
  detail::add_input(*module, detail::topic_spec(kIn));
  app.modules.push_back(module);
  app.sources.push_back({*detail::topic_spec(kIn), Period{10'000}, {}});
  const auto graph = runtime::Graph::build(app);
  ASSERT_TRUE(graph) << graph.error().to_string();
  ASSERT_EQ(graph->modules[0].parameters.size(), 2u);
  EXPECT_EQ(graph->modules[0].parameters[0], handle);
  EXPECT_EQ(graph->modules[0].parameters[1]->name, "on");
}

TEST(Graph, RefusesParametersThatCannotBe) {
  Builder b;
  XNode<State> a1 = node("a1");
  a1.add_parameter(Parameter<double>("level", 0.5));
  b.app.add_module(XModule<State>("A")
                       .add_node(a1)
                       .add_input_topic(kIn)
                       .add_parameter(Parameter<int>("level", 3))
                       .add_parameter(Parameter<int>("beyond", 3, 4, 5))
                       .add_parameter(Parameter<std::uint64_t>("long", UINT64_MAX))
                       .add_parameter(Parameter<std::string>("a=b", "x")));
  EXPECT_REFUSAL(b, "XModule 'A' has two parameters called 'level'");
  EXPECT_REFUSAL(b, "parameter 'beyond': its default '3' is out of range; possible is 4 to 5");
  EXPECT_REFUSAL(b, "XModule 'A': parameter 'a=b' needs a name");
  EXPECT_EQ(b.refusal().find("'long'"), std::string::npos) << "it is what JSON can say at most";
}

TEST(Graph, RefusesMoreParametersThanFit) {
  Builder b;
  XModule<State> many("A");
  for (int i = 0; i < 257; ++i) many.add_parameter(Parameter<bool>("p" + std::to_string(i), true));
  b.app.add_module(many.add_node(node("a1")).add_input_topic(kIn));
  EXPECT_REFUSAL(b, "XModule 'A' has 257 parameters; at most 256 are possible");
}

/// camera -> A -> mid -> B (two XNodes); lidar is sampled by B.
struct Deadlines : Builder {
  Deadlines() {
    app.add_source(kOther, std::chrono::microseconds(100'000), [](std::uint64_t) { return 0; });
    app.add_module(XModule<State>("A").add_node(node("a")).add_input_topic(kIn).add_output_topic(
        kMid, &State::value));
    app.add_module(end);
  }
  XModule<State> end = XModule<State>("B")
                           .add_node(node("b1"))
                           .add_node(node("b2"))
                           .add_input_topic(kMid)
                           .add_sampled_topic(kOther)
                           .add_output_topic(kOut, &State::value);
};

TEST(Graph, DeadlinesAndClocksOfAProgramAreOfItsNames) {
  Deadlines b;
  b.app.deadline(90ms)
      .deadline(kIn, kOut, 50ms)
      .deadline(kOther, b.end, 70ms)
      .deadline(kIn, kMid, 5ms);
  b.app.clock(kIn, "camera").clock(kOther, "main", 7);
  EXPECT_EQ(b.refusal(), "");
}

TEST(Graph, RefusesDeadlinesAndClocksOfWhatIsNotThere) {
  Deadlines b;
  const Topic<int> gone("gone");
  b.app.deadline(kMid, kOut, 1ms).deadline(kIn, gone, 1ms).deadline(kIn, XModule<State>("C"), 1ms);
  b.app.deadline(kIn, kOut, 0ms).deadline(kIn, b.end, 1ms).deadline(0us).deadline(1us);
  b.app.clock(kMid, "x").clock(kIn, "", 1).clock(kOther, "c", 100'001).clock(kOther, "d");
  EXPECT_REFUSAL(b, "App::deadline begins at topic 'mid', which no source releases");
  EXPECT_REFUSAL(b, "App::deadline from 'in' to 'gone': no XModule publishes it");
  EXPECT_REFUSAL(b, "App::deadline from 'in' to 'C': that XModule is not in the app");
  EXPECT_REFUSAL(b, "App::deadline from 'in' to 'out': 0 us; possible are 1 to");
  EXPECT_REFUSAL(b, "App::deadline from 'in' to 'B' is said twice");
  EXPECT_REFUSAL(b, "App::deadline: 0 us; possible are 1 to");
  EXPECT_REFUSAL(b, "App::deadline of all chains is said twice");
  EXPECT_REFUSAL(b, "App::clock names topic 'mid', which no source releases");
  EXPECT_REFUSAL(b, "App::clock of 'in': a clock needs a name");
  EXPECT_REFUSAL(b, "App::clock of 'other': 100001 ppm; possible are 0 to 100000");
  EXPECT_REFUSAL(b, "App::clock of 'other' is said twice");
  Deadlines two;
  two.app.clock(kIn, "c", 5).clock(kOther, "c", 6);
  EXPECT_REFUSAL(two, "clock 'c' is off by at most 5 and by at most 6 ppm");
}

}  // namespace
}  // namespace xauto
