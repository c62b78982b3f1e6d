// SPDX-License-Identifier: Apache-2.0
// Firing and losing, step by step, without threads: the host is the test.
#include "runtime/xmodule.h"

#include <functional>
#include <random>
#include <span>
#include <sstream>
#include <string>

#include <gtest/gtest.h>
#include <uapi/xauto/event.h>

#include "graph/input_access.h"
#include "processes/board.h"

namespace xauto::runtime {
namespace {

using namespace std::chrono_literals;

struct Value {
  int out = 0;
};

class Fixture : public ::testing::Test, public ModuleHost {
 protected:
  void SetUp() override { build(true); }

  /// A module with inputs "a" and "b" and one output.
  /// ... and topics "s", "s1", ... sampled with these limits of age.
  void build(bool single_rate, const std::vector<std::chrono::nanoseconds>& samples = {}) {
    spec_ = {};
    spec_.name = "M";
    spec_.make_state = []() -> std::shared_ptr<void> { return std::make_shared<Value>(); };
    spec_.inputs = {*detail::topic_spec(Topic<int>("a")), *detail::topic_spec(Topic<int>("b"))};
    spec_.outputs = {{*detail::topic_spec(Topic<int>("c")), [](void*, detail::MessageMemory*) {
                        return std::make_shared<const int>(1);
                      }}};
    for (const auto limit : samples)
      spec_.samples.push_back(
          {*detail::topic_spec(Topic<int>(spec_.samples.empty() ? "s" : "s1")), limit.count()});
    graph_ = {};
    graph_.modules.push_back({"M", &spec_, {}, {}, {}, true});
    graph_.single_rate = graph_.modules.back().numbered = single_rate;
    graph_.tells_origins = !single_rate;
    graph_.modules.back().samples.assign(samples.size(), 0);
    graph_.modules.back().sample_origins.assign(samples.size(), ~0u);
    channel_ = {};
    channel_.subscribe([this](const detail::Envelope& e) {
      log_ += (e.message ? " out" : " tomb") + std::to_string(e.sequence) + (e.urgent ? "!" : "");
    });
    module_ = std::make_unique<ModuleRuntime>(graph_, 0, *this,
                                              std::vector<const transport::Channel*>{&channel_});
    log_.clear();
  }
  void message(int input, std::uint64_t sequence) {
    module_->receive(input, {std::make_shared<const int>(static_cast<int>(sequence)),
                             static_cast<std::int64_t>(1000 + sequence), sequence});
  }
  void tombstone(int input, std::uint64_t sequence) {
    module_->receive(input, {nullptr, 0, sequence});
  }
  /// Where there is one.
  Activation& only() { return module_->activation(0); }
  std::string log() { return std::exchange(log_, ""); }

  void activate(int, Activation& activation) override {
    log_ += " run" + std::to_string(activation.input().sequence());
  }
  void proceed(int, Activation& activation, std::size_t node) override {
    log_ += " go" + std::to_string(activation.input().sequence()) + "." + std::to_string(node);
  }
  void done(int, const Activation& activation) override {
    log_ += " done" + std::to_string(activation.input().sequence());
    if (auto then = std::exchange(at_done_, nullptr)) then();
  }
  void dropped(int, std::uint64_t s, std::uint32_t reason) override {
    log_ += (reason == XAUTO_DROP_FAILED    ? " failed"
             : reason == XAUTO_DROP_OVERRUN ? " overrun"
             : reason == XAUTO_DROP_HUNG    ? " hung"
             : reason == XAUTO_DROP_OFF     ? " off"
             : reason == XAUTO_DROP_SKIPPED ? " skipped"
                                            : " upstream") +
            std::to_string(s);
  }
  void skip(int, std::uint64_t s) override { log_ += " skip" + std::to_string(s); }
  void sampled(int, std::span<const detail::Envelope> messages) override {
    for (const detail::Envelope& e : messages)
      log_ += e.message ? " read" + std::to_string(e.sequence) : " nothing";
  }

