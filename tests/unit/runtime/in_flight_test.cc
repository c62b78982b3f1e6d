// SPDX-License-Identifier: Apache-2.0
// Several activations of one module at once, without threads: the host is the test. What is checked
// is what the theory of windows asks of the runtime (docs/keys.md): activation n enters when
// n - N has left, each XNode takes activations in order, results leave in order.
#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <uapi/xauto/event.h>

#include "runtime/xmodule.h"

namespace xauto::runtime {
namespace {

/// A module of one input, one output and three XNodes.
class SeveralAtOnce : public ::testing::Test, public ModuleHost {
 protected:
  static constexpr std::size_t kNodes = 3;

  void build(int in_flight, Overload overload = {Overload::Kind::kQueue, 8}, bool numbered = true) {
    spec_ = {};
    spec_.name = "M";
    spec_.make_state = []() -> std::shared_ptr<void> { return std::make_shared<int>(0); };
    spec_.inputs = {*detail::topic_spec(Topic<int>("a"))};
    spec_.outputs = {
        {*detail::topic_spec(Topic<int>("b")), [](void* state, detail::MessageMemory*) {
           return std::make_shared<const int>(*static_cast<int*>(state));
         }}};
    graph_ = {};
    graph_.modules.push_back({"M", &spec_, {}, {}, {}, true});
    graph_.single_rate = graph_.modules.back().numbered = numbered;
    channel_ = {};
    channel_.subscribe([this](const detail::Envelope& e) {
      say(e.message ? "out" : "tomb", e.sequence);
      if (e.message) {
        EXPECT_EQ(*std::static_pointer_cast<const int>(e.message), static_cast<int>(e.sequence))
            << "the result of another activation's state";
      }
    });
    module_ = std::make_unique<ModuleRuntime>(graph_, 0, *this,
                                              std::vector<const transport::Channel*>{&channel_},
                                              std::vector<detail::MessageMemory*>{}, in_flight);
    module_->set_overload(overload);
    module_->watch();
    log_.clear();
    ready_.clear();
  }
  void message(std::uint64_t sequence) {
    module_->receive(
        0, {std::make_shared<const int>(0), static_cast<std::int64_t>(1000 + sequence), sequence});
  }
  void say(const char* what, std::uint64_t sequence) {
    log_ += std::string(" ") + what + std::to_string(sequence);
  }
  std::string log() { return std::exchange(log_, ""); }
  /// Its next XNode, if no older activation is in the way.
  bool enter(std::uint64_t sequence) { return module_->enter(*ready_.at(sequence)); }
  void pass(std::uint64_t sequence) { module_->pass(*ready_.at(sequence)); }
  void finish(std::uint64_t sequence, bool succeeded = true) {
    Activation& activation = *ready_.at(sequence);
    *static_cast<int*>(activation.state()) = static_cast<int>(sequence);
    module_->finish(activation, succeeded);
  }

  void activate(int, Activation& activation) override {
    ready_[activation.input().sequence()] = &activation;
    say("run", activation.input().sequence());
  }
  void proceed(int, Activation& activation, std::size_t node) override {
    say("go", activation.input().sequence());
    log_ += "." + std::to_string(node);
  }
  void done(int, const Activation& activation) override {
    say("done", activation.input().sequence());
  }
  void dropped(int, std::uint64_t s, std::uint32_t reason) override {
    say(reason == XAUTO_DROP_FAILED    ? "failed"
        : reason == XAUTO_DROP_OVERRUN ? "overrun"
        : reason == XAUTO_DROP_SKIPPED ? "skipped"
        : reason == XAUTO_DROP_HUNG    ? "hung"
                                       : "upstream",
        s);
  }
  void left(int) override { log_ += " left"; }
  void skip(int, std::uint64_t s) override { say("skip", s); }

