// SPDX-License-Identifier: Apache-2.0
// A port and what may stand behind the address that it is given. Its work with a real coordinator
// is in server_test.cc, every interleaving of it in protocol_test.cc.
#include "coord/port.h"

#include <atomic>
#include <cstring>
#include <functional>
#include <thread>

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "base/socket.h"
#include "coord/server.h"

#include "address.h"

namespace xauto::coord {
namespace {

/// Answers the one who comes with `bytes`, whatever it says.
class Impostor {
 public:
  explicit Impostor(std::vector<char> bytes)
      : listener_(*listen_abstract(address)), thread_([this, bytes = std::move(bytes)] {
          pollfd comes{listener_.get(), POLLIN, 0};
          EXPECT_EQ(poll(&comes, 1, -1), 1);  // the listener does not block
          auto peer = accept_own(listener_.get());
          ASSERT_TRUE(peer);
          Hello hello;
          (void)receive_packet(peer->get(), &hello, sizeof hello);
          if (!bytes.empty()) (void)send_packet(peer->get(), bytes.data(), bytes.size());
        }) {}
  ~Impostor() { thread_.join(); }
  const std::string address = unique_address();

 private:
  UniqueFd listener_;
  std::thread thread_;
};

template <class T>
std::vector<char> bytes_of(const T& packet) {
  std::vector<char> bytes(sizeof packet);
  std::memcpy(bytes.data(), &packet, sizeof packet);
  return bytes;
}

TEST(Port, NobodyBehindTheAddressIsAnError) {
  const std::string address = unique_address();
  const auto port = Port::connect(address, "w", {0}, {});
  ASSERT_FALSE(port);
  EXPECT_NE(port.error().to_string().find(address), std::string::npos);
}

TEST(Port, WhatAnswersIsChecked) {
  Welcome far_off{};
  far_off.slot = kMaxSlots;
  Refused refused{};
  refused.kind = static_cast<std::uint32_t>(MessageKind::kRefused);
  std::memset(refused.reason, 'x', sizeof refused.reason);  // not terminated
  for (const auto& bytes : {std::vector<char>{}, std::vector<char>{'?'}, bytes_of(Welcome{}),
                            bytes_of(far_off), bytes_of(refused)}) {
    const Impostor impostor(bytes);
    const auto port = Port::connect(impostor.address, "w", {0}, {});
    ASSERT_FALSE(port);
    EXPECT_NE(port.error().code, ErrorCode::kInternal);
    EXPECT_LT(port.error().to_string().size(), 2 * sizeof refused.reason);
  }
}

TEST(Port, WhatIsWrongWithAWorkerIsSaidWhereItAsks) {
  const std::string address = unique_address();
  auto server = Server::create({address, "gpu0", Discipline::kGate, {"a", "b"}, {}});
  ASSERT_TRUE(server);
  const UniqueFd stop(eventfd(0, EFD_CLOEXEC));
  std::thread thread([&] { EXPECT_TRUE((*server)->run(stop.get())); });
  const auto refusal = [&](const std::vector<std::uint32_t>& xnodes, const OrderPairs& order) {
    const auto port = Port::connect(address, "w", xnodes, order);
    return port ? std::string() : port.error().to_string();
  };
  EXPECT_NE(refusal({2}, {}).find("names an unknown XNode"), std::string::npos);
  EXPECT_NE(refusal(std::vector<std::uint32_t>(kMaxWorkerXNodes + 1, 0), {}), "");
  EXPECT_NE(refusal({0}, {{0, 1}}), "") << "the coordinator keeps no order";
  EXPECT_EQ(refusal({0, 1}, {}), "");
  signal_eventfd(stop.get());
  thread.join();
}

TEST(Port, AnInterruptedManagementThreadComesBack) {
  const std::string address = unique_address();
  auto server = Server::create({address, "gpu0", Discipline::kPreemptive, {"a"}, {}});
  ASSERT_TRUE(server);
  const UniqueFd stop(eventfd(0, EFD_CLOEXEC));
  std::thread thread([&] { EXPECT_TRUE((*server)->run(stop.get())); });
  const auto port = Port::connect(address, "w", {0}, {});
  ASSERT_TRUE(port) << port.error().to_string();
  Command command = Command::kSuspend;
  std::thread management([&] { command = (*port)->wait_command(); });
  (*port)->interrupt();
  management.join();
  EXPECT_EQ(command, Command::kInterrupted);
  EXPECT_FALSE((*port)->lost());
  EXPECT_FALSE((*port)->contended());
  signal_eventfd(stop.get());
  thread.join();
}

}  // namespace
}  // namespace xauto::coord
