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

}  // namespace
}  // namespace xauto
