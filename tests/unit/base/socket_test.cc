// SPDX-License-Identifier: Apache-2.0
#include "base/socket.h"

#include <atomic>
#include <filesystem>
#include <fstream>
#include <thread>

#include <gtest/gtest.h>
#include <sys/stat.h>

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

}  // namespace
}  // namespace xauto
