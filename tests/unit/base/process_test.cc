// SPDX-License-Identifier: Apache-2.0
#include "base/process.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include "base/memory_file.h"
#include "base/socket.h"

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

}  // namespace
}  // namespace xauto
