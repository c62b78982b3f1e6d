// SPDX-License-Identifier: Apache-2.0
#include "account/foreign_watch.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "base/socket.h"
#include "processes/marks.h"

namespace xauto::runtime {
namespace {

/// A /proc with threads of that name, state, last core and policy (proc(5), fields 2, 3, 39 to 41).
class Proc {
 public:
  Proc()
      : folder_(std::filesystem::path(::testing::TempDir()) /
                ("xauto_proc." + std::to_string(getpid()))) {}
  ~Proc() { std::filesystem::remove_all(folder_); }
  Proc(const Proc&) = delete;
  Proc& operator=(const Proc&) = delete;
  void add(int process, int thread, const std::string& name, char state, int core, int priority,
           int policy) {
    const auto task = folder_ / std::to_string(process) / "task" / std::to_string(thread);
    std::filesystem::create_directories(task);
    std::ofstream file(task / "stat");
    file << thread << " (" << name << ") " << state;
    for (int field = 4; field < 39; ++field) file << " 0";
    file << " " << core << " " << priority << " " << policy << " 0 0 0\n";
  }
  [[nodiscard]] std::string path() const { return folder_.string(); }

 private:
  std::filesystem::path folder_;
};

using Names = std::vector<std::string>;

TEST(ForeignWatch, NamesWhoCanRunOnTheCore) {
  Proc proc;
  proc.add(10, 10, "sleeper", 'S', 3, 0, 0);
  proc.add(11, 11, "elsewhere", 'R', 2, 0, 0);
  proc.add(12, 13, "a) R 3 (b", 'R', 3, 0, 0);  // a name may be anything
  proc.add(14, 14, "ours", 'R', 3, 50, 1);
  EXPECT_EQ(runners_on(3, {14}, proc.path()).names, (Names{"a) R 3 (b (pid 12, SCHED_OTHER)"}));
  EXPECT_FALSE(runners_on(3, {14}, proc.path()).realtime);
  proc.add(15, 15, "hog", 'R', 3, 99, 1);
  const Runners there = runners_on(3, {14}, proc.path());
  EXPECT_EQ(
      there.names,
      (Names{"hog (pid 15, SCHED_FIFO 99)"}));  // nobody else takes a core from real-time threads
  EXPECT_TRUE(there.realtime);
  EXPECT_TRUE(runners_on(7, {14}, proc.path()).names.empty());
  EXPECT_TRUE(runners_on(3, {14}, proc.path() + "/none").names.empty());
  EXPECT_EQ(runners_on(3, {14, 15}, proc.path()).names, (Names{"a) R 3 (b (pid 12, SCHED_OTHER)"}));
}

TEST(ForeignWatch, NamesAreShownSafely) {
  Proc proc;
  proc.add(1, 1, "\x1b[2J", 'R', 0, 0, 0);
  EXPECT_EQ(runners_on(0, {0}, proc.path()).names, (Names{"\\x1b[2J (pid 1, SCHED_OTHER)"}));
}

TEST(ForeignWatch, AnotherRunIsSeenByItsMark) {
  Session session;
  session.platform = Platform{"p", {{"cpu0", "cpu"}, {"gpu0", "gpu"}, {"dla0", "dla"}}};
  session.presence = {Presence::kReal, Presence::kReal, Presence::kEmulated};
  session.policy.placements = {{0}, {1}, {2}};
  session.own_sockets = "xauto/1-0/aa/";
  const auto board = Board::local({.modules = 1, .nodes = 1, .xpus = 3});
  const std::string core = real_xpus_of(session)[0].hardware;
  const std::string run = std::to_string(getpid()) + "-77";
  const auto hold = [](const std::string& name) {
    auto socket = hold_abstract(name);
    EXPECT_TRUE(socket) << socket.error().to_string();
    return std::move(*socket);
  };
  const UniqueFd own = hold("xauto/1-0/aa/real:gpu0"),
                 emulated = hold("xauto/" + run + "/bb/real:dla0"),
                 theirs = hold("xauto/" + run + "/bb/real:" + core);
  ForeignWatch watch(session, *board, true);
  watch.look(2'000'000'000);
  EXPECT_NE(board->xpu(0).words_of_sharing().find("run " + run + " of uid "), std::string::npos);
  EXPECT_EQ(board->xpu(1).words_of_sharing(), "");  // it is ours
  EXPECT_EQ(board->xpu(2).words_of_sharing(), "");  // ours is emulated
}

/// Who shares an XPU under the machine's coordinator was admitted; to a run with a coordinator of its own he is a stranger.
TEST(ForeignWatch, WhoIsAdmittedIsNoStranger) {
  Session session;
  session.platform = Platform{"p", {{"gpu0", "gpu"}, {"gpu1", "gpu"}}};
  session.policy.placements = {{0}, {1}};
  session.own_sockets = "xauto/1-0/aa/";
  session.coordinators = {{"gpu0", "/run/xauto/coordinator.sock?1?2?0?2?gpu0"},
                          {"gpu1", "xauto/1-0/aa/gpu1"}};
  EXPECT_EQ(marks_of(session), (Names{"real:gpu0+", "real:gpu1"}));
  const auto board = Board::local({.modules = 1, .nodes = 1, .xpus = 2});
  const std::string run = "xauto/" + std::to_string(getpid()) + "-78/cc/";
  const auto admitted = hold_abstract(run + "real:gpu0+"),
             stranger = hold_abstract(run + "real:gpu1+");
  ASSERT_TRUE(admitted && stranger);
  ForeignWatch watch(session, *board, true);
  watch.look(2'000'000'000);
  EXPECT_EQ(board->xpu(0).words_of_sharing(), "");
  EXPECT_NE(board->xpu(1).words_of_sharing(), "");
}

Session joined(const char* xpu, const char* type) {
  Session session;
  session.platform = Platform{"p", {{xpu, type}}};
  session.policy.placements = {{0}};
  session.own_sockets = "xauto/1-0/aa/";
  session.coordinators = {{xpu, std::string("/run/xauto/coordinator.sock?1?2?0?2?") + xpu}};
  return session;
}

/// What the service could not keep off a GPU since this run began breaks what is claimed there.
TEST(ForeignWatch, WorkThatWasNotKeptOffIsTold) {
  const Session session = joined("gpu0", "gpu");
  const auto board = Board::local({.modules = 1, .nodes = 1, .xpus = 1});
  ForeignWatch::Neighbours says{{getpid()}, {{"gpu0", 7}, {"gpu1", 0}}};
  int asked = 0;
  ForeignWatch watch(session, *board, true, [&] {
    ++asked;
    return says;
  });
  auto look = [&, at = std::int64_t{0}]() mutable { watch.look(at += 2'000'000'000); };
  look();
  says.not_kept_off["gpu1"] = 3;
  look();
  EXPECT_EQ(board->xpu(0).words_of_sharing(), "");
  says.not_kept_off["gpu0"] = 8;
  look();
  EXPECT_NE(board->xpu(0).words_of_sharing().find("work of others"), std::string::npos);
  EXPECT_FALSE(watch.is_blind());
  // A service that suspends nothing, or does not answer, is left alone.
  says.not_kept_off.clear();
  look();
  const int until_now = asked;
  look();
  EXPECT_EQ(asked, until_now);
}

TEST(ForeignWatch, WhoIsNotToldWhoHasJoinedIsBlind) {
  for (const bool knows : {true, false}) {
    const Session session = joined("cpu0", "cpu");
    const auto board = Board::local({.modules = 1, .nodes = 1, .xpus = 1});
    int asked = 0;
    ForeignWatch watch(session, *board, true, [&] {
      ++asked;
      return ForeignWatch::Neighbours{{1, knows ? getpid() : 2}, {}};
    });
    watch.look(2'000'000'000);
    EXPECT_EQ(watch.is_blind(), !knows);
    watch.look(4'000'000'000);
    EXPECT_EQ(asked, 1) << "nothing is suspected";
    board->xpu(0).crowd(5, true);
    EXPECT_EQ(board->xpu(0).words_of_crowd(), "") << "nobody was seen";
  }
}

/// Two apps on one machine share nothing where their policies place nothing on the same core.
TEST(ForeignWatch, AnXpuThatThePolicyDoesNotUseIsNotTaken) {
  Session session;
  session.platform = Platform{"p", {{"gpu0", "gpu"}, {"gpu1", "gpu"}, {"npu0", "npu"}}};
  session.presence = {Presence::kReal, Presence::kReal, Presence::kReal};
  session.policy.placements = {{1}};
  EXPECT_EQ(marks_of(session), (Names{"real:gpu1"}));
  session.by_table.resize(2);
  session.by_table[0].placements = {{1}};
  session.by_table[1].placements = {{2}};
  EXPECT_EQ(marks_of(session), (Names{"real:gpu1", "real:npu0"}));
  session.scheduling = Scheduling::kRos2;  // nobody says where its stages are
  EXPECT_EQ(marks_of(session), (Names{"real:gpu0", "real:gpu1", "real:npu0"}));
}

}  // namespace
}  // namespace xauto::runtime
