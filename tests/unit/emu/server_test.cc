// SPDX-License-Identifier: Apache-2.0
// The emulator behind its socket: real clients, short work, no times judged from above.
#include "emu/server.h"

#include <cstdlib>
#include <cstring>
#include <functional>
#include <thread>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/eventfd.h>
#include <sys/wait.h>
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
    listener_ = std::move(*listen_abstract(address_));
    memory_ = std::move(*StateMemory::make());
    setenv(kEmudVariable, address_.c_str(), 1);
    begin();
  }
  void TearDown() override { end(); }
  /// An emulator in the place of the one before, as the tool starts it.
  void begin() {
    stop_ = UniqueFd(eventfd(0, EFD_CLOEXEC));
    auto server = Server::create(*Platform::builtin("small"),
                                 {.address = address_,
                                  .listener_fd = fcntl(listener_.get(), F_DUPFD_CLOEXEC, 3),
                                  .memory_fd = fcntl(memory_.get(), F_DUPFD_CLOEXEC, 3)});
    ASSERT_TRUE(server) << server.error().to_string();
    server_ = std::move(*server);
    thread_ = std::thread([this] { EXPECT_TRUE(server_->run(stop_.get())); });
  }
  /// As a death of the process: its connections end, and nobody has put anything in order.
  void end() {
    if (!thread_.joinable()) return;
    signal_eventfd(stop_.get());
    thread_.join();
    server_.reset();
  }
  /// What the next emulator would find. The one that runs may be writing: then once more.
  [[nodiscard]] Snapshot newest() const {
    for (;;) {
      auto memory = StateMemory::map(UniqueFd(fcntl(memory_.get(), F_DUPFD_CLOEXEC, 3)));
      auto found = memory->load();
      if (found && *found) return std::move(**found);
    }
  }
  static XpuId gpu() { return {"gpu0", XPU::GPU, 0}; }
  /// A suspended context makes no progress until it is resumed, whatever happens `meanwhile`.
  void expect_suspended_until_resumed(const std::function<void()>& meanwhile) {
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
    meanwhile();
    std::this_thread::sleep_for(20ms);
    EXPECT_FALSE(done.load());
    ASSERT_TRUE(control->resume(id));
    runner.join();
  }

  std::string address_;
  UniqueFd stop_, listener_, memory_;
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
  expect_suspended_until_resumed([] {});
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
  listener_.reset();  // the tool gives up
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

TEST_F(EmuServer, AnswersWhoAsksWhetherItIsThere) {
  auto socket = connect_abstract(address_);
  ASSERT_TRUE(socket);
  const Packet ping{.op = static_cast<std::uint32_t>(Op::kPing), .tag = 7};
  ASSERT_TRUE(send_packet(socket->get(), &ping, sizeof ping));
  Packet answer;
  ASSERT_TRUE(receive_packet(socket->get(), &answer, sizeof answer));
  EXPECT_EQ(answer.op, static_cast<std::uint32_t>(Op::kPong));
  EXPECT_EQ(answer.tag, 7u);
}

// ---- an emulator that dies is followed by another one -----------------------------------------

TEST_F(EmuServer, CallUnderWayGoesOnAtTheNextEmulator) {
  auto context = Context::open(gpu());
  ASSERT_TRUE(context);
  const std::int64_t before = now_ns();
  std::thread runner([&] {
    const Status done = context->run(30ms);
    EXPECT_TRUE(done) << done.error().to_string();
  });
  for (int death = 0; death < 5; ++death) {
    std::this_thread::sleep_for(3ms);
    end();
    begin();
  }
  runner.join();
  EXPECT_GE(now_ns() - before, 30'000'000);
  EXPECT_TRUE(context->run(100us));
  EXPECT_EQ(server_->machine().stats()[4].jobs, 2u);  // the first was done once
}

TEST_F(EmuServer, CallThatEndsWhileThereIsNoEmulatorIsDoneWhenThereIsOne) {
  auto context = Context::open(gpu());
  ASSERT_TRUE(context);
  std::atomic<bool> returned{false};
  std::thread runner([&] {
    EXPECT_TRUE(context->run(200ms));  // so long that it is seen on a busy machine, too
    returned.store(true);
  });
  while (newest().contexts.at(0).busy == 0) std::this_thread::yield();
  end();
  std::this_thread::sleep_for(250ms);
  EXPECT_FALSE(returned.load());
  begin();
  runner.join();
}

TEST_F(EmuServer, SuspendedContextStaysSuspendedUntilTheNextEmulatorResumesIt) {
  expect_suspended_until_resumed([this] {
    end();
    begin();
  });
}

TEST_F(EmuServer, RequestsAndNewContextsWaitForTheNextEmulator) {
  auto context = Context::open(gpu());
  auto control = Control::connect();
  ASSERT_TRUE(context && control);
  const auto id = static_cast<std::uint32_t>(context->handle().value());
  end();
  std::thread asker([&] {
    EXPECT_TRUE(control->suspend(id));
    EXPECT_TRUE(control->resume(id));
    auto other = Context::open(gpu());
    ASSERT_TRUE(other) << other.error().to_string();
    EXPECT_NE(other->handle().value(), id);
    EXPECT_TRUE(other->run(100us));
  });
  std::this_thread::sleep_for(5ms);
  begin();
  asker.join();
  EXPECT_TRUE(context->run(100us));
}

