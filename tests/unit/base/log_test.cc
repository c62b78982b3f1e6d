// SPDX-License-Identifier: Apache-2.0
// Nobody waits for who reads the log. Where one did, these tests would not end.
#include "base/log.h"

#include <algorithm>
#include <cstdlib>
#include <string>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include "base/memory_file.h"
#include "base/unique_fd.h"
#include "base/write_now.h"

namespace xauto {
namespace {

/// stderr is something else as long as this lives.
class StderrIs {
 public:
  explicit StderrIs(int fd) : before_(fcntl(2, F_DUPFD_CLOEXEC, 3)) { dup2(fd, 2); }
  ~StderrIs() { dup2(before_.get(), 2); }
  StderrIs(const StderrIs&) = delete;
  StderrIs& operator=(const StderrIs&) = delete;

 private:
  UniqueFd before_;
};

struct Ends {
  UniqueFd out, in;
};
Ends pipe_ends() {
  int ends[2];
  EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0);
  return {UniqueFd(ends[0]), UniqueFd(ends[1])};
}

std::string read_all(int fd) {
  const int flags = fcntl(fd, F_GETFL);
  fcntl(fd, F_SETFL, flags | O_NONBLOCK);
  std::string all;
  char bytes[4096];
  for (ssize_t got; (got = read(fd, bytes, sizeof bytes)) > 0;)
    all.append(bytes, static_cast<std::size_t>(got));
  return all;
}

constexpr int kMany = 3000;
/// More than anything here holds, then one when there is room again.
std::string flood(int reader) {
  for (int i = 0; i < kMany; ++i) log::error("line {} of many, {}", i, std::string(60, '.'));
  std::string heard = read_all(reader);
  log::error("the last one");
  return heard + read_all(reader);
}

/// Whole lines, and none is missed in silence.
void expect_counted(const std::string& heard) {
  const auto lines = std::count(heard.begin(), heard.end(), '\n');
  const std::size_t at = heard.find("xauto: warning: ");
  ASSERT_NE(at, std::string::npos)
      << heard.substr(heard.size() - std::min<std::size_t>(heard.size(), 400));
  const int dropped = std::atoi(heard.c_str() + at + 16);
  EXPECT_GT(dropped, 0);
  // Of the lines there are as many as were said, but for the warning, and what was torn counts as dropped.
  EXPECT_NEAR(static_cast<double>(lines - 1 + dropped), kMany + 1, 1);
  EXPECT_NE(heard.find("xauto: error: the last one\n", at), std::string::npos);
}

TEST(Log, APipeThatNobodyReadsKeepsNobodyWaiting) {
  const Ends pipe = pipe_ends();
  const StderrIs it(pipe.in.get());
  expect_counted(flood(pipe.out.get()));
  EXPECT_EQ(fcntl(2, F_GETFL) & O_NONBLOCK, 0) << "others have this open file, too";
}

TEST(Log, ASocketThatNobodyReadsKeepsNobodyWaiting) {
  for (const int type : {SOCK_STREAM, SOCK_SEQPACKET, SOCK_DGRAM}) {
    int ends[2];
    ASSERT_EQ(socketpair(AF_UNIX, type | SOCK_CLOEXEC, 0, ends), 0);
    const UniqueFd here(ends[0]), there(ends[1]);
    const StderrIs it(there.get());
    expect_counted(flood(here.get()));
  }
}

TEST(Log, ATerminalThatIsStoppedKeepsNobodyWaiting) {
  const UniqueFd outer(posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC));
  ASSERT_TRUE(outer && grantpt(outer.get()) == 0 && unlockpt(outer.get()) == 0);
  const UniqueFd inner(open(ptsname(outer.get()), O_RDWR | O_NOCTTY | O_CLOEXEC));
  ASSERT_TRUE(inner);
  termios raw{};
  tcgetattr(inner.get(), &raw);
  cfmakeraw(&raw);
  tcsetattr(inner.get(), TCSANOW, &raw);
  tcflow(inner.get(), TCOOFF);  // as Ctrl-S does
  const StderrIs it(inner.get());
  for (int i = 0; i < 100; ++i) log::error("nobody sees this");
  EXPECT_FALSE(log::show("nor a progress line"));
  tcflow(inner.get(), TCOON);
  log::error("the last one");
  const std::string heard = read_all(outer.get());
  EXPECT_NE(heard.find("100 lines were dropped here, since nobody read them"), std::string::npos)
      << heard;
  EXPECT_NE(heard.find("the last one"), std::string::npos);
}

TEST(Log, APipeOfAnotherUsersThatNobodyReadsKeepsNobodyWaiting) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root, to become somebody else";
  const Ends pipe = pipe_ends();
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    if (setresuid(65534, 65534, 65534) != 0) _exit(1);
    if (open(("/proc/self/fd/" + std::to_string(pipe.in.get())).c_str(), O_WRONLY) >= 0) _exit(2);
    const StderrIs it(pipe.in.get());
    const std::string heard = flood(pipe.out.get());
    expect_counted(heard);
    _exit(testing::Test::HasFailure() ? 3 : 0);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

TEST(Log, WhoHasHungUpEndsNobody) {
  Ends pipe = pipe_ends();
  pipe.out.reset();
  const StderrIs it(pipe.in.get());
  log::error("to nobody");
  EXPECT_EQ(write_now(2, "to nobody"), 0u);
  sigset_t pending;
  sigpending(&pending);
  EXPECT_EQ(sigismember(&pending, SIGPIPE), 0);
}

TEST(Log, AFileIsWrittenToWhereOthersAre) {
  const auto file = make_memory_file("log");
  ASSERT_TRUE(file);
  const StderrIs it(file->get());
  log::error("one");
  ASSERT_EQ(write(file->get(), "two\n", 4), 4);
  log::error("three");
  std::string text(200, '\0');
  text.resize(static_cast<std::size_t>(pread(file->get(), text.data(), text.size(), 0)));
  EXPECT_NE(text.find("xauto: error: one\ntwo\nxauto: error: three\n"), std::string::npos) << text;
}

TEST(Log, RefusalsAreToldOnceASecondAndAllAreCounted) {
  const Ends pipe = pipe_ends();
  const StderrIs it(pipe.in.get());
  constexpr std::int64_t kSecond = 1'000'000'000;
  {
    log::Refusals refusals("gpu0");
    for (int i = 0; i < 5000; ++i) refusals.tell("uid 1", 7 * kSecond + i);
    refusals.tell("uid 2", 8 * kSecond);
    refusals.tell("uid 3", 9 * kSecond - 1);
  }
  EXPECT_EQ(read_all(pipe.out.get()),
            "xauto: warning: gpu0: uid 1\n"
            "xauto: warning: gpu0: uid 2; 4999 more since the last line\n"
            "xauto: warning: gpu0: 1 more refused since the last line\n");
}

}  // namespace
}  // namespace xauto
