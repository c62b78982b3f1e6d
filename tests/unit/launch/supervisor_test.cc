// SPDX-License-Identifier: Apache-2.0
// The parent of a run, with programs that are no apps: whatever they do it ends, tells, and leaves
// nothing behind.
#include "launch/supervisor.h"

#include <atomic>
#include <csignal>

#include <gtest/gtest.h>

#include "base/socket.h"
#include "model/periodic.h"

namespace xauto::launch {
namespace {

/// Reads its session and answers, as an app would.
constexpr const char* kAnswers = R"py(
import json, os
session = json.load(os.fdopen(int(os.environ["XAUTO_SESSION"])))
os.write(session["answer_fd"], b"an answer")
)py";

Supervision shell(const std::string& command) {
  Supervision request;
  request.session.mode = runtime::Mode::kDescribe;
  request.command = {"/bin/sh", "-c", command};
  request.bin = XAUTO_BINARY_DIR "/bin";
  return request;
}

/// A run of one XNode on two emulated XPUs: with an emulator and two coordinators.
Supervision run_of(std::vector<std::string> command) {
  Supervision request = shell("");
  request.command = std::move(command);
  runtime::Session& session = request.session;
  session.mode = runtime::Mode::kRun;
  session.app.name = "app";
  session.app.xnodes = {{"n", "m", {{"gpu", 1000}}, {0}}};
  session.app.one_at_a_time = true;
  session.app.sources = {{"s", kNoRate}};
  complete_modules(session.app);
  complete_chains(session.app);
  session.platform = {"two", {{"gpu0", "gpu"}, {"gpu1", "gpu"}}};
  session.presence = {Presence::kEmulated, Presence::kEmulated};
  session.policy.app = "app";
  session.policy.app_hash = session.app.hash();
  session.policy.method = "local";
  session.policy.placements = {{0, 1, 0, 1000}};
  return request;
}

/// Sockets of our own runs that still listen.
std::vector<std::string> left() {
  return abstract_sockets(kSocketPrefix + std::to_string(getpid()));
}

TEST(Supervisor, PassesOnWhatTheAppAnswered) {
  auto request = shell("");
  request.command = {"python3", "-c", kAnswers};
  const auto outcome = supervise(request);
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  EXPECT_EQ(outcome->answer, "an answer");
  EXPECT_EQ(outcome->app.to_string(), "exit status 0");
  EXPECT_TRUE(outcome->notes.empty());
}

TEST(Supervisor, TellsHowAnAppEndedThatGaveNoAnswer) {
  const auto exited = supervise(shell("exit 3"));
  ASSERT_FALSE(exited);
  EXPECT_EQ(exited.error().code, ErrorCode::kUnavailable);
  EXPECT_NE(exited.error().what.find("exit status 3"), std::string::npos) << exited.error().what;
  const auto killed = supervise(shell("kill -SEGV $$"));
  ASSERT_FALSE(killed);
  EXPECT_NE(killed.error().what.find("signal"), std::string::npos) << killed.error().what;
}

TEST(Supervisor, SaysThatThereIsNoSuchProgram) {
  auto request = shell("");
  request.command = {"/no/such/program"};
  const auto outcome = supervise(request);
  ASSERT_FALSE(outcome);
  EXPECT_NE(outcome.error().to_string().find("/no/such/program"), std::string::npos)
      << outcome.error().to_string();
}

TEST(Supervisor, StopsAnAppThatTheUserStops) {
  const std::atomic<bool> stop{true};
  auto request = shell("exec sleep 60");
  request.stop = &stop;
  const auto outcome = supervise(request);
  ASSERT_FALSE(outcome);
  EXPECT_NE(outcome.error().what.find("stopped by the user"), std::string::npos)
      << outcome.error().what;
}

TEST(Supervisor, TellsAnAppWhichXpusTheEmulatorModulesHave) {
  Supervision request = shell("");
  request.command = {"python3", "-c", std::string(kAnswers) + R"py(
os.write(session["answer_fd"], (":" + os.environ["XAUTO_EMU_DRIVERS"]).encode())
)py"};
  runtime::Session& session = request.session;
  // An XPU of the app's own has no driver, and one that is not preemptive is never suspended.
  session.platform = {"all",
                      {{"cpu0", "cpu"}, {"gpu0", "gpu"}, {"dla0", "dla", false}, {"npu0", "npu"}}};
  session.presence = std::vector<Presence>(4, Presence::kEmulated);
  session.emulator_modules = true;
  auto outcome = supervise(request);
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  EXPECT_EQ(outcome->answer, "an answer:gpu0\n");
  session.emulator_modules = false;
  outcome = supervise(request);
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  EXPECT_EQ(outcome->answer, "an answer:");
}

TEST(Supervisor, StopsAnAppAtItsTimeLimit) {
  auto request = shell("exec sleep 60");
  request.time_limit_s = 1;
  const auto outcome = supervise(request);
  ASSERT_FALSE(outcome);
  EXPECT_NE(outcome.error().what.find("time limit"), std::string::npos) << outcome.error().what;
}

TEST(Supervisor, StartsTheDaemonsOfARunAndLeavesNoneBehind) {
  std::size_t most = 0;
  auto request = run_of({"python3", "-c", std::string(kAnswers) + "import time; time.sleep(1)\n"});
  request.on_tick = [&](double, const runtime::Board*) { most = std::max(most, left().size()); };
  const auto outcome = supervise(request);
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  // Emulator, two coordinators, and us: for those who look, and for `xauto param`.
  EXPECT_EQ(most, 5u);
  EXPECT_EQ(outcome->deaths, 0u);
  EXPECT_EQ(left(), std::vector<std::string>());
}

TEST(Supervisor, StartsACoordinatorAgainAndTells) {
  // The app kills the coordinator of gpu0, whose arguments name it, and looks for the next one.
  const std::string kills = std::string(kAnswers) + R"py(
import glob, signal, time
def coordinators():
  found = set()
  for path in glob.glob("/proc/[0-9]*/cmdline"):
    try:
      words = open(path).read()
      parent = open(os.path.dirname(path) + "/stat").read().rsplit(")", 1)[1].split()[1]
    except OSError:
      continue
    program, *rest = words.split("\0")
    if program.endswith("/xauto-coordinator") and "gpu0" in rest and int(parent) == os.getppid():
      found.add(int(path.split("/")[2]))
  return found
def wait(good):
  for _ in range(600):
    found = coordinators()
    if good(found): return found
    time.sleep(0.05)
  raise SystemExit(7)
first = wait(lambda found: len(found) == 1)
os.kill(min(first), signal.SIGKILL)
wait(lambda found: len(found) == 1 and found != first)
)py";
  const auto outcome = supervise(run_of({"python3", "-c", kills}));
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  EXPECT_EQ(outcome->app.to_string(), "exit status 0");
  EXPECT_EQ(outcome->deaths, 1u);
  ASSERT_EQ(outcome->notes.size(), 1u);
  EXPECT_NE(outcome->notes[0].find("gpu0"), std::string::npos) << outcome->notes[0];
  EXPECT_EQ(left(), std::vector<std::string>());
}

}  // namespace
}  // namespace xauto::launch
