// SPDX-License-Identifier: Apache-2.0
#include "account/foreign_watch.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include "base/socket.h"
#include "processes/marks.h"

namespace xauto::runtime {
namespace {

/// A /proc with threads of that name, last core, policy (proc(5), fields 2, 39 to 41) and time on a core.
class Proc {
 public:
  Proc()
      : folder_(std::filesystem::path(::testing::TempDir()) /
                ("xauto_proc." + std::to_string(getpid()))) {}
  ~Proc() { std::filesystem::remove_all(folder_); }
  Proc(const Proc&) = delete;
  Proc& operator=(const Proc&) = delete;
  /// Once more: it has run on.
  void add(int process, int thread, const std::string& name, int core, int priority, int policy,
           double ran_ms) {
    const auto task = folder_ / std::to_string(process) / "task" / std::to_string(thread);
    std::filesystem::create_directories(task);
    std::ofstream file(task / "stat");
    file << thread << " (" << name << ") S";
    for (int field = 4; field < 39; ++field) file << " 0";
    file << " " << core << " " << priority << " " << policy << " 0 0 0\n";
    std::ofstream(task / "schedstat") << static_cast<std::int64_t>(ran_ms * 1e6) << " 0 7\n";
  }
  [[nodiscard]] std::string path() const { return folder_.string(); }

 private:
  std::filesystem::path folder_;
};

using Names = std::vector<std::string>;

/// None of them is ready when somebody looks: what counts is who has run in between.
TEST(CoreWatch, NamesWhoRanOnTheCoreSinceTheLastLook) {
  Proc proc;
  CoreWatch watch(3, proc.path());
  proc.add(10, 10, "sleeper", 3, 0, 0, 500);
  proc.add(11, 11, "elsewhere", 2, 0, 0, 500);
  proc.add(12, 13, "a) R 3 (b", 3, 0, 0, 500);  // a name may be anything
  proc.add(14, 14, "ours", 3, 50, SCHED_FIFO, 500);
  EXPECT_TRUE(watch.look(1'000'000'000, {14}).names.empty()) << "nobody knows since when";
  proc.add(11, 11, "elsewhere", 2, 0, 0, 600);
  proc.add(12, 13, "a) R 3 (b", 3, 0, 0, 540);
  proc.add(14, 14, "ours", 3, 50, SCHED_FIFO, 550);
  proc.add(16, 16, "new", 3, 0, 0, 60);
  const CoreWatch::Seen there = watch.look(1'100'000'000, {14});
  EXPECT_EQ(there.names, (Names{"a) R 3 (b (pid 12, SCHED_OTHER)"}));
  EXPECT_FALSE(there.realtime);
  proc.add(16, 16, "new", 3, 0, 0, 90);
  proc.add(12, 13, "a) R 3 (b", 3, 0, 0, 550);
  EXPECT_EQ(watch.look(1'200'000'000, {14}).names,
            (Names{"new (pid 16, SCHED_OTHER)", "a) R 3 (b (pid 12, SCHED_OTHER)"}));
  EXPECT_TRUE(watch.look(1'300'000'000, {14}).names.empty()) << "nobody has run since";
  watch.forget();
  EXPECT_TRUE(watch.look(1'400'000'000, {14}).names.empty());
}

/// A thread that is pinned nowhere may have run for hours, and only its last microseconds here.
TEST(CoreWatch, WhoHasRunElsewhereIsNotNamed) {
  Proc proc;
  CoreWatch watch(3, proc.path());
  proc.add(10, 10, "visitor", 2, 80, SCHED_FIFO, 3'600'000);
  proc.add(11, 11, "hog", 3, 98, SCHED_FIFO, 10);
  (void)watch.look(1'000'000'000, {});
  proc.add(10, 10, "visitor", 3, 80, SCHED_FIFO, 3'600'050);
  proc.add(11, 11, "hog", 3, 98, SCHED_FIFO, 60);
  EXPECT_EQ(watch.look(1'100'000'000, {}).names, (Names{"hog (pid 11, SCHED_FIFO 98)"}));
}

/// Nobody else takes a core from real-time threads; the kernel's own (migration/0) run for microseconds.
TEST(CoreWatch, NamesRealtimeThreadsAlone) {
  Proc proc;
  CoreWatch watch(3, proc.path());
  const auto run = [&](double hog_ms) {
    proc.add(12, 12, "ordinary", 3, 0, 0, 10 * hog_ms);
    proc.add(15, 15, "hog", 3, 98, SCHED_FIFO, hog_ms);
    proc.add(20, 20, "migration/3", 3, 99, SCHED_FIFO, hog_ms / 1000);
  };
  run(10);
  (void)watch.look(1'000'000'000, {});
  run(15);
  const CoreWatch::Seen there = watch.look(1'100'000'000, {});
  EXPECT_EQ(there.names, (Names{"hog (pid 15, SCHED_FIFO 98)"}));
  EXPECT_TRUE(there.realtime);
  run(20);
  EXPECT_EQ(watch.look(1'200'000'000, {15}).names, (Names{"ordinary (pid 12, SCHED_OTHER)"}));
}

TEST(CoreWatch, NamesAreShownSafelyAndAreFew) {
  Proc proc;
  CoreWatch watch(0, proc.path()), none(0, proc.path() + "/none");
  const auto run = [&](double ms) {
    proc.add(1, 1, "\x1b[2J", 0, 0, 0, 9 * ms);
    for (int other = 2; other < 6; ++other) proc.add(other, other, "x", 0, 0, 0, other * ms);
  };
  run(1);
  (void)watch.look(1, {});
  (void)none.look(1, {});
  run(2);
  EXPECT_TRUE(none.look(2, {}).names.empty());
  const Names names = watch.look(1'000'000'000, {}).names;
  ASSERT_EQ(names.size(), 3u);
  EXPECT_EQ(names[0], "\\x1b[2J (pid 1, SCHED_OTHER)");
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
