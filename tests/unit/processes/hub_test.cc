// SPDX-License-Identifier: Apache-2.0
// The hub and a member, each in this process, over real sockets; and those that are no members.
#include "processes/hub.h"

#include <atomic>
#include <cstring>
#include <functional>
#include <thread>

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/resource.h>
#include <unistd.h>

#include "base/socket.h"
#include "processes/member.h"

namespace xauto::runtime {
namespace {

class Host final : public HubHost {
 public:
  void event(const Packet& packet) override {
    last_module.store(static_cast<int>(packet.index));
    events.fetch_add(1);
  }
  void left(int) override { losses.fetch_add(1); }
  void joins(int) override { joined.fetch_add(1); }
  std::atomic<int> events{0}, losses{0}, joined{0}, last_module{-1};
};

void wait_for(const std::function<bool()>& condition) {
  while (!condition()) std::this_thread::yield();  // the test's own time limit is the net
}

/// Two modules: the first in the hub's process, the second in a member's.
class HubTest : public ::testing::Test {
 protected:
  HubTest() {
    static std::atomic<int> count{0};
    session_.parts.hub = "xauto-test/" + std::to_string(getpid()) + "-" +
                         std::to_string(count.fetch_add(1)) + "/hub";
    graph_.name = "two";
    graph_.modules.resize(2);
    plan_.processes = 2;
    plan_.process_of = {0, 1};
    auto hub = Hub::create(plan_, graph_, session_, 0, host_);
    EXPECT_TRUE(hub) << hub.error().to_string();
    hub_ = std::move(*hub);
    member_session_ = session_;
    member_session_.parts.process = 1;
  }
  std::unique_ptr<Member> join() {
    auto member = Member::join(plan_, graph_, member_session_, 0);
    EXPECT_TRUE(member) << member.error().to_string();
    return std::move(*member);
  }
  /// Both ready, Go said.
  std::unique_ptr<Member> running() {
    auto member = join();
    std::thread hub([&] { EXPECT_TRUE(*hub_->wait_ready(stop_)); });
    EXPECT_TRUE(*member->ready(stop_));
    hub.join();
    return member;
  }
  UniqueFd stranger() { return *connect_abstract(session_.parts.hub); }
  static void expect_cut_off(int socket) {
    char byte;
    pollfd ended{socket, POLLIN, 0};
    EXPECT_EQ(poll(&ended, 1, -1), 1);
    EXPECT_LE(read(socket, &byte, 1), 0);
  }

  Graph graph_;
  Plan plan_;
  Session session_, member_session_;
  Host host_;
  std::atomic<bool> stop_{false};
  std::unique_ptr<Hub> hub_;
};

TEST_F(HubTest, AMemberJoinsTellsReportsAndEnds) {
  const auto member = running();
  EXPECT_EQ(host_.joined.load(), 0) << "nobody stood in for it";
  member->tell(1, 7, 100, 200, false, nullptr);
  wait_for([&] { return host_.events.load() == 1; });
  EXPECT_EQ(host_.last_module.load(), 1);
  std::thread ends([&] {
    EXPECT_TRUE(member->wait_stop(stop_));
    member->report("all is said");
  });
  EXPECT_EQ(hub_->stop(), std::vector<std::string>{"all is said"});
  ends.join();
  EXPECT_TRUE(hub_->deaths().empty());
}

TEST_F(HubTest, ADeathIsNoticedAndTheNextProcessTakesOver) {
  running().reset();
  wait_for([&] { return host_.losses.load() == 1; });
  EXPECT_EQ(hub_->deaths(), std::vector<int>{1});
  const auto next = join();
  EXPECT_TRUE(*next->ready(stop_));
  EXPECT_EQ(host_.joined.load(), 1);
}

TEST_F(HubTest, AMemberThatEndsBeforeItIsReadyIsNotWaitedForOnceItIsSaidToBeGone) {
  join().reset();
  wait_for([&] { return !hub_->deaths().empty(); });
  ASSERT_TRUE(say(stranger().get(), Word::kGone, 1));
  const auto ready = hub_->wait_ready(stop_);
  ASSERT_FALSE(ready);
  EXPECT_EQ(ready.error().where, "process 1 of app 'two'");
}

TEST(Hub, AMemberThatDoesNotReadKeepsNobodyWaiting) {
  constexpr std::size_t kTopics = 400;  // more than a socket holds
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
  Graph graph;
  graph.name = "wide";
  graph.modules.resize(3);
  graph.topics.resize(kTopics);
  Plan plan;
  plan.processes = 3;
  plan.process_of = {0, 1, 2};
  for (std::size_t t = 0; t < kTopics; ++t) {
    graph.topics[t].spec.name = "topic" + std::to_string(t);
    graph.topics[t].spec.plain_bytes = 8;
    plan.topics.push_back({.publisher = 1, .readers = {2}});
  }
  Session session;
  session.parts.hub = "xauto-test/" + std::to_string(getpid()) + "-wide/hub";
  Host host;
  auto hub = Hub::create(plan, graph, session, 0, host);
  ASSERT_TRUE(hub) << hub.error().to_string();
  const auto deaf = connect_abstract(session.parts.hub);
  ASSERT_TRUE(say(deaf->get(), Word::kHello, 1));
  Session second = session;
  second.parts.process = 2;
  const auto member = Member::join(plan, graph, second, 0);  // is told of all topics meanwhile
  EXPECT_TRUE(member) << member.error().to_string();
  // Who reads late has missed nothing.
  std::size_t told = 0;
  for (Packet packet{}; packet.word != static_cast<std::uint32_t>(Word::kBegin);) {
    std::vector<UniqueFd> fds;
    ASSERT_TRUE(receive_packet(deaf->get(), &packet, sizeof packet, &fds));
    told += packet.word == static_cast<std::uint32_t>(Word::kTopic) ? 1 : 0;
  }
  EXPECT_EQ(told, kTopics);
}

TEST_F(HubTest, WhoTalksNonsenseIsCutOffAndNobodyElseIs) {
  const auto member = running();
  const Packet hello{.word = static_cast<std::uint32_t>(Word::kHello), .index = 1};
  std::vector<std::vector<char>> nonsense = {{}, {'x'}, std::vector<char>(sizeof(Packet), '\xff')};
  for (const std::uint32_t index : {0u, 1u, 2u, 0xffffffffu}) {  // 1: it is there already
    Packet packet = hello;
    packet.index = index;
    nonsense.emplace_back(sizeof packet);
    std::memcpy(nonsense.back().data(), &packet, sizeof packet);
  }
  for (const Word word : {Word::kReady, Word::kEvent, Word::kReport, Word::kStop}) {
    Packet packet = hello;
    packet.word = static_cast<std::uint32_t>(word);
    nonsense.emplace_back(sizeof packet);
    std::memcpy(nonsense.back().data(), &packet, sizeof packet);
  }
  for (const auto& bytes : nonsense) {
    if (bytes.empty()) continue;
    const UniqueFd who = stranger();
    ASSERT_TRUE(send_packet(who.get(), bytes.data(), bytes.size()));
    expect_cut_off(who.get());
  }
  member->tell(1, 8, 100, 200, false, nullptr);
  wait_for([&] { return host_.events.load() == 1; });
  EXPECT_EQ(host_.losses.load(), 0);
}

TEST_F(HubTest, AMemberSpeaksOnlyForItsOwnModules) {
  const auto member = running();
  member->tell(0, 1, 100, 200, false, nullptr);  // the hub's
  wait_for([&] { return host_.losses.load() == 1; });
  EXPECT_EQ(host_.events.load(), 0);
}

}  // namespace
}  // namespace xauto::runtime
