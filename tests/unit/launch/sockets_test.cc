// SPDX-License-Identifier: Apache-2.0
#include "launch/sockets.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include "base/socket.h"

namespace xauto::launch {
namespace {

TEST(Sockets, OfARunAreFoundByItsNameAndCannotBeForeseen) {
  auto first = Sockets::open({"live", "cpu0"}), second = Sockets::open({"live", "cpu0"});
  ASSERT_TRUE(first && second);
  EXPECT_NE(first->run(), second->run());
  const std::string begin = kSocketPrefix + first->run() + "/";
  EXPECT_TRUE(first->run().starts_with(std::to_string(getpid()) + "-"));
  const std::vector<std::string> listening = abstract_sockets(begin);
  ASSERT_EQ(listening.size(), 2u);
  for (const std::string& address : listening) {
    const std::string rest = address.substr(begin.size());
    EXPECT_GE(rest.find('/'), 16u) << rest;
  }
  const auto secret = [](const Sockets& of) {
    const std::string& address = of.address("live");
    return address.substr(address.rfind('/') - 16, 16);
  };
  EXPECT_NE(secret(*first), secret(*second));
  EXPECT_TRUE(connect_abstract(first->address("cpu0")));
  first->take("cpu0").reset();
  EXPECT_FALSE(connect_abstract(first->address("cpu0")));
}

TEST(Sockets, ThatAreInUseAreLookedForElsewhere) {
  // Twice the same name is what a stranger who is quick makes of two: then all of them are tried again.
  const auto twice = Sockets::open({"live", "live"});
  ASSERT_FALSE(twice);
  EXPECT_EQ(twice.error().code, ErrorCode::kUnavailable);
  EXPECT_TRUE(abstract_sockets(kSocketPrefix + std::to_string(getpid()) + "-").empty());
}

}  // namespace
}  // namespace xauto::launch
