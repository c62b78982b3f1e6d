// SPDX-License-Identifier: Apache-2.0
// The state that an emulator finds, with other bytes in it than its predecessor's: it is refused,
// or it is that of a machine that keeps its rules.
//
// The first byte says what the rest is: even, the state itself; odd, changes to a valid one, three
// bytes each (place, low and high; value).
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <vector>

#include "emu/snapshot.h"

namespace {

using namespace xauto;

constexpr emu::Nanos kMs = 1'000'000, kNow = 10 * kMs;
constexpr emu::Nanos kLongest = 1'000'000 * kMs * 3600;  // 1000 hours

const Platform& platform() {
  static const Platform small = *Platform::builtin("small");
  return small;
}

/// Under way, with a stop to come.
const EmulationScript& script() {
  static const EmulationScript steps{{{1000, {{"gpu", 50}}, {{"cpu", 10}, {"gpu", 20}}},
                                      {12'000, {}, {}, {"gpu0"}},
                                      {20'000, {}, {}, {}, {"gpu0"}}}};
  return steps;
}

/// Two contexts that take turns, one that is suspended and one that is being so, an idle one.
std::vector<std::byte> valid() {
  emu::Machine m = *emu::Machine::create(platform(), script());
  std::vector<emu::ContextId> ids;
  for (const char* device : {"gpu0", "gpu0", "gpu0", "dla0", "cpu0", "cpu", "cpu"}) {
    ids.push_back(*m.open(device, 0));
    if (!m.submit(ids.back(), ids.size(), 20 * kMs, 0)) std::abort();
  }
  if (!m.open("dla0", 0) || !m.suspend(ids[2], 1, 0)) std::abort();
  std::vector<emu::Event> events;
  m.advance(kNow - kMs / 10, events);
  if (!m.suspend(ids[0], 2, kNow - kMs / 10) || !m.suspend(ids[3], 3, kNow - kMs / 10))
    std::abort();
  m.advance(kNow - kMs / 20, events);
  emu::Snapshot snapshot;
  m.save(snapshot);
  std::vector<std::byte> bytes(snapshot.bytes());
  snapshot.encode(bytes.data());
  return bytes;
}

void check(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  std::vector<std::byte> bytes;
  if (data[0] % 2 == 0) {
    const auto* rest = reinterpret_cast<const std::byte*>(data + 1);
    bytes.assign(rest, rest + size - 1);
  } else {
    static const std::vector<std::byte> good = valid();
    bytes = good;
    for (std::size_t i = 1; i + 2 < size; i += 3)
      bytes[(data[i] + 256u * data[i + 1]) % bytes.size()] = std::byte{data[i + 2]};
  }
  const auto snapshot = emu::Snapshot::decode(bytes);
  if (!snapshot) return 0;
  auto machine = emu::Machine::restore(platform(), *snapshot, kNow, script());
  if (!machine) return 0;

  // Everything comes to its end: nobody stays suspended, every job is done once.
  std::size_t busy = 0, done = 0;
  for (const emu::ContextRecord& c : snapshot->contexts) {
    busy += c.busy;
    check(machine->progress(c.id, c.tag) ==
          (c.busy != 0 ? emu::Progress::kUnderWay : emu::Progress::kDone));
  }
  check(machine->num_contexts() == snapshot->contexts.size());
  std::vector<emu::Event> events;
  const auto count = [&] {
    for (const emu::Event& e : events) done += e.kind == emu::Event::Kind::kDone;
    events.clear();
  };
  machine->advance(kNow, events);
  count();
  for (const emu::ContextRecord& c : snapshot->contexts) (void)machine->resume(c.id, 1, kNow);
  // Bytes may say that it takes for ever: a bounded number of steps, then it is saved as it is.
  emu::Nanos now = kNow;
  for (int step = 0; step < 300; ++step) {
    const emu::Nanos next = machine->next_event();
    if (next == std::numeric_limits<emu::Nanos>::max()) {
      check(done == busy);
      break;
    }
    check(next >= 0);
    if (next > kLongest) break;  // beyond what a state may say: none is saved then
    now = std::max(now, next);
    machine->advance(now, events);
    count();
  }
  emu::Snapshot again;
  machine->save(again);
  check(emu::Machine::restore(platform(), again, now, script()).has_value());
  return 0;
}
