// SPDX-License-Identifier: Apache-2.0
// xauto/testing.h, as a test of an app would use it.
#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include <gtest/gtest.h>

#include <xauto/emu.h>
#include <xauto/testing.h>
#include <xauto/xauto.h>

namespace xauto {
namespace {

using namespace std::chrono_literals;

struct Seen {
  int sum = 0;
  std::string text;
};

struct Model {
  Model(emu::Context c, int& n) : context(std::move(c)), alive(n) { ++alive; }
  ~Model() { --alive; }
  emu::Context context;
  int& alive;
};

/// number, word -> detect (gpu 8 ms, cpu 20 ms; owns its context) -> write (cpu, computes) -> line
class TestingTest : public ::testing::Test {
 protected:
  TestingTest() {
    const auto emulated = [this](const XPU& xpu, std::chrono::microseconds work) {
      detect.add_impl(
          xpu,
          [this](const XpuId& id) {
            auto context = emu::Context::open(id);
            if (!context) throw std::runtime_error(context.error().to_string());
            const SchedHandle handle = context->handle();
            opened = id.name;
            return own(std::make_unique<Model>(std::move(*context), alive), handle);
          },
          [this, work](Model& engine, Seen& state, const Input& input) -> Status {
            state.sum += input.get(number);
            return engine.context.run(work);
          });
    };
    emulated(XPU::GPU, 8ms);
    emulated(XPU::CPU, 20ms);
    write.add_impl(
        XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); },
        [this](Seen& state, const Input& input) -> Status {
          if (input.get(word).empty()) return fail(ErrorCode::kInvalid, "no word");
          if (input.get(word) == "boom") throw std::runtime_error("boom");
          state.text =
              input.get(word) + std::to_string(state.sum) + "#" + std::to_string(input.sequence());
          return {};
        });
    module.add_node(detect).add_node(write).add_input_topic(number).add_input_topic(word);
    module.add_output_topic(line, &Seen::text);
  }

  const Topic<int> number{"number"};
  const Topic<std::string> word{"word"}, line{"line"};
  XNode<Seen> detect{"detect"}, write{"write"};
  XModule<Seen> module{"M"};
  int alive = 0;
  std::string opened;
};

TEST_F(TestingTest, FiresOnMessagesMadeByHandInVirtualTime) {
  const auto before = std::chrono::steady_clock::now();
  {
    testing::Fire fire(module);
    const auto first = fire.put(number, 3).put(word, std::string("a")).run();
    ASSERT_TRUE(first) << first.error().to_string();
    EXPECT_EQ(first->get(line), "a3#0");
    EXPECT_EQ(first->xnodes(), (std::vector<std::string>{"detect", "write"}));
    EXPECT_EQ(first->start("detect"), 0ms);
    EXPECT_EQ(first->end("detect"), 8ms);
    EXPECT_EQ(first->start("write"), 8ms);
    EXPECT_EQ(first->end("write"), 8ms);
    // The state and what init made go on; "word" is still there.
    const auto second = fire.put(number, 4).run();
    ASSERT_TRUE(second);
    EXPECT_EQ(second->get(line), "a7#1");
    EXPECT_EQ(second->end("detect"), 16ms);
    EXPECT_EQ(first->get(line), "a3#0");
    EXPECT_EQ(opened, "gpu0");
    EXPECT_EQ(alive, 1);
  }
  EXPECT_EQ(alive, 0);
  // An hour of virtual time would not sleep either.
  EXPECT_LT(std::chrono::steady_clock::now() - before, 30s);
}

TEST_F(TestingTest, TheXpuIsTheTestsChoice) {
  testing::Fire fire(module);
  const auto outcome = fire.on("detect", XPU::CPU).put(number, 1).put(word, std::string("a")).run();
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  EXPECT_EQ(opened, "cpu0");
  EXPECT_EQ(outcome->end("detect"), 20ms);
}

