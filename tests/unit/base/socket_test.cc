// SPDX-License-Identifier: Apache-2.0
#include "base/socket.h"

#include <atomic>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

namespace xauto {
namespace {

namespace fs = std::filesystem;

class ListenPath : public testing::Test {
 protected:
  void SetUp() override {
    char folder[] = "/tmp/xauto-socket-XXXXXX";
    folder_ = mkdtemp(folder);
    path_ = folder_ + "/it.sock";
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string folder_, path_;
};

/// Whoever waits for the file, and connects or changes its mode then.
TEST_F(ListenPath, WhoSeesTheSocketMayConnectAndChangeItsMode) {
  for (int round = 0; round < 200; ++round) {
    std::atomic<bool> connected{false};
    std::thread waits([&] {
      while (!fs::exists(path_)) std::this_thread::yield();
      EXPECT_EQ(chmod(path_.c_str(), 0666), 0);
      connected = connect_path(path_).has_value();
    });
    const auto listener = listen_path(path_, 0600);
    waits.join();
    ASSERT_TRUE(listener) << listener.error().to_string();
    EXPECT_TRUE(connected);
    EXPECT_EQ(fs::status(path_).permissions(), static_cast<fs::perms>(0666)) << "round " << round;
    fs::remove(path_);
  }
}

TEST_F(ListenPath, ASocketIsReplacedAndAFileIsNot) {
  ASSERT_TRUE(listen_path(path_, 0600));
  EXPECT_TRUE(listen_path(path_, 0600));
  EXPECT_FALSE(fs::exists(path_ + ".new"));
  fs::remove(path_);
  std::ofstream(path_) << "mine";
  const auto refused = listen_path(path_, 0600);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().what.find("no socket"), std::string::npos) << refused.error().what;
  EXPECT_EQ(fs::file_size(path_), 4U);
}

std::string names_us() {
  return "by uid " + std::to_string(geteuid()) + ", pid " + std::to_string(getpid());
}

TEST_F(ListenPath, WhoListensKeepsItAndIsNamed) {
  const auto listener = listen_path(path_, 0600);
  ASSERT_TRUE(listener);
  const auto second = listen_path(path_, 0600);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kUnavailable);
  EXPECT_NE(second.error().what.find("is served already, " + names_us()), std::string::npos)
      << second.error().what;
  EXPECT_TRUE(connect_path(path_));
  // One that takes nobody in, and a socket of another kind.
  std::vector<UniqueFd> waiting;
  for (auto one = connect_to_anybody(path_); one; one = connect_to_anybody(path_))
    waiting.push_back(std::move(*one));
  EXPECT_FALSE(listen_path(path_, 0600));
  fs::remove(path_);
  const UniqueFd stream(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_un name{.sun_family = AF_UNIX, .sun_path = {}};
  path_.copy(name.sun_path, sizeof name.sun_path - 1);
  ASSERT_EQ(bind(stream.get(), reinterpret_cast<sockaddr*>(&name), sizeof name), 0);
  ASSERT_EQ(listen(stream.get(), 1), 0);
  EXPECT_FALSE(listen_path(path_, 0600));
}

/// Each of them would otherwise take the socket of the one before away, whom nobody reaches any more.
TEST_F(ListenPath, OfManyThatStartAtOnceOneListensAndTheOthersSayWho) {
  constexpr int kStarts = 4;
  for (int round = 0; round < 200; ++round) {
    std::atomic<int> ready{0};
    std::vector<Result<UniqueFd>> listeners(kStarts);
    std::vector<std::thread> starts;
    for (int i = 0; i < kStarts; ++i)
      starts.emplace_back([&, i] {
        ++ready;
        while (ready < kStarts) std::this_thread::yield();
        listeners[static_cast<std::size_t>(i)] = listen_path(path_, 0600);
      });
    for (std::thread& thread : starts) thread.join();
    int listen = 0;
    for (auto& listener : listeners) {
      if (!listener) {
        ASSERT_NE(listener.error().what.find(names_us()), std::string::npos)
            << listener.error().to_string();
        continue;
      }
      ++listen;
      ASSERT_TRUE(connect_path(path_));
      ASSERT_TRUE(accept_own(listener->get()));  // it is this one's
    }
    ASSERT_EQ(listen, 1) << "round " << round;
    listeners.clear();  // the socket stays, as after a kill
  }
}

/// Whoever was killed, wherever he was: his lock has gone with him, and what he has left is no obstacle.
TEST_F(ListenPath, AfterAKillTheNextOneListens) {
  for (int round = 0; round < 30; ++round) {
    const pid_t child = fork();
    if (child == 0)
      for (;;) static_cast<void>(listen_path(path_, 0600));
    while (!fs::exists(path_) && round == 0) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::microseconds(17 * round));
    kill(child, SIGKILL);
    ASSERT_EQ(waitpid(child, nullptr, 0), child);
    const auto listener = listen_path(path_, 0600);
    ASSERT_TRUE(listener) << listener.error().to_string();
    ASSERT_FALSE(fs::exists(path_ + ".new")) << "round " << round;
  }
}

/// One that has stopped in between: nobody waits for him for ever.
TEST_F(ListenPath, WhoDoesNotGoOnIsSaid) {
  const UniqueFd lock(open((path_ + ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
  ASSERT_EQ(flock(lock.get(), LOCK_EX), 0);
  const auto refused = listen_path(path_, 0600);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kTimeout);
  EXPECT_FALSE(fs::exists(path_));
}

}  // namespace
}  // namespace xauto
