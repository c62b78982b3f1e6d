// SPDX-License-Identifier: Apache-2.0
// The machine that went on and the one that was restored cannot be told apart; memory that was torn
// or is somebody else's is not believed. No clock.
#include "emu/snapshot.h"

#include <limits>
#include <random>
#include <string>
#include <vector>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include "emu/state_memory.h"

#include "times.h"

namespace xauto::emu {
namespace {

Platform platform() {
  return *Platform::builtin("small");
}

Snapshot saved(const Machine& machine) {
  Snapshot snapshot;
  machine.save(snapshot);
  return snapshot;
}

/// As bytes and back, as through the memory.
Snapshot carried(const Snapshot& snapshot) {
  std::vector<std::byte> bytes(snapshot.bytes());
  snapshot.encode(bytes.data());
  auto again = Snapshot::decode(bytes);
  EXPECT_TRUE(again) << again.error().to_string();
  return again ? std::move(*again) : Snapshot{};
}

std::string text(const Event& e) {
  return std::to_string(static_cast<int>(e.kind)) + " of context " + std::to_string(e.context) +
         " tag " + std::to_string(e.tag) + " at " + std::to_string(e.time);
}

/// Two machines that are given the same operations; the second one dies now and then.
class Twins {
 public:
  explicit Twins(unsigned seed)
      : random_(seed), one_(*Machine::create(platform())), two_(*Machine::create(platform())) {}

