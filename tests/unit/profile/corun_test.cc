// SPDX-License-Identifier: Apache-2.0
// Loads beside a profiled XNode: whoever takes steps takes them while they are wanted and not after.
#include "profile/corun.h"

#include <thread>

#include <gtest/gtest.h>

#include "base/futex.h"
#include "base/rt.h"

#include "../no_more_threads.h"

namespace xauto::runtime {
namespace {

void want(LoadWords& words, LoadWords::Wanted wanted) {
  words.wanted.store(wanted);
  futex_wake(words.wanted, 1);
}
void wait_until(const std::function<bool()>& holds) {
  while (!holds()) std::this_thread::yield();
}

TEST(Corun, StepsAreTakenWhileTheyAreWantedAndNotAfter) {
  LoadWords words{};
  std::atomic<bool> stop{false};
  std::atomic<std::uint32_t> steps{0};
  std::thread server([&] {
    EXPECT_TRUE(serve(
        words,
        [&]() -> Status {
          EXPECT_EQ(words.idle.load(), 0u);
          ++steps;
          return {};
        },
        stop));
  });
  for (int round = 0; round < 200; ++round) {
    wait_until([&] { return words.idle.load() == 1; });
    const std::uint32_t before = steps.load();
    EXPECT_EQ(words.steps.load(), before) << "each one that has ended counts";
    want(words, LoadWords::kOn);
    wait_until([&] { return words.steps.load() > before; });
    want(words, LoadWords::kOff);
  }
  wait_until([&] { return words.idle.load() == 1; });
  want(words, LoadWords::kEnd);
  server.join();
}

TEST(Corun, AStepThatFailsEndsItAndSoDoesAStop) {
  LoadWords words{};
  std::atomic<bool> stop{false};
  want(words, LoadWords::kOn);
  const Status failed = serve(
      words, []() -> Status { return fail(ErrorCode::kUnavailable, "no"); }, stop);
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().what, "no");
  EXPECT_EQ(words.steps.load(), 0u);
  stop.store(true);
  EXPECT_TRUE(serve(
      words, []() -> Status { return {}; }, stop));
  want(words, LoadWords::kOff);
  EXPECT_TRUE(serve(
      words, []() -> Status { return {}; }, stop));
}

TEST(Corun, ACoreIsLoadedAgainAndAgain) {
  const std::vector<int> cores = rt::allowed_cores();
  const auto made = load_of_core(cores.back(), cores.size());
  ASSERT_TRUE(made);
  Load* const load = made->get();
  for (int round = 0; round < 3; ++round) {
    ASSERT_TRUE(load->on(-1));
    load->off();
  }
  ASSERT_TRUE(load->on(-1)) << "and ends while it is on";
}

TEST(Corun, WhereThreadsEndALoadSaysSo) {
  const NoMoreThreads none;
  const auto load = load_of_core(rt::allowed_cores().back(), 1);
  ASSERT_FALSE(load);
  EXPECT_EQ(load.error().what.find("no more threads: "), 0u) << load.error().what;
}

TEST(Corun, WhoCannotBeginSaysWhy) {
  const auto load = load_of_core(100'000, 1);
  ASSERT_TRUE(load);
  const Status on = (*load)->on(-1);
  ASSERT_FALSE(on);
  EXPECT_NE(on.error().what.find("core"), std::string::npos);
  (*load)->off();
  // No emulator in this process.
  const auto emulated = load_of_emulated({"gpu0", XPU::GPU, 0}, rt::allowed_cores());
  ASSERT_TRUE(emulated);
  EXPECT_FALSE((*emulated)->on(-1));
}

TEST(Corun, AClassIsAllOfItsTypeButTheStagesOwn) {
  Session session;
  session.platform = Platform::builtin("small").value();
  session.presence.assign(session.platform.xpus.size(), Presence::kReal);
  const int gpu = session.platform.find("gpu0"), cpu = session.platform.find("cpu0");
  const std::vector<int> cores = rt::allowed_cores();
  Corun corun(session, {cores.front()});
  EXPECT_FALSE(corun.beside("gpu", {gpu, false, cores.front()}));
  EXPECT_EQ(corun.why_not("gpu"), "there is no second XPU of this type");
  EXPECT_FALSE(corun.beside("cpu", {cpu, false, cores.front()}));
  EXPECT_EQ(corun.why_not("cpu"), "this process may use one core only");
  EXPECT_FALSE(corun.beside("dla", {gpu, false, cores.front()}));
  EXPECT_EQ(corun.why_not("dla"), "the app computes nothing there that could load it");
  EXPECT_FALSE(corun.beside("dla", {gpu, true, cores.front()}));
  EXPECT_EQ(corun.why_not("dla"), "the time of a stand-in does not depend on a real XPU");
  // The stage's thread is elsewhere.
  EXPECT_TRUE(corun.beside("cpu", {gpu, false, -1}));
  EXPECT_EQ(corun.what("cpu"), "memory streams on the other cores");
  EXPECT_EQ(corun.what("gpu"), "");
}

}  // namespace
}  // namespace xauto::runtime
