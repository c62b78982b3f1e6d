// SPDX-License-Identifier: Apache-2.0
// When a job may start before its planned start. Times are in us after the grid's begin, and no clock runs, but for the
// last tests, where a thread waits.
#include "runtime/early_start.h"

#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "base/clock.h"
#include "base/index.h"
#include "model/periodic.h"

namespace xauto::runtime {
namespace {

constexpr std::int64_t kBegin = 1'000'000'000;
constexpr std::int64_t kLong = 60'000'000'000;  ///< nobody waits for so long unless he is not woken

/// Modules of one XNode each, with the source of the same name or behind another.
class EarlyExample {
 public:
  EarlyExample() {
    app_.name = "example";
    platform_.xpus = {{"dla0", "dla", false}, {"gpu0", "gpu", true, 100}, {"cpu0", "cpu"}};
  }
  int source(std::int64_t period_us, std::size_t clock = 0, std::int64_t offset_us = 0) {
    while (app_.clocks.size() <= clock) app_.clocks.push_back({"c" + std::to_string(clock), 1000});
    const auto s = static_cast<int>(app_.sources.size());
    SourceSpec& spec = app_.sources.emplace_back();
    spec.name = "s" + std::to_string(s);
    spec.period = {period_us};
    spec.offset_us = offset_us;
    spec.clock = static_cast<int>(clock);
    return s;
  }
  int xnode(const std::string& xpu, std::vector<int> sources, std::vector<std::int64_t> key_us,
            std::vector<std::int64_t> hold_us = {}) {
    const auto x = static_cast<int>(app_.xnodes.size());
    XNodeSpec& spec = app_.xnodes.emplace_back();
    spec.name = "x" + std::to_string(x);
    spec.module = "m" + std::to_string(x);
    spec.wcet_us = {{"dla", 1000}, {"gpu", 1000}, {"cpu", 1000}};
    spec.sources = std::move(sources);
    policy_.placements.push_back(
        {platform_.find(xpu), std::move(key_us), std::move(hold_us), {}, {}});
    return x;
  }
  void edge(int u, int v) { app_.edges.emplace_back(u, v); }
  void reads_all(int reader) {
    policy_.placements[at(reader)].reads_all = true;
    early_.reset();
  }
  void sample(int u, int v) { app_.samples.emplace_back(u, v); }
  void urgent(int source, std::int64_t by_us) {
    app_.sources[at(source)].urgent = UrgentSpec{by_us, 1'000'000};
  }
  /// `x` takes longer beside a load of that type, and the policy counts that it does not meet one; or that it may.
  void beside(int x, const std::string& type, bool apart) {
    const std::string& on = platform_.xpus[at(policy_.placements[at(x)].xpu)].type;
    app_.xnodes[at(x)].beside = {{on, {{type, 1}}, 1500}};
    policy_.placements[at(x)].wcet_us = apart ? 1000 : 1500;
  }
  void share(const std::string& xpu) { shared_[at(platform_.find(xpu))] = true; }
  EarlyStart& made() {
    if (!early_) {
      complete_modules(app_);
      early_ = EarlyStart::make(app_, platform_, policy_, shared_).value();
      begin(kBegin);
    }
    return *early_;
  }
  /// All sources are on our clock, but for the one that publishes by itself.
  void begin(std::int64_t start_ns) {
    (void)made();
    for (std::size_t s = 0; s < app_.sources.size(); ++s)
      if (static_cast<int>(s) != pushed) early_->due(s, start_ns);
  }
  int pushed = -1;
  /// Of activation 0 of `x`, which is not urgent.
  [[nodiscard]] PlannedJob job(int x) {
    return {kBegin + policy_.placements[at(x)].key_us[0] * 1000,
            kBegin + made().planned_us().ordinary[at(x)].at(0) * 1000};
  }
  [[nodiscard]] bool may(int x) { return made().may_start(at(x), job(x)); }
  void ended(int x, std::uint64_t n) { made().ended(at(x), n); }