  void play(int steps) {
    for (int step = 0; step < steps && !::testing::Test::HasFailure(); ++step) {
      switch (random_() % 12) {
        case 0:
          open();
          break;
        case 1:
          close();
          break;
        case 2:
        case 3:
        case 4:
          submit();
          break;
        case 5:
        case 6:
          suspend();
          break;
        case 7:
        case 8:
          resume();
          break;
        case 9:
          die();
          break;
        default:
          pass(static_cast<Nanos>(random_() % 900'000));
      }
    }
    pass(1000 * kMs);  // whatever is being suspended is
    for (auto& [id, c] : contexts_)
      if (c.suspended) {
        ASSERT_TRUE(one_.resume(id, ++tags_, now_));
        ASSERT_TRUE(two_.resume(id, tags_, now_));
      }
    pass(3600 * 1000 * kMs);
    EXPECT_EQ(jobs_, done_);
    EXPECT_GT(deaths_, 0);
  }
  [[nodiscard]] int acks_lost() const { return acks_lost_; }

 private:
  struct Known {
    bool busy = false, suspended = false;
    std::uint64_t asked = 0;  ///< suspension that is not acknowledged
  };

  std::map<ContextId, Known>::iterator any() {
    auto at = contexts_.begin();
    if (!contexts_.empty()) std::advance(at, random_() % contexts_.size());
    return at;
  }
  void open() {
    if (contexts_.size() >= 9) return;
    static const char* const kDevices[] = {"gpu0", "gpu0", "dla0", "cpu0", "cpu"};
    const char* device = kDevices[random_() % 5];
    const auto a = one_.open(device, now_), b = two_.open(device, now_);
    ASSERT_TRUE(a && b);
    ASSERT_EQ(*a, *b);
    contexts_[*a] = {};
  }
  void close() {
    const auto at = any();
    // Its acknowledgement would come from the one and not from the other.
    if (at == contexts_.end() || at->second.asked != 0 || contexts_.size() < 4) return;
    one_.close(at->first, now_);
    two_.close(at->first, now_);
    jobs_ -= at->second.busy ? 1 : 0;
    contexts_.erase(at);
  }
  void submit() {
    const auto at = any();
    if (at == contexts_.end() || at->second.busy) return;
    const Nanos work = 1 + static_cast<Nanos>(random_() % (4 * kMs));
    ASSERT_TRUE(one_.submit(at->first, ++tags_, work, now_));
    ASSERT_TRUE(two_.submit(at->first, tags_, work, now_));
    at->second.busy = true;
    ++jobs_;
  }
  void suspend() {
    const auto at = any();
    if (at == contexts_.end() || at->second.asked != 0) return;
    ASSERT_TRUE(one_.suspend(at->first, ++tags_, now_));
    ASSERT_TRUE(two_.suspend(at->first, tags_, now_));
    at->second.suspended = true;
    at->second.asked = tags_;
  }
  /// As the runtime does it: not before the suspension has been acknowledged.
  void resume() {
    const auto at = any();
    if (at == contexts_.end() || at->second.asked != 0) return;
    ASSERT_TRUE(one_.resume(at->first, ++tags_, now_));
    ASSERT_TRUE(two_.resume(at->first, tags_, now_));
    at->second.suspended = false;
  }
  void pass(Nanos time) {
    now_ += time;
    std::vector<Event> a, b;
    one_.advance(now_, a);
    two_.advance(now_, b);
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      ASSERT_EQ(text(a[i]), text(b[i]));
      const auto at = contexts_.find(a[i].context);
      if (a[i].kind == Event::Kind::kDone) {
        if (at == contexts_.end()) continue;
        ++done_;
        at->second.busy = false;
      } else if (a[i].kind == Event::Kind::kSuspended && at != contexts_.end()) {
        EXPECT_EQ(at->second.asked, a[i].tag);
        at->second.asked = 0;
      }
    }
    ASSERT_EQ(one_.next_event(), two_.next_event());
  }
  void die() {
    pass(0);  // what has happened has been told, or will be asked for
    auto next = Machine::restore(platform(), carried(saved(two_)), now_);
    ASSERT_TRUE(next) << next.error().to_string();
    two_ = std::move(*next);
    std::map<std::uint64_t, ContextId> again;  // in the order in which they were asked for
    for (const auto& [id, c] : contexts_)
      if (c.asked != 0) again[c.asked] = id;
    for (const auto& [tag, id] : again) ASSERT_TRUE(two_.suspend(id, tag, now_));
    acks_lost_ += static_cast<int>(again.size());
    ++deaths_;
    for (std::size_t i = 0; i < one_.stats().size(); ++i) {
      const DeviceStats a = one_.stats()[i], b = two_.stats()[i];
      ASSERT_EQ(a.busy_ns, b.busy_ns);
      ASSERT_EQ(a.overhead_ns, b.overhead_ns);
      ASSERT_EQ(a.preemptions, b.preemptions);
      ASSERT_EQ(a.switches, b.switches);
      ASSERT_EQ(a.jobs, b.jobs);
    }
  }

  std::mt19937 random_;
  Machine one_, two_;
  std::map<ContextId, Known> contexts_;
  Nanos now_ = 0;
  std::uint64_t tags_ = 0;
  int jobs_ = 0, done_ = 0, deaths_ = 0, acks_lost_ = 0;
};

TEST(Snapshot, AMachineThatDiesAtRandomMomentsGoesOnAsOneThatDoesNot) {
  int acks_lost = 0;
  for (unsigned seed = 0; seed < 400 && !HasFailure(); ++seed) {
    SCOPED_TRACE(seed);
    Twins twins(seed);
    twins.play(250);
    acks_lost += twins.acks_lost();
  }
  EXPECT_GT(acks_lost, 50);  // the case is among them
}

TEST(Snapshot, ASuspendedContextStaysSuspended) {
  Machine m = *Machine::create(platform());
  const ContextId low = *m.open("gpu0", 0), high = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(low, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.suspend(low, 2, 1 * kMs));
  ASSERT_TRUE(m.submit(high, 3, 2 * kMs, 1 * kMs));
  std::vector<Event> events;
  m.advance(2 * kMs, events);
  Machine next = *Machine::restore(platform(), carried(saved(m)), 50 * kMs);
  events.clear();
  next.advance(50 * kMs, events);  // the outage is over: the device went on meanwhile
  EXPECT_EQ(events, (std::vector<Event>{{Event::Kind::kDone, high, 3, 3'275'000}}));
  EXPECT_EQ(next.progress(low, 1), Progress::kUnderWay);
  EXPECT_EQ(next.next_event(), kNever);
  ASSERT_TRUE(next.resume(low, 4, 60 * kMs));
  events.clear();
  next.advance(70 * kMs, events);
  ASSERT_EQ(events.size(), 2u);
  EXPECT_EQ(events[1], (Event{Event::Kind::kDone, low, 1, 64 * kMs}));
}

TEST(Snapshot, WhatCannotBeIsRefused) {
  Machine m = *Machine::create(platform());
  const ContextId a = *m.open("gpu0", 0), b = *m.open("gpu0", 0);
  ASSERT_TRUE(m.submit(a, 1, 5 * kMs, 0));
  ASSERT_TRUE(m.submit(b, 2, 5 * kMs, 0));
  ASSERT_TRUE(m.suspend(b, 3, 0));
  std::vector<Event> events;
  m.advance(1 * kMs, events);
  const Snapshot good = saved(m);
  ASSERT_EQ(good.contexts.size(), 2u);
  const auto refused = [&](auto change) {
    Snapshot bad = good;
    change(bad);
    return !Machine::restore(platform(), bad, 1 * kMs);
  };
  EXPECT_FALSE(refused([](Snapshot&) {}));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices.pop_back(); }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].name ^= 1; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].now = 2 * kMs; }));  // of the future
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].blocked_until = kNever; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].slice_left = 2 * kMs; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].slice_left = 0; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].on_device = 2; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].contexts = 1; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.devices[4].contexts = 3; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[0].id = s.contexts[1].id; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[0].id = 0; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[0].id = s.next_id; }));
  EXPECT_TRUE(refused([](Snapshot& s) { std::swap(s.contexts[0], s.contexts[1]); }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[0].left = 0; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[0].left = kMaxWorkNs * kUnits + 1; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[1].busy = 0; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[1].block = 2; }));
  EXPECT_TRUE(refused([](Snapshot& s) { s.contexts[0].zero = 1; }));

  Platform gate = platform();
  gate.xpus[4].preemptive = false;
  EXPECT_FALSE(Machine::restore(gate, good, 1 * kMs));  // nothing can be suspended on it
  EXPECT_FALSE(Machine::restore(*Platform::builtin("large"), good, 1 * kMs));
}

