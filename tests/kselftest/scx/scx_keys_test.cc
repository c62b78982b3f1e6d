// SPDX-License-Identifier: Apache-2.0
// The scheduler by itself, by keys that the jobs tell: order, ties, who takes a CPU, and keys that
// are none. KTAP, as scx_test.
#include <algorithm>
#include <array>
#include <random>

#include "tests.h"

namespace xauto::test {
namespace {

constexpr int kCpu = 1;

// The emulator is slow: nothing gets a turn by its age, though the floor can afford any number of turns.
const std::vector<std::string> kKeysAlone = {
    "--floor-permille", "0", "--floor-burst", "1s", "--age", "20s"};

// As order_of_eight, but each job tells its key, as far apart as keys may be, and many are equal.
// What is expected is put in order here, by hand.
void order_of_keys() {
  constexpr int kRounds = 200, kThreads = 8;
  constexpr std::int64_t kMost = XAUTO_BPF_KEY_LIMIT - 1;
  const std::int64_t keys[] = {-kMost, -1, 0, 1, 5'000'000'000'000, kMost};
  World& world = loaded_world(kKeysAlone);
  for (kernel::TableRow& row : world.rows) row.key = 0;
  world.rows[kThreads].key = -kMost;
  world.put_rows();
  // No memory is taken and nothing is half written: who waits for a page is overtaken.
  std::array<int, kThreads> order{};
  std::atomic<std::size_t> ended{0};
  std::atomic<bool> open{false}, holding{false};
  std::vector<std::unique_ptr<Waiter>> waiters;
  for (int i = 0; i < kThreads; ++i)
    waiters.push_back(std::make_unique<Waiter>(
        world, static_cast<std::uint32_t>(i),
        [&, i](const kernel::ThreadSlot&) { order[ended++ % kThreads] = i; }));
  Waiter gate(world, kThreads, [&](const kernel::ThreadSlot&) {
    holding = true;
    spin(open);
  });
  std::mt19937 random(5);
  int wrong = 0, stuck = 0, ties = 0;
  struct Due {
    std::int64_t key;
    std::uint64_t asked;
    std::uint32_t slot;
    int who;
    bool operator<(const Due& other) const {
      return key < other.key || (key == other.key && (asked < other.asked ||
                                                      (asked == other.asked && slot < other.slot)));
    }
  };
  for (std::uint64_t round = 1; round <= kRounds && stuck == 0; ++round) {
    ended = 0;
    open = false;
    holding = false;
    gate.submit(kThreads, round, {-kMost, 1});
    if (!wait_for([&] { return holding.load(); })) ++stuck;
    std::vector<Due> due;
    for (int i = 0; i < kThreads; ++i)
      due.push_back(
          {keys[random() % 6], 1 + random() % 3, waiters[static_cast<std::size_t>(i)]->index(), i});
    std::shuffle(due.begin(), due.end(), random);
    for (const Due& d : due) {
      Waiter& waiter = *waiters[static_cast<std::size_t>(d.who)];
      waiter.submit(static_cast<std::uint32_t>(d.who), round, {d.key, d.asked});
      if (!wait_for([&] { return queued(world, waiter.index()); })) ++stuck;
    }
    open = true;
    for (const auto& waiter : waiters)
      if (!wait_for([&] { return waiter->done() == round; })) ++stuck;
    std::sort(due.begin(), due.end());
    bool same = ended == due.size();
    for (std::size_t i = 0; i < due.size(); ++i) {
      same = same && order[i] == due[i].who;
      ties += i > 0 && due[i].key == due[i - 1].key ? 1 : 0;
    }
    if (same) continue;
    ++wrong;
    ksft_print_msg("round %llu:\n", static_cast<unsigned long long>(round));
    for (std::size_t i = 0; i < due.size(); ++i)
      ksft_print_msg("  key %lld, asked %llu, slot %u: thread %d; was %d\n",
                     static_cast<long long>(due[i].key),
                     static_cast<unsigned long long>(due[i].asked), due[i].slot, due[i].who,
                     order[i]);
  }
  open = true;
  ksft_test_result(
      wrong == 0 && stuck == 0 && ties > kRounds,
      "keys told by the jobs, up to 2^61 apart, run in exact order in each of %d rounds, "
      "%d ties by who asked first (%d wrong)\n",
      kRounds, ties, wrong);
}

void smaller_key_takes() {
  World& world = loaded_world(kKeysAlone);
  for (kernel::TableRow& row : world.rows) row.key = 0;
  world.put_rows();
  std::atomic<bool> stop{false}, told{false};
  {
    Waiter equal(world, 1, [](const kernel::ThreadSlot&) {});
    Waiter larger(world, 2, [](const kernel::ThreadSlot&) {});
    Waiter smaller(world, 3, [](const kernel::ThreadSlot&) {});
    XNodeThread running(world, 0, [&](const kernel::ThreadSlot& slot) {
      (void)slot.tell(0, 1, {1000, 1});
      told = true;
      spin(stop);
    });
    wait_for([&] { return told.load(); });
    sleep_ms(300);  // what the floor's first credit bought is over
    const std::uint64_t kicked = world.stat(XAUTO_BPF_STAT_KICKED);
    equal.submit(1, 1, {1000, 4});
    larger.submit(2, 1, {1001, 4});
    wait_for([&] { return queued(world, equal.index()) && queued(world, larger.index()); });
    sleep_ms(100);  // many slices
    const std::uint64_t kicks = world.stat(XAUTO_BPF_STAT_KICKED) - kicked;
    ksft_test_result(
        kicks == 0 && equal.done() + larger.done() == 0,
        "an equal key and a larger one take no CPU from what runs, and kick nobody: ran %u and "
        "%u times, %llu kicks\n",
        equal.done(), larger.done(), static_cast<unsigned long long>(kicks));
    smaller.submit(3, 1, {999, 9});
    const bool ran = wait_for([&] { return smaller.done() == 1; }, 5);
    ksft_test_result(ran && equal.done() == 0,
                     "... a smaller one does: ran %u times, the equal one %u\n", smaller.done(),
                     equal.done());
    stop = true;
    running.join();
    wait_for([&] { return equal.done() + larger.done() == 2; });
  }
}

void keys_out_of_range() {
  World& world = loaded_world();
  std::vector<std::uint64_t> bad;
  {
    Waiter waiter(world, 0, [](const kernel::ThreadSlot&) {});
    std::uint64_t n = 0;
    const std::int64_t keys[] = {INT64_MAX, INT64_MIN, 2 * XAUTO_BPF_KEY_LIMIT + 10};
    for (const std::int64_t key : keys) {
      const std::uint64_t before = world.stat(XAUTO_BPF_STAT_BAD_KEY);
      waiter.submit(0, ++n, {key, 0});
      wait_for([&] { return waiter.done() == n; });
      bad.push_back(world.stat(XAUTO_BPF_STAT_BAD_KEY) - before);
    }
    waiter.submit(0, ++n, {5, 0});
    wait_for([&] { return waiter.done() == n; });
  }
  ksft_test_result(
      bad == std::vector<std::uint64_t>({1, 1, 1}) && scx_state() == "enabled",
      "jobs whose key nobody could put in order run as ordinary threads, each is counted\n");
}

// Its place in the kernel's queues was a key, some hours of nanoseconds; the fair queue counts from
// the load of the scheduler on.
void out_of_the_slot() {
  World& world = loaded_world();
  std::atomic<bool> stop{false}, started{false};
  std::thread other([&] {
    pin(kCpu);
    started = true;
    spin(stop);
  });
  wait_for([&] { return started.load(); });
  double left_s = 0;
  {
    XNodeThread leaving(world, 0, [&](const kernel::ThreadSlot& slot) {
      (void)slot.tell(0, 1, {XAUTO_BPF_KEY_LIMIT / 2, 0});
      usleep(1000);  // woken by its key
      world.slots.leave(slot);
      pin(kCpu);
      const double before = cpu_seconds();
      spin(stop);
      left_s = cpu_seconds() - before;
    });
    sleep_ms(2000);
    stop = true;
  }
  other.join();
  ksft_test_result(left_s > 0.5,
                   "a thread that leaves its slot has its share as an ordinary one: %.2f s of 2\n",
                   left_s);
}

const Test kTests[] = {
    {"order_of_keys", 1, order_of_keys},
    {"smaller_key_takes", 2, smaller_key_takes},
    {"keys_out_of_range", 1, keys_out_of_range},
    {"out_of_the_slot", 1, out_of_the_slot},
};

}  // namespace
}  // namespace xauto::test

int main(int argc, char** argv) {
  xauto::test::run_tests(xauto::test::kTests, argc > 1 ? argv[1] : "");
}