 private:
  AppSpec app_;
  Platform platform_;
  Policy policy_;
  std::vector<bool> shared_ = {false, false, false};
  std::unique_ptr<EarlyStart> early_;
};

/// docs/keys.md, "Early start", last paragraph: the keys of other apps that are to come are not known.
TEST(EarlyStart, NotWhereAnotherAppWouldPayForIt) {
  for (const char* xpu : {"dla0", "gpu0", "cpu0"}) {
    EarlyExample e;
    e.share(xpu);
    const int held = e.xnode(xpu, {e.source(100'000)}, {60'000}, {50'000});
    EXPECT_EQ(e.may(held), xpu != std::string("gpu0")) << xpu;
  }
}

TEST(EarlyStart, WaitsForAllOfSmallerKeysAlsoForThoseThatAreNotReleased) {
  for (const char* xpu : {"dla0", "gpu0"}) {
    EarlyExample e;
    const int slow = e.source(100'000), fast = e.source(20'000);
    const int held = e.xnode(xpu, {slow}, {60'000}, {50'000});
    const int often = e.xnode(xpu, {fast}, {10'000});
    EXPECT_FALSE(e.may(held));
    e.ended(often, 0);
    EXPECT_FALSE(e.may(held)) << "nothing that is released by now has a smaller key";
    e.ended(often, 1);
    EXPECT_FALSE(e.may(held)) << "activation 2 has its key at 50 ms";
    e.ended(often, 2);
    EXPECT_TRUE(e.may(held)) << "activation 3 has its key at 70 ms";
  }
}

TEST(EarlyStart, AnEqualKeyIsWaitedForAndALargerOneIsNot) {
  EarlyExample e;
  const int s = e.source(100'000);
  const int held = e.xnode("dla0", {s}, {60'000}, {50'000});
  const int equal = e.xnode("dla0", {s}, {60'000});
  (void)e.xnode("dla0", {s}, {60'001});
  (void)e.xnode("cpu0", {s}, {1'000});
  EXPECT_FALSE(e.may(held));
  e.ended(equal, 0);
  EXPECT_TRUE(e.may(held));
}

TEST(EarlyStart, WhereItsPlanKeepsItApartItWaitsForTheOtherXpu) {
  for (const bool counts : {true, false})
    for (const bool minds : {true, false}) {
      EarlyExample e;
      const int s = e.source(100'000), other_clock = e.source(100'000, 1);
      const int held = e.xnode("cpu0", {s}, {60'000}, {50'000});
      const int before = e.xnode("gpu0", {s}, {50'000});
      (void)e.xnode("gpu0", {s}, {50'001});            // behind the planned start
      (void)e.xnode("gpu0", {other_clock}, {40'000});  // that one is met, and counts
      (void)e.xnode("dla0", {s}, {40'000});            // nobody minds it
      minds ? e.beside(held, "gpu", counts) : e.beside(before, "cpu", counts);
      EXPECT_EQ(e.may(held), !counts);
      e.ended(before, 0);
      EXPECT_TRUE(e.may(held));
    }
}

TEST(EarlyStart, KeysAreThoseOfTheActivation) {
  EarlyExample e;
  const int s = e.source(100'000), t = e.source(50'000);
  const int held = e.xnode("dla0", {s}, {70'000}, {60'000});
  const int other = e.xnode("dla0", {t}, {10'000, 30'000});
  e.ended(other, 0);
  EXPECT_TRUE(e.may(held)) << "50 + 30 ms";
  EarlyExample f;
  (void)f.source(100'000), (void)f.source(50'000);
  const int again = f.xnode("dla0", {s}, {70'000}, {60'000});
  const int first = f.xnode("dla0", {t}, {30'000, 10'000});
  f.ended(first, 0);
  EXPECT_FALSE(f.may(again)) << "50 + 10 ms";
}

TEST(EarlyStart, WherePreemptingIsFreeNobodyOnTheXpuIsWaitedFor) {
  EarlyExample e;
  const int s = e.source(100'000);
  const int held = e.xnode("cpu0", {s}, {60'000}, {50'000});
  (void)e.xnode("cpu0", {s}, {10'000});
  EXPECT_TRUE(e.may(held));
}

/// A wrong version has the hold in place of the planned start: what is behind a held job then starts when that job has
/// ended early, before one of a smaller key that its window counts on.
TEST(EarlyStart, WhoIsBehindAHeldJobWaitsLikeIt) {
  EarlyExample e;
  const int s = e.source(100'000);
  const int held = e.xnode("cpu0", {s}, {60'000}, {50'000});
  const int behind = e.xnode("dla0", {}, {80'000});
  const int other = e.xnode("dla0", {s}, {70'000}, {50'000});
  const int free = e.xnode("dla0", {s}, {90'000});
  e.edge(held, behind);
  EXPECT_EQ(e.made().planned_us().ordinary[at(behind)], std::vector<std::int64_t>{50'000});
  EXPECT_TRUE(e.made().planned_us().ordinary[at(free)].empty()) << "no hold delays it";
  EXPECT_TRUE(e.may(held));
  e.ended(held, 0);
  EXPECT_FALSE(e.may(behind));
  e.ended(other, 0);
  EXPECT_TRUE(e.may(behind));
}

TEST(EarlyStart, AReaderWaitsForWhatItsPlanReads) {
  EarlyExample e;
  const int s = e.source(100'000), t = e.source(20'000);
  const int reader = e.xnode("cpu0", {s}, {60'000}, {30'000});
  const int read = e.xnode("gpu0", {t}, {8'000});
  e.sample(read, reader);
  EXPECT_FALSE(e.may(reader));
  e.ended(read, 0);
  EXPECT_FALSE(e.may(reader)) << "activation 1 has its key at 28 ms";
  e.ended(read, 1);
  EXPECT_TRUE(e.may(reader)) << "activation 2 has it at 48 ms";
}

/// What is released before its planned start, and has its key later, no claim counts on.
TEST(EarlyStart, OfAnotherClockItWaitsForThoseKeysAsWell) {
  for (const std::int64_t key_us : {20'001, 20'000}) {
    EarlyExample e;
    const int s = e.source(100'000), t = e.source(20'000, 1, 10'000);
    const int reader = e.xnode("cpu0", {s}, {60'000}, {50'000});
    const int read = e.xnode("gpu0", {t}, {key_us});
    e.sample(read, reader);
    EXPECT_FALSE(e.may(reader)) << "activation 0 has its key at 30 ms";
    e.ended(read, 0);
    EXPECT_EQ(e.may(reader), key_us > 20'000) << "activation 1 has it at 50 ms, or behind it";
    e.ended(read, 1);
    EXPECT_TRUE(e.may(reader));
  }
}

TEST(EarlyStart, WhoReadsAllWaitsForAllThatAnotherClockReleasesBefore) {
  for (const std::int64_t offset_us : {10'000, 9'999}) {
    EarlyExample e;
    const int s = e.source(100'000), t = e.source(20'000, 1, offset_us);
    const int reader = e.xnode("cpu0", {s}, {60'000}, {30'000});
    const int read = e.xnode("gpu0", {t}, {20'001});
    e.sample(read, reader);
    EXPECT_EQ(e.may(reader), offset_us == 10'000) << "activation 0 has its key behind 30 ms";
    e.reads_all(reader);
    EXPECT_FALSE(e.may(reader));
    e.ended(read, 0);
    EXPECT_EQ(e.may(reader), offset_us == 10'000) << "activation 1 is released at 30 ms, or sooner";
  }
}

TEST(EarlyStart, WhatMayBeUrgentHasTheKeyOfAnUrgentRelease) {
  EarlyExample e;
  const int s = e.source(100'000), t = e.source(50'000);
  const int held = e.xnode("dla0", {s}, {60'000}, {50'000});
  const int other = e.xnode("dla0", {t}, {20'000});
  e.urgent(t, 11'000);
  e.ended(other, 0);
  EXPECT_FALSE(e.may(held)) << "50 + 20 - 11 ms";
  e.ended(other, 1);
  EXPECT_TRUE(e.may(held));
}

TEST(EarlyStart, WhatWillNotComeHasEnded) {
  EarlyExample e;
  const int s = e.source(100'000), t = e.source(20'000);
  const int held = e.xnode("dla0", {s}, {60'000}, {50'000});
  const int often = e.xnode("dla0", {t}, {10'000});
  e.ended(often, 2);
  EXPECT_TRUE(e.may(held));
  e.ended(often, 1);  // told late: an older one, by another thread
  EXPECT_TRUE(e.may(held));
}

TEST(EarlyStart, OfAClockThatIsNotOursTheNextReleaseIsAsEarlyAsItMayBe) {
  const auto may_with_key = [](std::int64_t key_us, int releases) {
    EarlyExample e;
    const int s = e.source(100'000);
    e.pushed = e.source(20'000, 1);  // 1000 ppm
    const int held = e.xnode("dla0", {s}, {key_us}, {40'000});
    const int other = e.xnode("dla0", {e.pushed}, {10'000});
    e.ended(other, 1);
    for (int n = 0; n < releases; ++n)
      e.made().released(at(e.pushed), static_cast<std::uint64_t>(n), kBegin + n * 20'000'000);
    return e.may(held);
  };
  EXPECT_FALSE(may_with_key(41'000, 0)) << "nothing is known of it";
  EXPECT_FALSE(may_with_key(49'970, 1))
      << "activation 2 is 40 ms after 0, less 40 us, and rounding";
  EXPECT_TRUE(may_with_key(49'950, 1));
  EXPECT_TRUE(may_with_key(49'970, 2)) << "of a newer one less is in doubt";
  EXPECT_FALSE(may_with_key(49'985, 2));
}

TEST(EarlyStart, OfTwoSourcesOfAComponentTheEarlierCounts) {
  EarlyExample e;
  const int s = e.source(100'000), t = e.source(50'000), later = e.source(50'000, 0, 7'000);
  const int held = e.xnode("dla0", {s}, {60'000}, {40'000});
  const int join = e.xnode("dla0", {t, later}, {10'000});
  e.ended(join, 0);
  EXPECT_FALSE(e.may(held)) << "activation 1 is released at 50 ms, and has its key at 60";
  EarlyExample f;
  (void)f.source(100'000), (void)f.source(50'000, 0, 1'000), (void)f.source(50'000, 0, 7'000);
  const int again = f.xnode("dla0", {s}, {60'000}, {40'000});
  const int one = f.xnode("dla0", {t, later}, {10'000});
  f.ended(one, 0);
  EXPECT_TRUE(f.may(again)) << "51 + 10 ms";
}

TEST(EarlyStart, AJobThatSleepsIsWokenWhenTheLastReasonHasGone) {
  EarlyExample e;
  const int s = e.source(100'000), t = e.source(20'000);
  const int held = e.xnode("dla0", {s}, {60'000}, {50'000});
  const int often = e.xnode("dla0", {t}, {10'000});
  EarlyStart& early = e.made();
  const std::int64_t from = now_ns() + kLong;
  e.begin(from);
  const PlannedJob job{from + 60'000'000, from + 50'000'000};
  bool slept = false;
  std::thread thread([&] { slept = early.wait(at(held), job); });
  for (std::uint64_t n = 0; n < 3; ++n) early.ended(at(often), n);
  thread.join();
  EXPECT_EQ(early.count().jobs, 1U);
  EXPECT_GT(early.count().sum_ns, kLong / 2);
  EXPECT_FALSE(early.wait(at(held), job)) << "it does not sleep";
  EXPECT_EQ(early.count().jobs, 2U);
}

TEST(EarlyStart, WithAReasonItSleepsUntilThePlannedStart) {
  EarlyExample e;
  const int s = e.source(100'000);
  const int held = e.xnode("dla0", {s}, {60'000}, {50'000});
  (void)e.xnode("dla0", {s}, {10'000});
  EarlyStart& early = e.made();
  const std::int64_t from = now_ns();
  e.begin(from);
  EXPECT_TRUE(early.wait(at(held), {from + 60'000'000, from + 50'000'000}));
  EXPECT_GE(now_ns(), from + 50'000'000);
  EXPECT_FALSE(early.wait(at(held), {from + 60'000'000, from + 50'000'000})) << "it has come";
  EXPECT_EQ(early.count().jobs, 0U);
}

/// Two jobs wait, and look at each other's XNode: the one of the smaller key goes, then the other.
TEST(EarlyStart, OfTwoThatWaitOneLetsTheOtherGo) {
  EarlyExample e;
  const int s = e.source(100'000);
  const int first = e.xnode("dla0", {s}, {60'000}, {50'000});
  const int second = e.xnode("dla0", {s}, {70'000}, {55'000});
  EarlyStart& early = e.made();
  const std::int64_t from = now_ns() + kLong;
  e.begin(from);
  std::vector<int> order;
  std::thread thread([&] {
    (void)early.wait(at(second), {from + 70'000'000, from + 55'000'000});
    order.push_back(second);
  });
  EXPECT_FALSE(early.wait(at(first), {from + 60'000'000, from + 50'000'000}));
  order.push_back(first);
  early.ended(at(first), 0);
  thread.join();
  EXPECT_EQ(order, (std::vector<int>{first, second}));
  EXPECT_EQ(early.count().jobs, 2U);
}

}  // namespace
}  // namespace xauto::runtime