  detail::XModuleSpec spec_;
  Graph graph_;
  transport::Channel channel_;
  std::unique_ptr<ModuleRuntime> module_;
  std::map<std::uint64_t, Activation*> ready_;  ///< what was activated, by sequence
  std::string log_;
};

TEST_F(SeveralAtOnce, TheNextOneStartsWhileTheFirstIsUnderWay) {
  build(2);
  for (std::uint64_t k = 0; k < 3; ++k) message(k);
  EXPECT_EQ(log(), " run0 run1") << "the third waits for room";
  EXPECT_NE(ready_[0]->state(), ready_[1]->state());
  finish(0);
  EXPECT_EQ(log(), " done0 out0 left run2");
}

TEST_F(SeveralAtOnce, EachXNodeTakesThemInOrder) {
  build(3);
  for (std::uint64_t k = 0; k < 3; ++k) message(k);
  log();
  EXPECT_TRUE(enter(0));
  EXPECT_FALSE(enter(1));
  EXPECT_FALSE(enter(2));
  pass(0);  // 0 is through with the first XNode
  EXPECT_EQ(log(), " go1.0");
  EXPECT_TRUE(enter(0));
  pass(1);
  EXPECT_EQ(log(), " go2.0");
  EXPECT_FALSE(enter(1)) << "0 is at the second";
  pass(2);
  EXPECT_FALSE(enter(2));
  pass(0);
  EXPECT_EQ(log(), " go1.1");
}

TEST_F(SeveralAtOnce, ResultsLeaveInOrderAndWhoFailsHoldsItsPlace) {
  build(3);
  for (std::uint64_t k = 0; k < 4; ++k) message(k);
  log();
  EXPECT_TRUE(enter(0));
  pass(0);
  finish(1, false);  // its first XNode has failed
  EXPECT_EQ(log(), "") << "0 is older, and its result has not left";
  EXPECT_TRUE(enter(2)) << "1 is in nobody's way any more";
  pass(2);
  EXPECT_FALSE(enter(2)) << "0 is at the second";
  finish(0);
  EXPECT_EQ(log(), " go2.1 done0 out0 left failed1 left skip1 tomb1 run3");
}

TEST_F(SeveralAtOnce, WhatIsLostMeanwhileIsToldInItsTurn) {
  build(2);
  message(0);
  message(1);
  module_->receive(0, {nullptr, 0, 2});
  message(3);
  EXPECT_EQ(log(), " run0 run1");
  finish(0);
  EXPECT_EQ(log(), " done0 out0 left run3");
  finish(3);
  EXPECT_EQ(log(), "");
  finish(1);
  EXPECT_EQ(log(), " done1 out1 left upstream2 skip2 tomb2 done3 out3 left");
}

TEST_F(SeveralAtOnce, OneThatDoesNotReturnTakesItsOwnRoomOnly) {
  build(2);
  message(0);
  message(1);
  message(2);
  log();
  EXPECT_TRUE(enter(0));
  EXPECT_FALSE(enter(1));
  EXPECT_TRUE(module_->abandon(0));
  EXPECT_EQ(log(), " go1.0 hung0 skip0 tomb0 left") << "1 goes on; there is no room for 2";
  finish(1);
  EXPECT_EQ(log(), " done1 out1 left run2");
  EXPECT_TRUE(module_->abandon(2));
  message(3);
  EXPECT_EQ(log(), " hung2 skip2 tomb2 left hung3 skip3 tomb3") << "no room is left";
  module_->finish(*ready_[0], true);  // it returned after all
  EXPECT_EQ(log(), "");
  message(4);
  EXPECT_EQ(log(), " run4");
  finish(4);
  EXPECT_EQ(log(), " done4 out4 left");
}

TEST_F(SeveralAtOnce, WhatIsGivenUpBehindAnOlderOneIsToldAfterIt) {
  build(3);
  for (std::uint64_t k = 0; k < 3; ++k) message(k);
  log();
  EXPECT_TRUE(module_->abandon(1));
  EXPECT_EQ(log(), " left");
  module_->finish(*ready_[1], false);  // its room is free, its place is held
  message(3);
  EXPECT_EQ(log(), " run3");
  finish(2);
  EXPECT_EQ(log(), "");
  finish(0);
  EXPECT_EQ(log(), " done0 out0 left hung1 skip1 tomb1 done2 out2 left");
}

TEST_F(SeveralAtOnce, OverloadCountsWhenThereIsNoRoom) {
  build(2, {Overload::Kind::kSkip, 1});
  for (std::uint64_t k = 0; k < 3; ++k) message(k);
  EXPECT_EQ(log(), " run0 run1");
  finish(0);
  EXPECT_EQ(log(), " done0 out0 left");
  message(3);
  finish(1);
  EXPECT_EQ(log(), " run3 done1 out1 left skipped2 skip2 tomb2");
  build(2, {Overload::Kind::kNewest, 1}, false);
  for (std::uint64_t k = 0; k < 4; ++k) message(k);
  EXPECT_EQ(log(), " run0 run1 overrun2") << "without numbers it is told at once";
}

/// Whatever happens: who is settled is settled once and in order, and nobody is let in too early.
/// What is expected is computed from the events alone.
class Anything : public SeveralAtOnce, public ::testing::WithParamInterface<int> {
 protected:
  struct Job {
    Activation* activation;
    std::uint64_t number;  ///< in the order of being activated
    std::size_t node = 0;
    bool asked = false, inside = false, hung = false;
  };