TEST_F(TestingTest, ErrorsOfExecNameTheXNodeAndTheNextFiringWorks) {
  testing::Fire fire(module);
  const auto returned = fire.put(number, 1).put(word, std::string()).run();
  ASSERT_FALSE(returned);
  EXPECT_EQ(returned.error().to_string(), "exec of XNode 'write' on cpu0: no word");
  const auto threw = fire.put(word, std::string("boom")).run();
  ASSERT_FALSE(threw);
  EXPECT_EQ(threw.error().to_string(), "exec of XNode 'write' on cpu0: threw: boom");
  const auto good = fire.put(word, std::string("a")).run();
  ASSERT_TRUE(good);
  EXPECT_EQ(good->get(line), "a3#2");
}

/// 10 ms of virtual time pass in each firing.
TEST(Testing, WhatIsSampledMayBeMissingAndGrowsOld) {
  struct Looked {
    int speed = -1;
    std::chrono::nanoseconds age{};
  };
  const Topic<int> tick("tick"), speed("speed"), out("out");
  XNode<Looked> node("look");
  auto context = std::make_shared<std::optional<emu::Context>>();
  node.add_impl(
      XPU::CPU,
      [context](const XpuId& xpu) {
        *context = std::move(*emu::Context::open(xpu));
        return (*context)->handle();
      },
      [=](Looked& seen, const Input& input) -> Status {
        const int* newest = input.sampled(speed);
        seen = Looked{newest == nullptr ? -1 : *newest, input.age(speed)};
        return (*context)->run(10ms);
      });
  XModule<Looked> module("Look");
  module.add_node(node)
      .add_input_topic(tick)
      .add_sampled_topic(speed, 15ms)
      .add_output_topic(out, &Looked::speed);
  testing::Fire fire(module);
  fire.put(tick, 1);
  const auto next = [&] {
    const auto outcome = fire.run();
    EXPECT_TRUE(outcome) << outcome.error().to_string();
    return outcome->get(out);
  };
  EXPECT_EQ(next(), -1) << "nothing has come, and nobody waits for it";
  fire.put(speed, 7);
  EXPECT_EQ(next(), 7);
  EXPECT_EQ(next(), 7) << "10 ms old";
  EXPECT_EQ(next(), -1) << "20 ms old: beyond its limit";
}

TEST_F(TestingTest, AnXNodeMayAskWhetherThereIsTime) {
  XNode<Seen> choose("choose");  // detect has taken 8 ms before it
  choose.add_impl(
      XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); },
      [](Seen& state, const Input& input) {
        state.text = input.time_for(6ms) ? "better" : "shorter";
        if (input.result_due() != input.due()) state.text = "one of them is wrong";
      });
  module.add_node(choose);
  testing::Fire fire(module);
  fire.put(number, 1).put(word, std::string("a"));
  const auto took = [&] {
    const auto outcome = fire.run();
    return outcome ? outcome->get(line) : outcome.error().to_string();
  };
  EXPECT_EQ(took(), "better") << "nothing says by when";
  fire.due(14ms);
  EXPECT_EQ(took(), "better");
  fire.due(14ms - 1ns);
  EXPECT_EQ(took(), "shorter");
  fire.due(0ms);
  EXPECT_NE(took().find("above 0"), std::string::npos);
}

TEST_F(TestingTest, MistakesOfTheTestAreToldTogether) {
  testing::Fire fire(module);
  const auto outcome = fire.on("detect", XPU::DLA)
                           .on("detekt", XPU::GPU)
                           .put(Topic<int>("word"), 1)
                           .put(Topic<int>("other"), 1)
                           .run();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().code, ErrorCode::kInvalid);
  for (const char* told :
       {"no implementation for 'dla'", "no XNode 'detekt'", "topic 'word' carries",
        "topic 'other' is neither an input", "topic 'number' has no message"})
    EXPECT_NE(outcome.error().what.find(told), std::string::npos) << outcome.error().what;
}

