// SPDX-License-Identifier: Apache-2.0
#include "launch/pulse.h"

#include <cstring>
#include <new>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/socket.h"
#include "base/unique_fd.h"
#include "emu/protocol.h"

namespace xauto::launch {
namespace {

constexpr std::int64_t kMs = 1'000'000;

TEST(Stall, IsSomethingToDoAndNoProgressForTwoSeconds) {
  Stall stall;
  for (int ms = 0; ms < 2000; ms += 200) EXPECT_FALSE(stall.look(true, 7, ms * kMs)) << ms;
  EXPECT_TRUE(stall.look(true, 7, 2000 * kMs));
}

TEST(Stall, WhoSleepsInBetweenIsBusyAndWell) {
  Stall stall;
  for (std::uint64_t sleeps = 0; sleeps < 50; ++sleeps)
    EXPECT_FALSE(stall.look(true, sleeps, static_cast<std::int64_t>(sleeps) * 1900 * kMs));
}

TEST(Stall, WhoHasNothingToDoMayStayAsItIs) {
  Stall stall;
  EXPECT_FALSE(stall.look(true, 7, 0));
  EXPECT_FALSE(stall.look(false, 7, 1900 * kMs));
  EXPECT_FALSE(stall.look(true, 7, 60'000 * kMs));
  EXPECT_FALSE(stall.look(true, 7, 61'900 * kMs));
  EXPECT_TRUE(stall.look(true, 7, 62'000 * kMs));
}

/// A coordinator's header and socket; the process is this one, asleep as often as it likes.
TEST(Pulse, SeesARingThatNobodyAnswersAndAConnectionThatNobodyAccepts) {
  const UniqueFd memory(memfd_create("test", MFD_CLOEXEC));
  ASSERT_EQ(ftruncate(memory.get(), 4096), 0);
  void* mapped = mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, memory.get(), 0);
  ASSERT_NE(mapped, MAP_FAILED);
  auto* header = new (mapped) coord::Header;
  const std::string address = "xauto-test/pulse-" + std::to_string(getpid());
  const auto listener = listen_abstract(address);
  ASSERT_TRUE(listener);
  auto pulse = Pulse::of(memory.get(), listener->get());
  ASSERT_TRUE(pulse) << pulse.error().to_string();
  // A process whose sleeps do not count up: it has ended.
  const pid_t nobody = 0;

  header->waiting.store(1);
  EXPECT_FALSE(pulse->hangs(nobody, 0));
  EXPECT_FALSE(pulse->hangs(nobody, 9000 * kMs));
  header->waiting.store(0);
  EXPECT_FALSE(pulse->hangs(nobody, 10'000 * kMs));
  EXPECT_TRUE(pulse->hangs(nobody, 12'000 * kMs));
  EXPECT_FALSE(pulse->hangs(nobody, 12'200 * kMs));  // of the next one nothing is known yet
  header->waiting.store(1);
  EXPECT_FALSE(pulse->hangs(nobody, 20'000 * kMs));
  const auto client = connect_abstract(address);
  ASSERT_TRUE(client);
  EXPECT_FALSE(pulse->hangs(nobody, 20'200 * kMs));
  EXPECT_TRUE(pulse->hangs(nobody, 22'200 * kMs));
  munmap(mapped, 4096);
}

TEST(Ping, SeesAnEmulatorThatDoesNotAnswer) {
  const std::string address = "xauto-test/ping-" + std::to_string(getpid());
  auto listener = listen_abstract(address);
  ASSERT_TRUE(listener);
  Ping ping(address);
  EXPECT_FALSE(ping.hangs(0));
  UniqueFd emulator(accept4(listener->get(), nullptr, nullptr, SOCK_CLOEXEC));
  ASSERT_TRUE(emulator);
  const auto answer = [&] {
    emu::Packet packet;
    if (!receive_packet(emulator.get(), &packet, sizeof packet)) return false;
    EXPECT_EQ(packet.op, static_cast<std::uint32_t>(emu::Op::kPing));
    packet.op = static_cast<std::uint32_t>(emu::Op::kPong);
    return send_packet(emulator.get(), &packet, sizeof packet).has_value();
  };
  for (std::int64_t s = 2; s < 12; s += 2) {  // asked every two seconds, answered in time
    ASSERT_TRUE(answer());
    EXPECT_FALSE(ping.hangs(s * 1000 * kMs));
  }
  EXPECT_FALSE(ping.hangs(11'900 * kMs));
  EXPECT_TRUE(ping.hangs(12'000 * kMs));  // the question of second 10
  emulator.reset();

  // The next one is another connection; one that dies is none that hangs.
  EXPECT_FALSE(ping.hangs(12'000 * kMs));
  emulator = UniqueFd(accept4(listener->get(), nullptr, nullptr, SOCK_CLOEXEC));
  ASSERT_TRUE(answer());
  EXPECT_FALSE(ping.hangs(14'000 * kMs));
  emulator.reset();
  EXPECT_FALSE(ping.hangs(20'000 * kMs));
  // Nobody listens: there is nobody to hang.
  listener->reset();
  for (std::int64_t s = 21; s < 30; ++s) EXPECT_FALSE(ping.hangs(s * 1000 * kMs));
}

TEST(Pulse, OfNothingNeverHangs) {
  Pulse pulse;
  EXPECT_FALSE(pulse.hangs(getpid(), 0));
  EXPECT_FALSE(pulse.hangs(getpid(), 9000 * kMs));
}

}  // namespace
}  // namespace xauto::launch