  void activate(int, Activation& activation) override {
    const std::uint64_t sequence = activation.input().sequence();
    EXPECT_TRUE(activated_.empty() || activated_.back() < sequence);
    const std::size_t number = activated_.size();
    activated_.push_back(sequence);
    const auto most = static_cast<std::size_t>(GetParam());
    // One that hung and returned has room before its turn to be settled comes.
    if (number >= most && !any_hung_) {
      EXPECT_TRUE(settled_.contains(activated_[number - most]));
    }
    EXPECT_LT(jobs_.size(), most);
    jobs_.push_back({&activation, number});
  }
  void proceed(int, Activation& activation, std::size_t node) override {
    Job& job = of(activation);
    EXPECT_TRUE(job.asked && !job.inside);
    EXPECT_EQ(job.node, node);
    go_in(job);
  }
  void done(int, const Activation& activation) override { settle(activation.input().sequence()); }
  void dropped(int, std::uint64_t sequence, std::uint32_t) override { settle(sequence); }
  void skip(int, std::uint64_t s) override {
    EXPECT_GE(s + 1, skipped_);
    skipped_ = s + 1;
    for (const Job& job : jobs_)
      EXPECT_TRUE(job.hung || job.activation->input().sequence() > s) << "it still runs";
  }
  void left(int) override {}

  Job& of(const Activation& activation) {
    return *std::find_if(jobs_.begin(), jobs_.end(), [&](const Job& job) {
      return job.activation == &activation && !job.hung;
    });
  }
  void go_in(Job& job) {
    for (const Job& other : jobs_)
      if (!other.hung && other.number < job.number) {
        EXPECT_GT(other.node, job.node) << "an older one is not through with it";
      }
    job.inside = true;
  }
  void settle(std::uint64_t sequence) {
    EXPECT_EQ(sequence, settled_.size()) << "each once, in order";
    settled_.insert(sequence);
  }

  std::vector<Job> jobs_;
  std::vector<std::uint64_t> activated_;
  std::set<std::uint64_t> settled_;
  std::uint64_t skipped_ = 0;
  bool any_hung_ = false;
};

TEST_P(Anything, IsSettledOnceAndInOrder) {
  for (unsigned seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed * 8 + static_cast<unsigned>(GetParam()));
    const auto at_most = [&](std::size_t n) {
      return std::uniform_int_distribution<std::size_t>(0, n)(random);
    };
    const Overload overloads[] = {
        {Overload::Kind::kQueue, 3}, {Overload::Kind::kNewest, 1}, {Overload::Kind::kSkip, 1}};
    build(GetParam(), overloads[seed % 3]);
    jobs_.clear(), activated_.clear(), settled_.clear(), skipped_ = 0, any_hung_ = false;
    std::uint64_t next = 0, results = 0, told = 0;
    channel_.subscribe([&](const detail::Envelope& e) {
      EXPECT_GE(e.sequence, told);
      EXPECT_TRUE(settled_.contains(e.sequence));
      told = e.sequence + 1;
      results += e.message ? 1 : 0;
    });
    const auto end = [&](std::size_t at, bool succeeded) {
      Job job = jobs_[at];
      jobs_.erase(jobs_.begin() + static_cast<std::ptrdiff_t>(at));
      *static_cast<int*>(job.activation->state()) =
          static_cast<int>(job.activation->input().sequence());
      module_->finish(*job.activation, succeeded);
    };
    const auto step = [&](bool may_fail) {
      const std::size_t at = at_most(jobs_.size() - 1);
      Job& job = jobs_[at];
      if (job.hung) return end(at, at_most(1) != 0);
      if (!job.asked) {
        job.asked = true;
        if (module_->enter(*job.activation)) go_in(job);
      } else if (job.inside) {
        const std::size_t dice = may_fail ? at_most(19) : 19;
        if (dice == 0) {
          job.hung = any_hung_ = true;  // the module tells others to go on meanwhile
          const std::uint64_t sequence = job.activation->input().sequence();
          EXPECT_TRUE(module_->abandon(sequence));
        } else if (dice < 3) {
          job.node = kNodes;
          end(at, false);
        } else if (job.node + 1 == kNodes) {
          job.node = kNodes;
          end(at, true);
        } else {
          ++job.node;
          job.asked = job.inside = false;
          module_->pass(*job.activation);
        }
      }
    };
    for (int i = 0; i < 300; ++i) {
      const std::size_t dice = at_most(9);
      if (dice == 0) ++next;  // lost on the way
      if (dice < 3)
        message(next++);
      else if (dice == 3)
        module_->receive(0, {nullptr, 0, next++});
      else if (!jobs_.empty())
        step(true);
    }
    while (!jobs_.empty()) step(false);
    module_->receive(0, {nullptr, 0, next++});  // what was lost on the way before it is known now
    EXPECT_EQ(settled_.size(), next);
    EXPECT_EQ(told, next);
    EXPECT_GT(results, 5u);
  }
}

INSTANTIATE_TEST_SUITE_P(UpToFour, Anything, ::testing::Values(1, 2, 3, 4));

}  // namespace
}  // namespace xauto::runtime