TEST_F(TestingTest, AnInitThatThrowsIsToldAndWhatIsNoOutputThrows) {
  XNode<Seen> broken("broken");
  broken.add_impl(
      XPU::GPU, [](const XpuId&) -> SchedHandle { throw std::runtime_error("no weights"); },
      [](Seen&, const Input&) {});
  XModule<Seen> lonely("lonely");
  lonely.add_node(broken).add_input_topic(number);
  const auto failed = testing::Fire(lonely).put(number, 1).run();
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().to_string(), "init of XNode 'broken' on gpu0: threw: no weights");
  testing::Fire fire(module);
  const auto outcome = fire.put(number, 1).put(word, std::string("a")).run();
  ASSERT_TRUE(outcome);
  EXPECT_THROW((void)outcome->get(number), std::logic_error);
  EXPECT_THROW((void)outcome->get(Topic<int>("line")), std::logic_error);
}

TEST_F(TestingTest, ParametersAreAsDeclaredUntilTheyAreSet) {
  const Parameter<bool> on("on", true);
  const Parameter<unsigned char> level("level", 200);
  const Parameter<double> gain("gain", 0.5, 0, 1);
  const Parameter<std::string> mode("mode", "day");
  const Parameter<int> nobodys("nobodys", 1);
  const Topic<int> tick("tick");
  const Topic<std::string> out("out");
  XNode<std::string> node("node");
  bool ask = false;
  node.add_impl(
      XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); },
      [&](std::string& seen, const Input& input) {
        seen = std::to_string(input.value(on)) + std::to_string(input.value(level)) +
               std::to_string(input.value(gain)) + input.value(mode);
        if (ask) (void)input.value(nobodys);
      });
  node.add_parameter(level).add_parameter(on);
  XModule<std::string> steered("steered");
  steered.add_node(node).add_input_topic(tick).add_output_topic(
      out, [](std::string& seen) { return seen; });
  steered.add_parameter(on).add_parameter(gain).add_parameter(mode);
  testing::Fire fire(steered);
  EXPECT_EQ(fire.put(tick, 1).run()->get(out), "12000.500000day");
  fire.set(on, false).set(level, static_cast<unsigned char>(7)).set(gain, 1.0);
  EXPECT_EQ(fire.set(mode, std::string("night")).run()->get(out), "071.000000night");
  EXPECT_EQ(fire.run()->get(out), "071.000000night");
  const auto beyond = fire.set(gain, 1.5).set(nobodys, 2).run();
  ASSERT_FALSE(beyond);
  EXPECT_NE(beyond.error().what.find("parameter 'gain' '1.5' is out of range"), std::string::npos);
  EXPECT_NE(beyond.error().what.find("parameter 'nobodys' is not declared"), std::string::npos);
  ask = true;
  const auto threw = fire.run();
  ASSERT_FALSE(threw);
  EXPECT_NE(threw.error().what.find("parameter 'nobodys' is declared neither by this XModule"),
            std::string::npos);
}

TEST(Testing, ATopicThatIsAddedByNameCarriesWhatIsPut) {
  XNode<Seen> node("n");
  node.add_impl(
      XPU::CPU, [](const XpuId&) { return SchedHandle::thread(); },
      [](Seen& state, const Input& input) { state.sum = input.get<int>("number"); });
  XModule<Seen> module("M");
  const Topic<int> out("out");
  module.add_node(node).add_input_topic("number").add_output_topic(out, &Seen::sum);
  testing::Fire fire(module);
  const auto good = fire.put(Topic<int>("number"), 7).run();
  ASSERT_TRUE(good) << good.error().to_string();
  EXPECT_EQ(good->get(out), 7);
  testing::Fire wrong(module);
  EXPECT_FALSE(wrong.put(Topic<std::string>("number"), std::string("seven")).run());
}

}  // namespace
}  // namespace xauto
