// SPDX-License-Identifier: Apache-2.0
// Emulation scripts in virtual time: cases by hand, and random ones against a second simulator that
// goes from nanosecond to nanosecond. No clock.
#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "emu/machine.h"
#include "emu/script_play.h"
#include "emu/snapshot.h"

#include "../cases.h"
#include "times.h"

namespace xauto::emu {
namespace {

Machine small(const EmulationScript& script) {
  auto machine = Machine::create(*Platform::builtin("small"), script);
  EXPECT_TRUE(machine) << machine.error().to_string();
  return std::move(*machine);
}

/// Until nothing happens any more: "done1@2000 ..." with times in us.
std::string play_out(Machine& machine) {
  std::string out;
  while (machine.next_event() != kNever) {
    std::vector<Event> events;
    machine.advance(machine.next_event(), events);
    for (const Event& e : events) {
      static const char* const kWords[] = {"done", "susp", "res", "stuck", "script"};
      out += (out.empty() ? "" : " ") + std::string(kWords[static_cast<int>(e.kind)]) +
             std::to_string(e.tag) + "@" + std::to_string(e.time / kUs);
    }
  }
  return out;
}

TEST(Script, AClockThatChangesInTheMiddleOfAJobChangesWhatIsLeft) {
  Machine m = small({{{1000, {{"gpu", 50}}}, {3000, {{"gpu", 200}}}}});
  const ContextId a = *m.open("gpu0", 0), b = *m.open("dla0", 0);
  ASSERT_TRUE(m.submit(a, 1, 4 * kMs, 7 * kMs));
  ASSERT_TRUE(m.submit(b, 2, 4 * kMs, 7 * kMs));
  // From the first work on: 1 ms whole, 2 ms at half the speed, the other 2 ms of work at twice.
  EXPECT_EQ(play_out(m), "script0@7000 script1@8000 script2@10000 done1@11000 done2@11000");
}

TEST(Script, BusyXpusSlowEachOtherDown) {
  Machine m = small({{{0, {}, {{"gpu", 20}, {"dla", 50}}}}});
  const ContextId gpu = *m.open("gpu0", 0), dla = *m.open("dla0", 0), cpu = *m.open("cpu0", 0);
  ASSERT_TRUE(m.submit(gpu, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.submit(dla, 2, 2 * kMs, 0));
  ASSERT_TRUE(m.submit(cpu, 3, 1 * kMs, 0));  // no contention of its type: nor is it counted
  // dla: 2 * 1.5 = 3 (rates are whole millionths: a microsecond may begin); gpu: 3 / 1.2, then alone.
  EXPECT_EQ(play_out(m), "script1@0 done3@1000 done2@3000 done1@5500");
}

TEST(Script, AStoppedXpuHoldsItsJobAndLetsNobodyTakeItOff) {
  Machine m = small({{{1000, {}, {}, {"gpu0"}}, {201'000, {}, {}, {}, {"gpu0"}}}});
  const ContextId on = *m.open("gpu0", 0), waits = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(on, 1, 5 * kMs, 0));
  std::vector<Event> events;
  m.advance(2 * kMs, events);
  ASSERT_TRUE(m.submit(waits, 2, 1 * kMs, 2 * kMs));
  ASSERT_TRUE(m.suspend(waits, 8, 2 * kMs)) << "not on the engine: at once";
  ASSERT_TRUE(m.resume(waits, 9, 2 * kMs));
  ASSERT_TRUE(m.suspend(on, 7, 2 * kMs));
  // Refused after 100 ms. It had 4 ms left, and the slice that had just ended: they take turns.
  EXPECT_EQ(play_out(m),
            "susp8@2000 res9@2000 stuck7@102000 script2@201000 done2@203275 done1@206275");
}

TEST(Script, AStoppedXpuThatGoesOnInTimeIsLeftThen) {
  Machine m = small({{{1000, {}, {}, {"gpu0"}}, {5000, {}, {}, {}, {"gpu0"}}}});
  const ContextId on = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(on, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.suspend(on, 7, 2 * kMs));
  EXPECT_EQ(play_out(m), "script0@0 script1@1000 script2@5000 susp7@5275");
  ASSERT_TRUE(m.resume(on, 8, 6 * kMs));
  EXPECT_EQ(play_out(m), "res8@6000 done1@10000");
}

TEST(Script, ResumingWhatCouldNotBeTakenOffAnswersWhoWaits) {
  Machine m = small({{{0, {}, {}, {"dla0"}}}});
  const ContextId on = *m.open("dla0", 0);
  ASSERT_TRUE(m.submit(on, 1, 1 * kMs, 0));
  ASSERT_TRUE(m.suspend(on, 7, 1 * kMs));
  ASSERT_TRUE(m.resume(on, 8, 2 * kMs));
  EXPECT_EQ(play_out(m), "script1@0 stuck7@2000 res8@2000");
  EXPECT_EQ(m.progress(on, 1), Progress::kUnderWay);
}

TEST(Script, AStoppedCpuIsMissingInThePool) {
  Machine m = small({{{0, {{"cpu", 50}}, {}, {"cpu0", "cpu3"}}}});
  for (std::uint64_t i = 1; i <= 3; ++i) ASSERT_TRUE(m.submit(*m.open("cpu", 0), i, 2 * kMs, 0));
  // Three on two cores of half the speed.
  EXPECT_EQ(play_out(m), "script1@0 done1@6000 done2@6000 done3@6000");
}

TEST(Script, RepetitionsBeginFromNominalXpus) {
  const EmulationScript script{{{1000, {{"gpu", 50}}}, {4000, {}, {}, {"gpu0"}}}, 10'000};
  const ScriptPlay played(script);
  std::mt19937_64 random(1);
  for (int i = 0; i < 10'000; ++i) {
    const Nanos t = static_cast<Nanos>(random() % 60'000'000);
    const Nanos within = t - t / 10'000'000 * 10'000'000;
    EXPECT_EQ(played.steps_at(t), within < 1'000'000 ? 0u : within < 4'000'000 ? 1u : 2u);
    const Nanos next = played.next_change(t);
    ASSERT_GT(next, t);
    EXPECT_NE(played.steps_at(next), played.steps_at(next - 1));
    EXPECT_EQ(played.steps_at(next - 1), played.steps_at(t));
  }
  Machine m = small(script);
  const ContextId a = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 4 * kMs, 0));
  std::vector<Event> events;
  m.advance(30 * kMs, events);
  // 1 + 1.5 in the first ten, 1 + 0.5 of the second: at 12 ms.
  EXPECT_TRUE(std::find(events.begin(), events.end(), Event{Event::Kind::kDone, a, 1, 12 * kMs}) !=
              events.end());
}

// ---- the second simulator -----------------------------------------------------------------------

constexpr Nanos kSlice = 3 * kUs, kSwitch = 1 * kUs, kPreempt = 2 * kUs;

Platform tiny() {
  return {"tiny",
          {{"cpu0", "cpu", true, 0, 0, -1},
           {"cpu1", "cpu", true, 0, 0, -1},
           {"gpu0", "gpu", true, 2, 3, 1},
           {"dla0", "dla", true, 2, 3, 1}}};
}

using Seen = std::tuple<Nanos, int, ContextId, std::uint64_t>;

/// One nanosecond after the other. The script is looked up each microsecond: it has no step in between.
class Naive {
 public:
  explicit Naive(EmulationScript script) : script_(std::move(script)) {}

  void open(ContextId id, std::size_t xpu) { contexts_[id].xpu = xpu; }
  void submit(ContextId id, std::uint64_t tag, Nanos work) {
    look();
    Context& c = contexts_[id];
    c.busy = true;
    c.tag = tag;
    c.left = work * kUnits;
    if (!c.suspended) xpus_[c.xpu].queue.push_back(id);
    if (begin_ < 0) {
      begin_ = now_;
      look();  // it is there before the script's first step
      obey();
    }
  }
  void suspend(ContextId id, std::uint64_t tag) {
    look();
    Context& c = contexts_[id];
    Xpu& x = xpus_[c.xpu];
    if (x.stopped && !c.suspended && on(c.xpu, id))
      x.waits.push_back({id, tag});
    else
      take_off(id, tag);
  }
  void resume(ContextId id, std::uint64_t tag) {
    look();
    Context& c = contexts_[id];
    Xpu& x = xpus_[c.xpu];
    for (std::size_t i = 0; i < x.waits.size();)
      if (x.waits[i].first == id) {
        seen.emplace_back(now_, static_cast<int>(Event::Kind::kStuck), id, x.waits[i].second);
        x.waits.erase(x.waits.begin() + static_cast<std::ptrdiff_t>(i));
      } else {
        ++i;
      }
    if (c.suspended && c.busy) x.queue.push_back(id);
    c.suspended = false;
    c.number = 0;
    seen.emplace_back(now_, static_cast<int>(Event::Kind::kResumed), id, tag);
  }
  void run(Nanos until) {
    while (now_ < until) tick();
  }
  [[nodiscard]] bool busy(ContextId id) const { return contexts_.at(id).busy; }
  std::vector<Seen> seen;

 private:
  struct Context {
    std::size_t xpu = 0;
    bool busy = false, suspended = false;
    std::uint64_t tag = 0;
    Nanos left = 0;
    int number = 0;  ///< of the preemption that took it off
  };
  struct Xpu {
    std::vector<ContextId> queue;
    bool on = false, stopped = false;
    Nanos slice = 0, blocked = 0, switching = 0;
    int number = 0;
    std::vector<std::pair<ContextId, std::uint64_t>> waits, acks;
  };

  [[nodiscard]] bool on(std::size_t x, ContextId id) const {
    const Xpu& xpu = xpus_[x];
    const bool there = !xpu.queue.empty() && xpu.queue.front() == id;
    return there && (x < 2 || xpu.on);
  }
  /// Who is first gets on, where nothing is in its way.
  void look() {
    for (std::size_t x = 2; x < 4; ++x) {
      Xpu& xpu = xpus_[x];
      if (xpu.stopped || xpu.on || xpu.queue.empty() || now_ < xpu.blocked || now_ < xpu.switching)
        continue;
      xpu.on = true;
      xpu.slice = kSlice;
    }
  }
  void take_off(ContextId id, std::uint64_t tag) {
    Context& c = contexts_[id];
    Xpu& x = xpus_[c.xpu];
    if (!c.suspended) {
      c.suspended = true;
      const bool was_on = c.busy && on(c.xpu, id);
      if (!x.queue.empty() && x.queue.front() == id) x.on = false;
      std::erase(x.queue, id);
      if (was_on && c.xpu >= 2) {
        if (x.blocked <= now_) ++x.number;
        x.blocked = std::max(x.blocked, now_) + kPreempt;
        c.number = x.number;
      }
    }
    if (c.number > 0 && c.number == x.number && x.blocked > now_)
      x.acks.push_back({id, tag});
    else
      seen.emplace_back(now_, static_cast<int>(Event::Kind::kSuspended), id, tag);
  }
  [[nodiscard]] std::int64_t percent(const char* type, bool speed) const {
    std::int64_t value = speed ? 100 : 0;
    if (begin_ < 0) return value;
    for (const EmulationStep& step : script_.steps) {
      if (begin_ + step.at_us * 1000 > now_) break;
      const auto& said = speed ? step.speed_pct : step.contention_pct;
      if (const auto found = said.find(type); found != said.end()) value = found->second;
    }
    return value;
  }
  /// The script stops XPUs and has them go on.
  void obey() {
    if (begin_ < 0 || (now_ - begin_) % 1000 != 0) return;
    for (std::size_t x = 0; x < 4; ++x) {
      speed_[x] = percent(kTypes[x], true);
      more_[x] = percent(kTypes[x], false);
      bool stopped = false;
      for (const EmulationStep& step : script_.steps) {
        if (begin_ + step.at_us * 1000 > now_) break;
        const auto names = [&](const std::vector<std::string>& list) {
          return std::find(list.begin(), list.end(), kIds[x]) != list.end();
        };
        if (names(step.stop)) stopped = true;
        if (names(step.start)) stopped = false;
      }
      if (!xpus_[x].stopped && stopped) look();
      xpus_[x].stopped = stopped;
      if (!stopped)
        for (const auto& [id, tag] : std::exchange(xpus_[x].waits, {})) take_off(id, tag);
    }
  }
  void tick() {
    look();
    Nanos busy = 0;
    for (std::size_t x = 0; x < 4; ++x)
      if (more_[x] > 0 && !xpus_[x].stopped && !xpus_[x].queue.empty()) ++busy;
    for (std::size_t x = 0; x < 4; ++x) {
      Xpu& xpu = xpus_[x];
      if (xpu.stopped || xpu.queue.empty() || now_ < xpu.blocked || now_ < xpu.switching) continue;
      const Nanos others = more_[x] > 0 ? busy - 1 : 0;
      const ContextId id = xpu.queue.front();
      Context& c = contexts_[id];
      c.left -= 1'000'000 * speed_[x] / (100 + more_[x] * others);
      --xpu.slice;
      if (c.left <= 0) {
        c.busy = false;
        xpu.on = false;
        xpu.queue.erase(xpu.queue.begin());
        seen.emplace_back(now_ + 1, static_cast<int>(Event::Kind::kDone), id, c.tag);
      } else if (x >= 2 && xpu.slice == 0) {
        xpu.slice = kSlice;
        if (xpu.queue.size() > 1) {
          std::rotate(xpu.queue.begin(), xpu.queue.begin() + 1, xpu.queue.end());
          xpu.on = false;
          xpu.switching = now_ + 1 + kSwitch;
        }
      }
    }
    ++now_;
    for (Xpu& xpu : xpus_)
      if (xpu.blocked <= now_)
        for (const auto& [id, tag] : std::exchange(xpu.acks, {}))
          seen.emplace_back(xpu.blocked, static_cast<int>(Event::Kind::kSuspended), id, tag);
    obey();
  }

  static constexpr const char* kIds[] = {"cpu0", "cpu1", "gpu0", "dla0"};
  static constexpr const char* kTypes[] = {"cpu", "cpu", "gpu", "dla"};
  EmulationScript script_;
  std::map<ContextId, Context> contexts_;
  Xpu xpus_[4];
  std::int64_t speed_[4] = {100, 100, 100, 100}, more_[4] = {};  ///< percent, as the script says
  Nanos now_ = 0, begin_ = -1;
};

EmulationScript random_script(std::mt19937& random) {
  EmulationScript script;
  std::int64_t at = static_cast<std::int64_t>(random() % 3);
  const int steps = 1 + static_cast<int>(random() % 8);
  std::set<std::string> stopped;
  for (int k = 0; k < steps; ++k, at += 1 + static_cast<std::int64_t>(random() % 9)) {
    EmulationStep step{at};
    for (const char* type : {"cpu", "gpu", "dla"}) {
      if (random() % 3 == 0) step.speed_pct[type] = 1 + static_cast<std::int64_t>(random() % 300);
      if (random() % 3 == 0) step.contention_pct[type] = static_cast<std::int64_t>(random() % 90);
    }
    for (const char* id : {"cpu0", "gpu0", "dla0"}) {
      if (random() % 4 != 0) continue;
      if (stopped.erase(id) > 0)
        step.start.emplace_back(id);
      else if (stopped.insert(id).second)
        step.stop.emplace_back(id);
    }
    if (step != EmulationStep{at}) script.steps.push_back(step);
  }
  if (script.steps.empty()) script.steps.push_back({at, {{"gpu", 50}}});
  return script;
}

/// The machine also dies now and then: what is restored must not be told from what went on.
TEST(Script, AgreesWithASecondSimulatorNanosecondByNanosecond) {
  std::map<int, int> kinds;
  int deaths = 0;
  const auto seeds = static_cast<unsigned>(test::cases(24, 600));
  for (unsigned seed = 0; seed < seeds && !HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    const EmulationScript script = random_script(random);
    auto made = Machine::create(tiny(), script);
    ASSERT_TRUE(made) << made.error().to_string();
    Machine machine = std::move(*made);
    Naive naive(script);
    std::vector<ContextId> contexts;
    for (const std::size_t xpu : {0, 1, 2, 2, 2, 3, 3}) {
      static const char* const kIds[] = {"cpu0", "cpu1", "gpu0", "dla0"};
      contexts.push_back(*machine.open(kIds[xpu], 0));
      naive.open(contexts.back(), xpu);
    }
    std::vector<Seen> seen;
    std::set<std::uint64_t> asked;  ///< suspensions without an answer
    Nanos now = 0;
    const auto collect = [&] {
      std::vector<Event> events;
      machine.advance(now, events);
      for (const Event& e : events) {
        if (e.kind == Event::Kind::kScript) continue;
        seen.emplace_back(e.time, static_cast<int>(e.kind), e.context, e.tag);
        ++kinds[static_cast<int>(e.kind)];
        if (e.kind == Event::Kind::kSuspended || e.kind == Event::Kind::kStuck) asked.erase(e.tag);
      }
    };
    std::uint64_t tag = 0;
    for (int op = 0; op < 60; ++op) {
      const ContextId id = contexts[random() % contexts.size()];
      const unsigned what = random() % 8;
      if (what < 3 && !naive.busy(id)) {
        const Nanos work = 1 + static_cast<Nanos>(random() % 9000);
        ASSERT_TRUE(machine.submit(id, ++tag, work, now));
        naive.submit(id, tag, work);
      } else if (what == 3) {
        asked.insert(++tag);
        ASSERT_TRUE(machine.suspend(id, tag, now));
        naive.suspend(id, tag);
      } else if (what == 4) {
        ASSERT_TRUE(machine.resume(id, ++tag, now));
        naive.resume(id, tag);
      } else if (what > 4) {
        now += static_cast<Nanos>(random() % 4000);
        naive.run(now);
      }
      collect();
      if (random() % 4 != 0 || !asked.empty()) continue;  // who waits would have to ask again
      Snapshot snapshot;
      machine.save(snapshot);
      auto next = Machine::restore(tiny(), snapshot, now, script);
      ASSERT_TRUE(next) << next.error().to_string();
      machine = std::move(*next);
      ++deaths;
    }
    now += 50'000;
    naive.run(now);
    collect();
    std::sort(seen.begin(), seen.end());
    std::sort(naive.seen.begin(), naive.seen.end());
    ASSERT_EQ(seen, naive.seen);
  }
  EXPECT_GT(deaths, static_cast<int>(seeds));
  EXPECT_GT(kinds[static_cast<int>(Event::Kind::kDone)], static_cast<int>(5 * seeds));
  EXPECT_GT(kinds[static_cast<int>(Event::Kind::kStuck)], 0);
}

TEST(Script, OfAnotherTimeOrPlatformIsRefused) {
  EXPECT_FALSE(Machine::create(tiny(), {{{0, {{"npu", 50}}}}}));
  Machine m = *Machine::create(tiny());
  ASSERT_TRUE(m.submit(*m.open("gpu0", 0), 1, kMs, 0));
  Snapshot snapshot;
  m.save(snapshot);
  EXPECT_EQ(snapshot.script_begin, 0);
  EXPECT_TRUE(Machine::restore(tiny(), snapshot, 0));
  snapshot.script_begin = 1;
  EXPECT_FALSE(Machine::restore(tiny(), snapshot, 10)) << "of the future";
  snapshot.script_begin = -2;
  EXPECT_FALSE(Machine::restore(tiny(), snapshot, 10));
  snapshot.script_begin = 0;
  snapshot.devices[1].now = 5;
  EXPECT_FALSE(Machine::restore(tiny(), snapshot, 10)) << "devices at different times";
}

}  // namespace
}  // namespace xauto::emu