  detail::XModuleSpec spec_;
  Graph graph_;
  transport::Channel channel_;
  std::unique_ptr<ModuleRuntime> module_;
  std::string log_;
  std::function<void()> at_done_;  ///< what somebody does who hears of an end
};

TEST_F(Fixture, WhatIsSampledFiresNobodyAndIsReadWhenTheActivationBegins) {
  const Topic<int> a("a"), s("s");
  build(true, {1us, 0us});
  message(2, 0);
  EXPECT_EQ(log(), "") << "a sample fires nobody";
  message(0, 0);
  message(1, 0);
  EXPECT_EQ(log(), " run0");
  message(2, 7);  // came after the activation was fired, before it began
  module_->begin(only(), 2007);
  EXPECT_EQ(*only().input().sampled(s), 7);
  EXPECT_EQ(only().input().age(s), 1000ns);
  EXPECT_EQ(only().input().age(a), 1007ns);
  EXPECT_THROW((void)only().input().get(s), std::logic_error) << "it may not be there";
  EXPECT_THROW((void)only().input().sampled(a), std::logic_error);
  message(2, 8);
  EXPECT_EQ(*only().input().sampled(s), 7) << "an activation has seen one thing";
  module_->finish(only(), true);
  EXPECT_EQ(log(), " read7 nothing done0 out0") << "the host is told what was read";
  message(0, 1);
  message(1, 1);
  module_->begin(only(), 2009);  // 8 is 1001 ns old: beyond its microsecond
  EXPECT_EQ(only().input().sampled(s), nullptr);
  EXPECT_LT(only().input().age(s).count(), 0);
  tombstone(2, 9);
  EXPECT_EQ(log(), " run1 nothing nothing")
      << "what was lost replaces nothing, and nobody waits for it";
}

TEST_F(Fixture, AReleaseInWhoseTableItIsOffGoesByAndNobodyWaits) {
  const auto board = Board::local({1, 1});
  ASSERT_TRUE(board);
  const auto put = [&](std::uint64_t us, std::uint32_t table) { board->put_table(us, table); };
  const auto message = [&](int input, std::uint64_t k) {  // of microsecond 1000 + k
    module_->receive(input, {std::make_shared<const int>(0),
                             static_cast<std::int64_t>(1'000'000 + 1000 * k), k});
  };
  const auto both = [&](std::uint64_t k) {
    message(0, k);
    message(1, k);
  };
  put(0, 0);
  module_->read_tables(*board, {0, 1});
  both(0);
  EXPECT_EQ(log(), " run0");
  put(1001, 1);
  both(1);
  EXPECT_EQ(log(), "") << "in its turn: release 0 has not ended";
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0 off1 skip1 tomb1");
  message(0, 2);
  EXPECT_EQ(log(), "") << "an input is missing";
  message(1, 2);
  EXPECT_EQ(log(), " off2 skip2 tomb2");
  message(0, 3);  // its other input is lost: it gives way to release 4
  message(0, 4);
  message(1, 4);
  EXPECT_EQ(log(), " overrun3 skip3 tomb3 off4 skip4 tomb4");
  put(1005, 0);
  both(5);
  EXPECT_EQ(log(), " run5");
  EXPECT_EQ(only().table(), 0u);
}

TEST_F(Fixture, AnActivationIsUrgentWhereOneOfItsInputsIsAndSoIsItsResult) {
  build(true, {1us});
  const auto urgent = [&](int input, std::uint64_t k) {
    module_->receive(input, {std::make_shared<const int>(0), 1000, k, nullptr, true});
  };
  urgent(2, 0);  // a sample hurries nobody
  message(0, 0);
  message(1, 0);
  EXPECT_FALSE(only().urgent());
  module_->finish(only(), true);
  message(0, 1);
  urgent(1, 1);
  EXPECT_TRUE(only().urgent());
  module_->finish(only(), true);
  message(0, 2);
  message(1, 2);
  EXPECT_FALSE(only().urgent()) << "the one before was";
  module_->finish(only(), true);
  EXPECT_EQ(log(), " run0 done0 out0 run1 done1 out1! run2 done2 out2");
}

TEST_F(Fixture, WhatItsProgramMarksIsUrgentForOthersAndNotTooOften) {
  std::shared_ptr<Board> board = Board::local({.processes = 1, .modules = 1});
  const auto both = [&](std::uint64_t k) {
    message(0, k);
    message(1, k);
  };
  spec_.urgent_if = [](const void*) { return true; };
  module_->let_mark(2, board->module(0));
  for (std::uint64_t k = 0; k < 4; ++k) {
    both(k);
    EXPECT_FALSE(only().urgent()) << "it has not run yet";
    module_->finish(only(), k != 2);
  }
  EXPECT_EQ(log(), " run0 done0 out0! run1 done1 out1 run2 failed2 skip2 tomb2 run3 done3 out3!");
  EXPECT_EQ(board->module(0).urgent_too_soon.load(), 1u);
  module_->let_mark(0, board->module(0));  // nothing certifies it
  both(4);
  module_->finish(only(), true);
  EXPECT_EQ(log(), " run4 done4 out4");
  EXPECT_EQ(board->module(0).urgent_unheard.load(), 1u);
}

TEST_F(Fixture, AnActivationCountsAsReleasedWithTheFirstOfItsComponentsSources) {
  module_->shift_origins({0, 500});  // source "b" has an offset of 500 ns
  module_->receive(0, {std::make_shared<const int>(0), 10'000, 0});
  module_->receive(1, {std::make_shared<const int>(0), 10'500, 0});
  EXPECT_EQ(only().input().origin().count(), 10'000);
  EXPECT_EQ(only().origin_of(1), 10'500) << "the message is as old as it is";
}

TEST_F(Fixture, FiresWhenAllInputsAreFresh) {
  message(0, 0);
  EXPECT_EQ(log(), "");
  message(1, 0);
  EXPECT_EQ(log(), " run0");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0");
}

TEST_F(Fixture, MessagesThatArriveMeanwhileWait) {
  message(0, 0);
  message(1, 0);
  message(0, 1);
  message(1, 1);
  EXPECT_EQ(log(), " run0");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0 run1");
}

TEST_F(Fixture, OverrunLosesTheOlderReleaseAfterTheOneInFlight) {
  message(0, 0);
  message(1, 0);
  message(0, 1);
  message(1, 1);
  log();
  message(0, 2);  // release 1 is lost; 0 is still in flight, so nothing may overtake it
  EXPECT_EQ(log(), "");
  message(1, 2);
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0 overrun1 skip1 tomb1 run2");
}

TEST_F(Fixture, FailureTravelsOnAsATombstone) {
  message(0, 0);
  message(1, 0);
  log();
  module_->finish(only(), false);
  EXPECT_EQ(log(), " failed0 skip0 tomb0");
}

TEST_F(Fixture, TombstoneOfOneInputLosesTheRelease) {
  message(0, 0);
  tombstone(1, 0);
  EXPECT_EQ(log(), " upstream0 skip0 tomb0");
  message(0, 1);
  message(1, 1);
  EXPECT_EQ(log(), " run1");
}

TEST_F(Fixture, SecondTombstoneOfOneReleaseIsSilent) {
  tombstone(0, 0);
  log();
  tombstone(1, 0);
  EXPECT_EQ(log(), "");
}

TEST_F(Fixture, EveryReleaseIsAccountedForOnce) {
  // One tombstone settles all before it; what comes late of a lost release is ignored.
  message(0, 0);
  tombstone(0, 3);
  EXPECT_EQ(log(), " upstream0 upstream1 upstream2 upstream3 skip3 tomb3");
  message(1, 2);
  EXPECT_EQ(log(), "");
}

TEST_F(Fixture, QueueKeepsReleasesInOrderUntilItIsFull) {
  module_->set_overload({Overload::Kind::kQueue, 2});
  for (std::uint64_t k = 0; k < 4; ++k) {
    message(0, k);
    message(1, k);
  }
  EXPECT_EQ(log(), " run0");  // 0 in flight, 2 and 3 wait
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0 overrun1 skip1 tomb1 run2");
  module_->finish(only(), true);
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done2 out2 run3 done3 out3");
}

TEST_F(Fixture, QueueLosesWhatIsLostUpstreamInItsTurn) {
  module_->set_overload({Overload::Kind::kQueue, 8});
  message(0, 0);
  message(1, 0);
  message(0, 1);
  message(1, 1);
  tombstone(0, 2);
  message(1, 2);
  message(0, 5);  // 3 and 4 were lost on the way
  message(1, 5);
  EXPECT_EQ(log(), " run0");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0 run1");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done1 out1 upstream2 upstream3 upstream4 skip4 tomb4 run5");
}

TEST_F(Fixture, SkipTakesNothingWhileItIsBusy) {
  module_->set_overload({Overload::Kind::kSkip, 1});
  message(0, 0);
  message(1, 0);
  message(0, 1);
  message(1, 1);
  EXPECT_EQ(log(), " run0");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done0 out0 skipped1 skip1 tomb1");
  message(0, 2);
  message(1, 2);
  EXPECT_EQ(log(), " run2");
}

/// In lockstep the next release comes as soon as the last one's end is told; it found the module busy.
TEST_F(Fixture, SkipTakesWhatAnEndLetsCome) {
  for (const bool numbered : {true, false}) {
    build(numbered);
    module_->set_overload({Overload::Kind::kSkip, 1});
    const auto next = [this](std::uint64_t sequence) {
      for (const int input : {0, 1}) message(input, sequence);
    };
    next(0);
    at_done_ = [&] { next(1); };
    EXPECT_EQ(log(), " run0");
    module_->finish(only(), true);
    EXPECT_EQ(log(), " done0 out0 run1");
    at_done_ = [&] {
      next(2);
      next(3);
    };
    module_->finish(only(), true);
    EXPECT_EQ(log(), numbered ? " done1 out1 skipped2 skip2 tomb2 run3"
                              : " done1 skipped2 skipped2 out1 run3");
    next(4);
    EXPECT_EQ(log(), numbered ? "" : " skipped4 skipped4");
  }
}

/// Whoever hears that k+1 is over takes an untold k for lost: so every release is told once, and
/// none before an older one, whatever comes while an activation is in flight.
TEST_F(Fixture, ReleasesEndInOrderUnderEveryOverloadPolicy) {
  std::mt19937 random(7);
  for (const Overload policy :
       {Overload{Overload::Kind::kNewest, 1}, Overload{Overload::Kind::kSkip, 1},
        Overload{Overload::Kind::kQueue, 3}})
    for (int run = 0; run < 200; ++run) {
      build(true);
      module_->set_overload(policy);
      std::string all;
      std::uint64_t next[2] = {0, 0};
      bool busy = false;
      const auto heard = [&] {
        const std::string said = log();
        if (said.find(" run") != std::string::npos) busy = true;
        all += said;
      };
      while (next[0] < 20 || next[1] < 20 || busy) {
        const auto what = random() % 4;
        if (what < 2 && next[what] < 20) {
          const std::uint64_t k = next[what]++;
          if (random() % 8 == 0)
            tombstone(static_cast<int>(what), k);
          else
            message(static_cast<int>(what), k);
        } else if (what >= 2 && busy) {
          busy = false;
          module_->finish(only(), random() % 8 != 0);
        }
        heard();
      }
      std::uint64_t expected = 0;
      std::istringstream words(all);
      for (std::string word; words >> word;)
        for (const char* end : {"done", "overrun", "skipped", "upstream", "failed"})
          if (word.rfind(end, 0) == 0) {
            EXPECT_EQ(word, end + std::to_string(expected)) << all;
            ++expected;
          }
      EXPECT_EQ(expected, 20u) << all;
    }
}

TEST_F(Fixture, OverloadPoliciesAreParsedStrictly) {
  EXPECT_EQ(Overload::parse("queue:4")->depth, 4u);
  EXPECT_EQ(Overload::parse("skip")->kind, Overload::Kind::kSkip);
  for (const char* wrong : {"", "queue", "queue:", "queue:0", "queue:257", "queue:4x", "drop"})
    EXPECT_FALSE(Overload::parse(wrong)) << wrong;
}

TEST_F(Fixture, AnAbandonedActivationIsLostAndSoIsWhatComesUntilItReturns) {
  module_->watch();
  message(0, 0);
  message(1, 0);
  message(0, 1);
  EXPECT_EQ(log(), " run0");
  EXPECT_TRUE(module_->abandon(0));
  EXPECT_EQ(log(), " hung0 hung1 skip1 tomb1");  // at once: nobody waits downstream
  EXPECT_TRUE(only().abandoned());
  EXPECT_FALSE(module_->abandon(0));
  message(1, 1);  // of a release that is settled
  message(0, 2);
  EXPECT_EQ(log(), " hung2 skip2 tomb2");
  tombstone(1, 3);
  EXPECT_EQ(log(), " hung3 skip3 tomb3");
  module_->finish(only(), true);  // it returned after all: too late
  EXPECT_EQ(log(), "");
  message(0, 4);
  message(1, 4);
  module_->finish(only(), true);
  EXPECT_EQ(log(), " run4 done4 out4");
}

TEST_F(Fixture, WhatHasEndedCannotBeAbandoned) {
  module_->watch();
  message(0, 0);
  message(1, 0);
  EXPECT_FALSE(module_->abandon(7));
  module_->finish(only(), true);
  EXPECT_FALSE(module_->abandon(0));
  EXPECT_EQ(log(), " run0 done0 out0");
}

TEST_F(Fixture, AnAbandonedActivationOfSeveralRates) {
  build(false);
  module_->watch();
  message(0, 0);
  message(1, 0);
  message(0, 1);
  EXPECT_TRUE(module_->abandon(0));
  message(1, 5);
  EXPECT_EQ(log(), " run0 hung0 hung1 hung5");
  module_->finish(only(), false);
  message(0, 2);
  message(1, 6);
  EXPECT_EQ(log(), " run2");
}

TEST_F(Fixture, MatchesMessagesWhoseOriginsAreClose) {
  build(false);
  module_->match_within(3);  // origins are 1000 + number
  message(0, 10);
  message(1, 2);  // 8 apart: it waits in vain, as all that comes on 0 is later still
  EXPECT_EQ(log(), " overrun2");
  message(1, 8);
  EXPECT_EQ(log(), " run8");
  EXPECT_EQ(InputAccess::messages(const_cast<Input&>(only().input()))[0].sequence, 10u);
  // While it is busy messages wait in order, none replaces another.
  for (const std::uint64_t k : {20u, 30u, 40u}) message(0, k);
  for (const std::uint64_t k : {29u, 41u}) message(1, k);
  EXPECT_EQ(log(), "");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done8 out8 overrun20 run29");
  module_->finish(only(), true);
  EXPECT_EQ(log(), " done29 out29 run40");
}

TEST_F(Fixture, MatchingKeepsABoundedNumberOfMessages) {
  build(false);
  module_->match_within(3);
  for (std::uint64_t k = 0; k < 18; ++k) message(0, k);
  EXPECT_EQ(log(), " overrun0 overrun1");
  module_->set_overload({Overload::Kind::kQueue, 2});
  message(0, 18);
  EXPECT_TRUE(log().ends_with(" overrun16"));
}

TEST_F(Fixture, OriginsOfAllSensorsTravelOn) {
  build(false);
  const auto send = [&](int input, std::uint64_t k, detail::Origins origins) {
    module_->receive(input, {std::make_shared<const int>(0), static_cast<std::int64_t>(k), k,
                             std::make_shared<const detail::Origins>(origins)});
  };
  send(0, 4, {400, 0, 390});
  send(1, 5, {395, 500, 0});
  module_->begin(only(), 600);
  ASSERT_TRUE(only().origins());
  EXPECT_EQ(*only().origins(), (detail::Origins{395, 500, 390}));
}

TEST_F(Fixture, SeveralRatesTakeTheNewestOfEach) {
  build(false);
  message(0, 0);
  message(0, 1);
  EXPECT_EQ(log(), " overrun0");
  message(1, 0);
  EXPECT_EQ(log(), " run0");  // the older release gives the number
  module_->finish(only(), false);
  EXPECT_EQ(log(), " failed0");  // numbers of several sensors don't compare: no tombstone
}

}  // namespace
}  // namespace xauto::runtime