/// The emulator accepts no connection and reads nothing, for longer than anything takes; the tool
/// then starts another one. The context must not stay suspended for good.
TEST_F(EmuServer, ResumingAtOneThatHangsIsDoneByTheNext) {
  auto context = Context::open(gpu());
  auto control = Control::connect();
  ASSERT_TRUE(context && control);
  const auto id = static_cast<std::uint32_t>(context->handle().value());
  ASSERT_TRUE(control->suspend(id));
  signal_eventfd(stop_.get());  // it has stopped reading; its connections are open
  thread_.join();
  std::thread resumer([&] { EXPECT_TRUE(control->resume(id)); });
  std::this_thread::sleep_for(1100ms);
  server_.reset();
  begin();
  resumer.join();
  EXPECT_TRUE(context->run(100us));
}

TEST_F(EmuServer, NobodyTakesUpAContextThatIsNotTheirs) {
  auto mine = Context::open(gpu());
  ASSERT_TRUE(mine);
  const auto id = static_cast<std::uint32_t>(mine->handle().value());
  end();
  begin();
  auto socket = connect_abstract(address_);
  ASSERT_TRUE(socket);
  for (const std::int64_t key : {0, 1, -1}) {
    const Packet theft{.op = static_cast<std::uint32_t>(Op::kRejoin), .context = id, .value = key};
    ASSERT_TRUE(send_packet(socket->get(), &theft, sizeof theft));
    Packet answer;
    ASSERT_TRUE(receive_packet(socket->get(), &answer, sizeof answer));
    EXPECT_EQ(answer.op, static_cast<std::uint32_t>(Op::kError));
  }
  EXPECT_TRUE(mine->run(100us));
  // Nor while it has an owner, with the right key either.
  const Packet late{.op = static_cast<std::uint32_t>(Op::kRejoin),
                    .context = id,
                    .value = static_cast<std::int64_t>(newest().contexts.at(0).key)};
  ASSERT_TRUE(send_packet(socket->get(), &late, sizeof late));
  Packet answer;
  ASSERT_TRUE(receive_packet(socket->get(), &answer, sizeof answer));
  EXPECT_EQ(answer.op, static_cast<std::uint32_t>(Op::kError));
}

TEST_F(EmuServer, ContextsOfAProcessThatDoesNotComeBackAreClosed) {
  end();
  int gate[2];
  ASSERT_EQ(pipe2(gate, O_CLOEXEC), 0);
  const pid_t dead = fork();
  if (dead == 0) _exit(0);
  ASSERT_EQ(waitpid(dead, nullptr, 0), dead);
  const pid_t alive = fork();
  if (alive == 0) {
    char byte;
    close(gate[1]);
    [[maybe_unused]] const ssize_t end = read(gate[0], &byte, 1);
    _exit(0);
  }
  Machine machine = *Machine::create(*Platform::builtin("small"));
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(machine.open("gpu0", 0));
  Snapshot snapshot;
  machine.save(snapshot);
  snapshot.contexts[0].pid = dead;
  snapshot.contexts[1].pid = alive;
  snapshot.contexts[2].pid = alive;
  snapshot.contexts[3].pid = getpid();
  StateMemory::map(UniqueFd(fcntl(memory_.get(), F_DUPFD_CLOEXEC, 3)))->save(snapshot);

  begin();
  while (newest().contexts.size() != 3) std::this_thread::yield();
  for (const ContextRecord& context : newest().contexts) EXPECT_NE(context.pid, dead);
  close(gate[1]);  // the other one ends, too
  ASSERT_EQ(waitpid(alive, nullptr, 0), alive);
  while (newest().contexts.size() != 1) std::this_thread::yield();
  EXPECT_EQ(newest().contexts[0].pid, getpid());
  close(gate[0]);
}

TEST_F(EmuServer, MemoryOfAnotherPlatformIsRefused) {
  end();
  Snapshot snapshot;
  Machine::create(*Platform::builtin("large"))->save(snapshot);
  StateMemory::map(UniqueFd(fcntl(memory_.get(), F_DUPFD_CLOEXEC, 3)))->save(snapshot);
  EXPECT_FALSE(Server::create(*Platform::builtin("small"),
                              {.address = address_,
                               .listener_fd = fcntl(listener_.get(), F_DUPFD_CLOEXEC, 3),
                               .memory_fd = fcntl(memory_.get(), F_DUPFD_CLOEXEC, 3)}));
}

TEST_F(EmuServer, BusyTimeIsTheWorkThatWasDoneAndOutlivesTheEmulator) {
  auto context = Context::open(gpu());
  auto control = Control::connect();
  ASSERT_TRUE(context && control);
  EXPECT_EQ(control->busy_ns("gpu0").value(), 0);
  ASSERT_TRUE(context->run(3ms));
  EXPECT_EQ(control->busy_ns("gpu0").value(), 3'000'000) << "of the device's time, not of ours";
  EXPECT_EQ(control->busy_ns("dla0").value(), 0);
  end();
  begin();
  ASSERT_TRUE(context->run(2ms));
  EXPECT_EQ(control->busy_ns("gpu0").value(), 5'000'000);
  const auto unknown = control->busy_ns("gpu7");
  ASSERT_FALSE(unknown);
  EXPECT_EQ(unknown.error().code, ErrorCode::kNotFound);
  EXPECT_FALSE(control->busy_ns(std::string(kMaxDeviceName, 'g')));
}

}  // namespace
}  // namespace xauto::emu