TEST(Snapshot, BytesOfAnotherLengthAreRefused) {
  Machine m = *Machine::create(platform());
  ASSERT_TRUE(m.open("gpu0", 0));
  const Snapshot good = saved(m);
  std::vector<std::byte> bytes(good.bytes());
  good.encode(bytes.data());
  for (std::size_t n = 0; n < bytes.size(); ++n)
    EXPECT_FALSE(Snapshot::decode({bytes.data(), n})) << n;
  EXPECT_TRUE(Snapshot::decode(bytes));
  bytes.emplace_back();
  EXPECT_FALSE(Snapshot::decode(bytes));
}

// ---- the memory ------------------------------------------------------------------------------

class Memory : public ::testing::Test {
 protected:
  void SetUp() override { fd_ = std::move(*StateMemory::make()); }
  [[nodiscard]] Result<StateMemory> map() const {
    return StateMemory::map(UniqueFd(fcntl(fd_.get(), F_DUPFD_CLOEXEC, 3)));
  }
  [[nodiscard]] static Snapshot numbered(ContextId n) {
    Snapshot snapshot = saved(*Machine::create(platform()));
    snapshot.next_id = n;
    return snapshot;
  }
  UniqueFd fd_;
};

TEST_F(Memory, TheLastStateIsFoundByTheNextProcess) {
  EXPECT_EQ(map()->load()->has_value(), false);
  for (ContextId n = 1; n < 8; ++n) {
    map()->save(numbered(n));
    EXPECT_EQ((*map()->load())->next_id, n);
  }
}

TEST_F(Memory, CannotBeShortenedAndAnotherSizeIsRefused) {
  EXPECT_NE(ftruncate(fd_.get(), 4096), 0);
  EXPECT_FALSE(StateMemory::map(UniqueFd(memfd_create("test", MFD_CLOEXEC))));
}

/// A save is stopped after each of its bytes in turn: what is found is the state before it or the
/// state after it. The copy is written in the order of save(): number 0, content, number.
TEST_F(Memory, AWriterThatDiesInTheMiddleLeavesAWholeState) {
  std::vector<char> before(static_cast<std::size_t>(lseek(fd_.get(), 0, SEEK_END)));
  std::vector<char> after(before.size());
  for (ContextId n = 1; n <= 3; ++n) map()->save(numbered(n));
  ASSERT_EQ(pread(fd_.get(), before.data(), before.size(), 0), static_cast<ssize_t>(before.size()));
  map()->save(numbered(4));
  ASSERT_EQ(pread(fd_.get(), after.data(), after.size(), 0), static_cast<ssize_t>(after.size()));
  std::vector<std::size_t> changed;
  for (std::size_t i = 0; i < before.size(); ++i)
    if (before[i] != after[i]) changed.push_back(i);
  ASSERT_GT(changed.size(), 1u);
  // Its number is the first thing of the copy: 2 becomes 4.
  const std::size_t number = changed.front();
  ASSERT_EQ(before[number], 2);
  ASSERT_EQ(after[number], 4);
  const auto put = [&](std::size_t at, char value) {
    ASSERT_EQ(pwrite(fd_.get(), &value, 1, static_cast<off_t>(at)), 1);
  };
  ASSERT_EQ(pwrite(fd_.get(), before.data(), before.size(), 0),
            static_cast<ssize_t>(before.size()));
  EXPECT_EQ((*map()->load())->next_id, 3u);
  put(number, 0);
  for (std::size_t i = 1; i < changed.size(); ++i) {
    EXPECT_EQ((*map()->load())->next_id, 3u);
    put(changed[i], after[changed[i]]);
  }
  EXPECT_EQ((*map()->load())->next_id, 3u);
  put(number, after[number]);
  EXPECT_EQ((*map()->load())->next_id, 4u);
}

TEST_F(Memory, BytesThatNobodyHasSavedAreNotBelieved) {
  map()->save(numbered(1));
  map()->save(numbered(2));
  std::vector<char> all(static_cast<std::size_t>(lseek(fd_.get(), 0, SEEK_END)));
  ASSERT_EQ(pread(fd_.get(), all.data(), all.size(), 0), static_cast<ssize_t>(all.size()));
  int refused = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (all[i] == 0) continue;
    const char flipped = static_cast<char>(all[i] ^ 0x10);
    ASSERT_EQ(pwrite(fd_.get(), &flipped, 1, static_cast<off_t>(i)), 1);
    auto state = map();
    const auto found = state ? state->load() : fail(ErrorCode::kInvalid, "not mapped");
    if (!found)
      ++refused;
    else
      EXPECT_TRUE((*found)->next_id == 1 || (*found)->next_id == 2) << i;
    ASSERT_EQ(pwrite(fd_.get(), &all[i], 1, static_cast<off_t>(i)), 1);
  }
  EXPECT_GT(refused, 50);
}

}  // namespace
}  // namespace xauto::emu
