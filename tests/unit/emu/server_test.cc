// SPDX-License-Identifier: Apache-2.0
// The emulator behind its socket: real clients, short work, no times judged from above.
#include "emu/server.h"

#include <cstdlib>
#include <cstring>
#include <thread>

#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <xauto/emu.h>

#include "base/clock.h"
#include "base/socket.h"
#include "emu/client.h"

namespace xauto::emu {
namespace {

using namespace std::chrono_literals;

class EmuServer : public ::testing::Test {
 protected:
  void SetUp() override {
    address_ = "xauto-test/emud-" + std::to_string(getpid());
    stop_ = UniqueFd(eventfd(0, EFD_CLOEXEC));
    server_ = std::move(*Server::create(*Platform::builtin("small"), {.address = address_}));
    thread_ = std::thread([this] { EXPECT_TRUE(server_->run(stop_.get())); });
    setenv(kEmudVariable, address_.c_str(), 1);
  }
  void TearDown() override { end(); }
  void end() {
    if (!thread_.joinable()) return;
    signal_eventfd(stop_.get());
    thread_.join();
    server_.reset();
  }
  static XpuId gpu() { return {"gpu0", XPU::GPU, 0}; }

  std::string address_;
  UniqueFd stop_;
  std::unique_ptr<Server> server_;
  std::thread thread_;
};

TEST_F(EmuServer, RunTakesAtLeastItsTime) {
  auto context = Context::open(gpu());
  ASSERT_TRUE(context) << context.error().to_string();
  const std::int64_t before = now_ns();
  EXPECT_TRUE(context->run(2000us));
  EXPECT_GE(now_ns() - before, 2'000'000);
}

TEST_F(EmuServer, SuspendedContextMakesNoProgressUntilItIsResumed) {
  auto context = Context::open(gpu());
  auto control = Control::connect();
  ASSERT_TRUE(context && control);
  const auto id = static_cast<std::uint32_t>(context->handle().value());
  ASSERT_TRUE(control->suspend(id));
  std::atomic<bool> done{false};
  std::thread runner([&] {
    EXPECT_TRUE(context->run(500us));
    done.store(true);
  });
  std::this_thread::sleep_for(20ms);
  EXPECT_FALSE(done.load());
  ASSERT_TRUE(control->resume(id));
  runner.join();
}

TEST_F(EmuServer, DeathOfTheEmulatorIsAnErrorAndNoHang) {
  auto context = Context::open(gpu());
  auto control = Control::connect();
  ASSERT_TRUE(context && control);
  std::thread runner([&] {
    const Status status = context->run(std::chrono::hours(1));
    EXPECT_FALSE(status);
  });
  std::this_thread::sleep_for(5ms);
  end();
  runner.join();
  EXPECT_EQ(control->suspend(1).error().code, ErrorCode::kUnavailable);
  EXPECT_FALSE(context->run(1us));
  EXPECT_FALSE(Context::open(gpu()));
}

TEST_F(EmuServer, RefusesUnknownXpusAndForeignContexts) {
  const auto nowhere = Context::open({"gpu7", XPU::GPU, 7});
  ASSERT_FALSE(nowhere);
  EXPECT_EQ(nowhere.error().code, ErrorCode::kNotFound);
  auto control = Control::connect();
  ASSERT_TRUE(control);
  EXPECT_FALSE(control->suspend(12345));
  auto mine = Context::open(gpu());
  auto socket = connect_abstract(address_);
  ASSERT_TRUE(mine && socket);
  const Packet theft{.op = static_cast<std::uint32_t>(Op::kSubmit),
                     .context = static_cast<std::uint32_t>(mine->handle().value()),
                     .tag = 1,
                     .value = 1000};
  ASSERT_TRUE(send_packet(socket->get(), &theft, sizeof theft));
  Packet answer;
  ASSERT_TRUE(receive_packet(socket->get(), &answer, sizeof answer));
  EXPECT_EQ(answer.op, static_cast<std::uint32_t>(Op::kError));
  EXPECT_STREQ(answer.name, "not a context of yours");
}

TEST_F(EmuServer, GarbageCostsOnlyTheConnectionThatSentIt) {
  auto context = Context::open(gpu());
  ASSERT_TRUE(context);
  for (const std::size_t size :
       {std::size_t{1}, sizeof(Packet) - 1, sizeof(Packet), sizeof(Packet) + 9}) {
    auto socket = connect_abstract(address_);
    ASSERT_TRUE(socket);
    const std::vector<char> junk(size, static_cast<char>(0xee));
    ASSERT_TRUE(send_packet(socket->get(), junk.data(), junk.size()));
    Packet answer;
    EXPECT_FALSE(receive_packet(socket->get(), &answer, sizeof answer));  // closed
  }
  EXPECT_TRUE(context->run(100us));
}

}  // namespace
}  // namespace xauto::emu
