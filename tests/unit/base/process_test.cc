// SPDX-License-Identifier: Apache-2.0
#include "base/process.h"

#include <cstddef>
#include <tuple>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/memory_file.h"
#include "base/socket.h"
#include "base/syscalls.h"

namespace xauto {
namespace {

TEST(Process, TellsHowTheChildEnded) {
  auto child = Child::spawn({.argv = {"sh", "-c", "exit 7"}});
  ASSERT_TRUE(child);
  const auto exit = child->wait(10'000);
  ASSERT_TRUE(exit);
  EXPECT_EQ(exit->to_string(), "exit status 7");
  auto killed = Child::spawn({.argv = {"sleep", "100"}});
  ASSERT_TRUE(killed);
  EXPECT_EQ(killed->stop(0).to_string(), "signal SIGKILL");
}

TEST(Process, MissingProgramIsNamed) {
  const auto child = Child::spawn({.argv = {"/nowhere/xauto-emud"}});
  ASSERT_FALSE(child);
  EXPECT_EQ(child.error().to_string(),
            "/nowhere/xauto-emud: cannot start: No such file or directory");
}

TEST(Process, StopAsksFirst) {
  auto child = Child::spawn(
      {.argv = {"sh", "-c", "trap 'exit 3' TERM; echo ready >&2; while :; do sleep 0.01; done"}});
  ASSERT_TRUE(child);
  usleep(
      100'000);  // until the trap is set; otherwise the signal ends it and the check below says so
  const Exit exit = child->stop(10'000);
  EXPECT_TRUE(exit.to_string() == "exit status 3" || exit.to_string() == "signal SIGTERM")
      << exit.to_string();
}

TEST(Process, OnlyWhatIsNamedIsInherited) {
  auto kept = make_memory_file("kept");
  auto closed = make_memory_file("closed");
  ASSERT_TRUE(kept && closed);
  const auto there = [](int fd) { return "[ -e /proc/self/fd/" + std::to_string(fd) + " ]"; };
  auto child =
      Child::spawn({.argv = {"sh", "-c", there(kept->get()) + " && ! " + there(closed->get())},
                    .inherit = {kept->get()}});
  ASSERT_TRUE(child);
  EXPECT_EQ(child->wait(10'000)->to_string(), "exit status 0");
}

/// close_range, in this process and its children, as kernels before 5.11 (`flags`: those with a flag
/// only) or before 5.9 have it.
bool refuse_close_range(bool flags, int error) {
  const auto nr = static_cast<std::uint32_t>(offsetof(seccomp_data, nr));
  const auto flag = static_cast<std::uint32_t>(offsetof(seccomp_data, args[2]));
  sock_filter code[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, nr),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_close_range, 0, 3),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, flag),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, flags ? 0 : ~0u, 1, 0),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | static_cast<std::uint32_t>(error)),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog program{sizeof code / sizeof code[0], code};
  return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
         prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}

TEST(Process, SoItIsOnOldKernels) {
  for (const auto& [flags, error] : {std::tuple(true, EINVAL), std::tuple(false, ENOSYS)}) {
    const pid_t pid = fork();  // the filter stays for good
    if (pid == 0) {
      int ends[2];
      if (!refuse_close_range(flags, error) || pipe(ends) != 0) _exit(2);
      // One that is kept, and gaps on both sides.
      const int kept = fcntl(ends[0], F_DUPFD, 500), closed = fcntl(ends[0], F_DUPFD, 700);
      const auto there = [](int fd) { return "[ -e /proc/self/fd/" + std::to_string(fd) + " ]"; };
      auto child = Child::spawn({.argv = {"sh", "-c",
                                          there(kept) + " && ! " + there(closed) + " && ! " +
                                              there(ends[0]) + " && ! " + there(ends[1])},
                                 .inherit = {kept}});
      if (!child || child->wait(10'000)->to_string() != "exit status 0") _exit(1);
      const auto missing = Child::spawn({.argv = {"/nowhere/xauto-emud"}});
      _exit(!missing && missing.error().code == ErrorCode::kNotFound ? 0 : 3);
    }
    int status = 0;
    ASSERT_EQ(waitpid(pid, &status, 0), pid);
    EXPECT_EQ(status, 0) << "error " << error;
  }
}

TEST(Process, EnvironmentIsAddedToOurs) {
  auto child = Child::spawn({.argv = {"sh", "-c", "[ \"$XAUTO_TEST\" = yes ] && [ -n \"$PATH\" ]"},
                             .environment = {{"XAUTO_TEST", "yes"}}});
  ASSERT_TRUE(child);
  EXPECT_EQ(child->wait(10'000)->to_string(), "exit status 0");
}

TEST(MemoryFile, KeepsWhatWasWrittenLast) {
  auto file = make_memory_file("test");
  ASSERT_TRUE(file);
  ASSERT_TRUE(write_memory_file(file->get(), "a longer text"));
  ASSERT_TRUE(write_memory_file(file->get(), "short"));
  EXPECT_EQ(*read_memory_file(file->get()), "short");
}

TEST(Socket, PacketsAndDescriptorsArrive) {
  const std::string address = "xauto-test/socket-" + std::to_string(getpid());
  auto listener = listen_abstract(address);
  ASSERT_TRUE(listener);
  EXPECT_EQ(abstract_sockets("xauto-test/socket-"), std::vector<std::string>{address});
  auto client = connect_abstract(address);
  auto server = accept_own(listener->get());
  ASSERT_TRUE(client && server);
  auto file = make_memory_file("passed");
  ASSERT_TRUE(write_memory_file(file->get(), "hello"));
  ASSERT_TRUE(send_packet(client->get(), "packet", 6, {file->get()}));
  char text[16];
  std::vector<UniqueFd> fds;
  EXPECT_EQ(*receive_packet(server->get(), text, sizeof text, &fds), 6u);
  ASSERT_EQ(fds.size(), 1u);
  EXPECT_EQ(*read_memory_file(fds[0].get()), "hello");
  // Too long for the buffer: refused, not cut.
  ASSERT_TRUE(send_packet(client->get(), "a longer packet!!", 17));
  EXPECT_EQ(receive_packet(server->get(), text, sizeof text).error().code, ErrorCode::kInvalid);
  client->reset();
  EXPECT_EQ(receive_packet(server->get(), text, sizeof text).error().code, ErrorCode::kUnavailable);
  EXPECT_FALSE(connect_abstract("xauto-test/nobody"));
}

/// It hears why, though the kernel first says ECONNRESET: the other end has closed with something unread.
TEST(Socket, WhoIsSentAwayBeforeHeHasSaidAllHearsWhy) {
  int ends[2];
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends), 0);
  const UniqueFd ours(ends[0]);
  {
    const UniqueFd theirs(ends[1]);
    ASSERT_TRUE(send_packet(ours.get(), "please", 6));
    ASSERT_TRUE(send_packet(theirs.get(), "no", 2));
  }
  char text[8] = {};
  const auto size = receive_packet(ours.get(), text, sizeof text);
  ASSERT_TRUE(size) << size.error().to_string();
  EXPECT_EQ(std::string(text), "no");
  EXPECT_EQ(receive_packet(ours.get(), text, sizeof text).error().code, ErrorCode::kUnavailable);
}

TEST(Socket, WhoDoesNotReadOrAcceptKeepsNobodyWaiting) {
  const std::string address = "xauto-test/idle-" + std::to_string(getpid());
  const auto listener = listen_abstract(address);
  ASSERT_TRUE(listener);
  const auto client = connect_abstract(address);
  ASSERT_TRUE(client);
  const std::string packet(4096, 'x');
  Status sent;
  while (sent) sent = send_packet(client->get(), packet.data(), packet.size());
  EXPECT_EQ(sent.error().code, ErrorCode::kTimeout);
  std::vector<UniqueFd> queue;  // until it is full
  auto next = connect_to_anybody(address);
  for (; next; next = connect_to_anybody(address)) queue.push_back(std::move(*next));
  EXPECT_EQ(next.error().code, ErrorCode::kTimeout);
  EXPECT_EQ(connect_abstract(address, 20).error().code, ErrorCode::kTimeout);
  // What was taken blocks as usual: the limit was connect()'s alone.
  EXPECT_EQ(fcntl(client->get(), F_GETFL) & O_NONBLOCK, 0);
  timeval limit{};
  socklen_t size = sizeof limit;
  ASSERT_EQ(getsockopt(client->get(), SOL_SOCKET, SO_SNDTIMEO, &limit, &size), 0);
  EXPECT_EQ(limit.tv_sec + limit.tv_usec, 0);
}

TEST(Socket, DescriptorsThatNobodyAskedForNeverBecomeOurs) {
  int ends[2];
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends), 0);
  const UniqueFd here(ends[0]), there(ends[1]);
  ASSERT_TRUE(send_packet(here.get(), "packet", 6, {here.get()}));
  char text[16];
  const int next = dup(0);  // the number that it would have
  close(next);
  EXPECT_EQ(receive_packet(there.get(), text, sizeof text).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(fcntl(next, F_GETFD), -1);
}

TEST(Socket, WhatIsServedBySomebodyElseIsNotOurs) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root, to become somebody else";
  const std::string address = "xauto-test/theirs-" + std::to_string(getpid());
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd ready(ends[0]);
  UniqueFd told(ends[1]);
  const pid_t stranger = fork();
  ASSERT_GE(stranger, 0);
  if (stranger == 0) {
    if (setresuid(65534, 65534, 65534) != 0) _exit(1);
    const auto listener = listen_abstract(address);
    told.reset();
    while (listener) pause();
    _exit(1);
  }
  told.reset();
  char byte;
  EXPECT_EQ(read(ready.get(), &byte, 1), 0);
  EXPECT_EQ(connect_abstract(address).error().code, ErrorCode::kPermission);
  const auto anybody = connect_to_anybody(address);
  ASSERT_TRUE(anybody);
  EXPECT_EQ(peer_of(anybody->get())->uid, 65534u);
  EXPECT_EQ(peer_of(anybody->get())->pid, stranger);
  kill(stranger, SIGKILL);
  waitpid(stranger, nullptr, 0);
}

TEST(Socket, AnEventfdThatWasMadeToBlockIsDrainedWithoutWaiting) {
  const UniqueFd event(eventfd(0, EFD_CLOEXEC));  // as another process may have made it
  drain_eventfd(event.get());
  signal_eventfd(event.get());
  drain_eventfd(event.get());
  EXPECT_FALSE(wait_readable(event.get(), 0));
}

}  // namespace
}  // namespace xauto
