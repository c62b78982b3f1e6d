// SPDX-License-Identifier: Apache-2.0
// The plug-in for DDS, through its door: what goes out comes in, nothing waits, nothing foreign
// gets through. Two participants of one process, in a domain on the loopback interface.
#include "transport/bridge.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <string>
#include <thread>

#include <gtest/gtest.h>

#include "base/clock.h"

namespace xauto::transport {
namespace {

using std::chrono::milliseconds;

struct Point {
  std::int64_t x, y;
};

TEST(Bridge, PlugInThatIsNotThereIsNamed) {
  const auto bridge = open_bridge("carrier-pigeon", {});
  ASSERT_FALSE(bridge);
  EXPECT_EQ(bridge.error().code, ErrorCode::kUnavailable);
  EXPECT_EQ(bridge.error().what, "transport 'carrier-pigeon' is not there");
}

class Dds : public ::testing::Test {
 protected:
  void SetUp() override {
    setenv("CYCLONEDDS_URI",
           "<CycloneDDS><Domain id=\"any\"><General><Interfaces><NetworkInterface name=\"lo\"/>"
           "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
           "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address=\"localhost\"/></Peers>"
           "</Discovery></Domain></CycloneDDS>",
           1);
    if (!std::filesystem::exists(XAUTO_BINARY_DIR "/lib/xauto/cyclonedds.so"))
      GTEST_SKIP() << "cyclonedds-dev is not installed";
    auto one = open_bridge("cyclonedds", options());
    ASSERT_TRUE(one) << one.error().to_string();
    auto two = open_bridge("cyclonedds", options());
    ASSERT_TRUE(two) << two.error().to_string();
    here_ = std::move(*one);
    there_ = std::move(*two);
  }
  static BridgeOptions options() { return {.domain = 79, .largest_bytes = 1 << 20}; }

  /// Publishes `send` until something comes, which is so when both have found each other.
  template <class T>
  static std::shared_ptr<const void> until_heard(Publisher& publisher, Subscriber& subscriber,
                                                 const T& send) {
    for (std::uint64_t k = 0; k < 2000; ++k) {
      publisher.publish({std::make_shared<const T>(send), now_ns(), k});
      if (auto envelope = subscriber.take()) return envelope->message;
      std::this_thread::sleep_for(milliseconds(5));
    }
    return nullptr;
  }

  Doorbell doorbell_;
  std::unique_ptr<Bridge> here_, there_;
};

TEST_F(Dds, MessageComesOutAsItWentIn) {
  const auto spec = *detail::topic_spec(Topic<std::string>("text"));
  const auto publisher = *here_->publish(spec, {});
  const auto subscriber = *there_->subscribe(spec, {}, doorbell_);
  EXPECT_EQ(publisher->loan(8), nullptr);
  const auto message = until_heard(*publisher, *subscriber, std::string("a pedestrian"));
  ASSERT_NE(message, nullptr);
  EXPECT_EQ(*static_cast<const std::string*>(message.get()), "a pedestrian");
}

TEST_F(Dds, MessageOfAnotherSizeIsRefusedAndCounted) {
  const auto publisher = *here_->publish(*detail::topic_spec(Topic<std::string>("point")), {});
  const auto subscriber =
      *there_->subscribe(*detail::topic_spec(Topic<Point>("point")), {}, doorbell_);
  for (int i = 0; i < 2000 && subscriber->lost() == 0; ++i) {
    publisher->publish({std::make_shared<const std::string>("no point"), now_ns(), 0});
    EXPECT_FALSE(subscriber->take());
    std::this_thread::sleep_for(milliseconds(5));
  }
  EXPECT_GT(subscriber->lost(), 0u);
  const auto notes = there_->notes();
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_NE(notes[0].find("topic 'point' from DDS"), std::string::npos) << notes[0];
  // Sixteen bytes are a Point, whatever they mean.
  const auto message = until_heard(*publisher, *subscriber, std::string(sizeof(Point), '\1'));
  ASSERT_NE(message, nullptr);
  EXPECT_EQ(static_cast<const Point*>(message.get())->x, 0x0101010101010101);
}

TEST_F(Dds, MessagesThatANewerOneReplacesAreCounted) {
  const auto spec = *detail::topic_spec(Topic<std::string>("fast"));
  const auto publisher = *here_->publish(spec, {});
  const auto subscriber = *there_->subscribe(spec, {}, doorbell_);
  const auto other =
      *there_->subscribe(*detail::topic_spec(Topic<std::string>("other")), {}, doorbell_);
  ASSERT_NE(until_heard(*publisher, *subscriber, std::string("x")), nullptr);
  // A number is known to have come once it waits, or has replaced the one before.
  const auto come = [&](std::uint64_t number, auto seen) {
    publisher->publish({std::make_shared<const std::string>("y"), now_ns(), number});
    for (int i = 0; i < 20'000 && !seen(); ++i) std::this_thread::sleep_for(milliseconds(1));
  };
  // What until_heard has sent may still be under way: the first of ours is the last of it.
  std::uint64_t number = 10'000;
  come(number, [&] {
    const auto envelope = subscriber->take();
    return envelope && envelope->sequence == number;
  });
  const std::uint64_t before = subscriber->replaced();
  come(++number, [&] { return !subscriber->empty(); });
  for (std::uint64_t k = 1; k <= 5; ++k)
    come(++number, [&] { return subscriber->replaced() == before + k; });
  EXPECT_EQ(subscriber->replaced(), before + 5);
  const auto newest = subscriber->take();
  ASSERT_TRUE(newest);
  EXPECT_EQ(newest->sequence, number);
  EXPECT_FALSE(subscriber->take());
  EXPECT_EQ(subscriber->replaced(), before + 5);
  EXPECT_EQ(other->replaced(), 0u);  // of the same type
}

TEST_F(Dds, TombstonesAreOfTheAppAlone) {
  const auto spec = *detail::topic_spec(Topic<std::string>("quiet"));
  const auto publisher = *here_->publish(spec, {});
  const auto subscriber = *there_->subscribe(spec, {}, doorbell_);
  ASSERT_NE(until_heard(*publisher, *subscriber, std::string("x")), nullptr);
  here_->stop();  // what waited is out, and nobody empties the queue
  for (std::uint64_t k = 0; k < 2 * kBridgeQueue; ++k) publisher->publish({nullptr, 0, k});
  EXPECT_EQ(publisher->next_sequence(), 2 * kBridgeQueue);
  EXPECT_EQ(publisher->unsent(), 0u);  // none was queued
}

TEST_F(Dds, FeedHearsReliableAndBestEffortPublishersAndEachMessageOnce) {
  const TopicQos best_effort{.reliability = Reliability::kBestEffort};
  for (const TopicQos& offered : {TopicQos{}, best_effort}) {
    const auto spec = *detail::topic_spec(
        Topic<std::string>(offered == best_effort ? "best_effort" : "reliable"));
    const auto publisher = *here_->publish(spec, offered);
    const auto subscriber = *there_->subscribe(spec, {}, doorbell_);
    ASSERT_NE(until_heard(*publisher, *subscriber, std::string("x")), nullptr);
    // The last number comes, and until then no number twice.
    std::uint64_t last = 99, highest = 0;
    for (std::uint64_t k = 10'000; highest < 10'100; ++k) {
      ASSERT_LT(k, 20'000u);
      publisher->publish({std::make_shared<const std::string>("y"), now_ns(), k});
      std::this_thread::sleep_for(milliseconds(1));
      while (const auto envelope = subscriber->take()) {
        if (envelope->sequence < 10'000) continue;
        EXPECT_NE(envelope->sequence, last);
        highest = std::max(highest, last = envelope->sequence);
      }
    }
  }
  EXPECT_TRUE(there_->notes().empty());
}

/// The second reader comes with the publisher that needs it, and leaves out what the first one hears.
TEST_F(Dds, ABestEffortPublisherThatComesLaterIsHeardToo) {
  const auto spec = *detail::topic_spec(Topic<std::string>("both"));
  const auto reliable = *here_->publish(spec, {});
  const auto subscriber = *there_->subscribe(spec, {}, doorbell_);
  ASSERT_NE(until_heard(*reliable, *subscriber, std::string("x")), nullptr);
  const auto other = *here_->publish(spec, {.reliability = Reliability::kBestEffort});
  std::set<std::uint64_t> heard;
  bool of_both[2] = {false, false};
  for (std::uint64_t k = 10'000; !of_both[0] || !of_both[1] || k < 10'200; ++k) {
    ASSERT_LT(k, 20'000u);
    (k % 2 == 0 ? reliable : other)
        ->publish({std::make_shared<const std::string>("y"), now_ns(), k});
    std::this_thread::sleep_for(milliseconds(1));
    while (const auto envelope = subscriber->take()) {
      if (envelope->sequence < 10'000) continue;
      EXPECT_TRUE(heard.insert(envelope->sequence).second) << envelope->sequence << " twice";
      of_both[envelope->sequence % 2] = true;
    }
  }
  EXPECT_TRUE(there_->notes().empty());
}

TEST_F(Dds, PublisherThatOffersLessThanIsAskedForIsNamed) {
  const struct {
    TopicQos offered, asked;
    const char* policy;
  } cases[] = {{{.reliability = Reliability::kBestEffort},
                {.reliability = Reliability::kReliable},
                "reliability"},
               {{}, {.durability = Durability::kTransientLocal}, "durability"},
               {{}, {.deadline_us = 1'000'000}, "deadline"}};
  int number = 0;
  for (const auto& [offered, asked, policy] : cases) {
    const auto spec = *detail::topic_spec(Topic<std::string>("less_" + std::to_string(number++)));
    const auto publisher = *here_->publish(spec, offered);
    const auto subscriber = *there_->subscribe(spec, asked, doorbell_);
    std::string all;
    for (int i = 0; i < 2000 && all.find(policy) == std::string::npos; ++i) {
      publisher->publish({std::make_shared<const std::string>("x"), now_ns(), 0});
      EXPECT_FALSE(subscriber->take());
      std::this_thread::sleep_for(milliseconds(2));
      all.clear();
      for (const std::string& note : there_->notes()) all += note;
    }
    EXPECT_NE(all.find(policy), std::string::npos) << all;
  }
}

TEST_F(Dds, WhoComesLateHearsTheLastMessagesOfATransientPublisher) {
  const TopicQos keeps{.durability = Durability::kTransientLocal, .depth = 1};
  const auto spec = *detail::topic_spec(Topic<std::string>("map"));
  const auto publisher = *here_->publish(spec, keeps);
  publisher->publish({std::make_shared<const std::string>("the map"), now_ns(), 3});
  here_->stop();  // it is out
  const auto subscriber =
      *there_->subscribe(spec, {.durability = Durability::kTransientLocal}, doorbell_);
  std::optional<detail::Envelope> envelope;
  for (int i = 0; i < 4000 && !envelope; ++i) {
    std::this_thread::sleep_for(milliseconds(1));
    envelope = subscriber->take();
  }
  ASSERT_TRUE(envelope);
  EXPECT_EQ(*static_cast<const std::string*>(envelope->message.get()), "the map");
}

TEST_F(Dds, OriginIsTheStampAsFarAsItIsCredible) {
  const auto spec = *detail::topic_spec(Topic<std::string>("stamped"));
  const auto publisher = *here_->publish(spec, {});
  const auto subscriber = *there_->subscribe(spec, {}, doorbell_);
  ASSERT_NE(until_heard(*publisher, *subscriber, std::string("x")), nullptr);
  const auto origin_of = [&](std::int64_t origin_ns, std::uint64_t number) {
    for (int i = 0; i < 2000; ++i) {
      publisher->publish({std::make_shared<const std::string>("y"), origin_ns, number});
      std::this_thread::sleep_for(milliseconds(2));
      while (const auto envelope = subscriber->take())
        if (envelope->sequence == number) return envelope->origin_ns;
    }
    return std::int64_t{0};
  };
  const std::int64_t began = now_ns();
  // By way of the wall clock, which may be set by less than this meanwhile.
  EXPECT_NEAR(static_cast<double>(origin_of(began - 3'000'000'000, 9001)),
              static_cast<double>(began - 3'000'000'000), 1e6);
  EXPECT_TRUE(there_->notes().empty());
  EXPECT_GE(origin_of(began - 3'600'000'000'000, 9002), began);           // an hour old
  const std::int64_t ahead = origin_of(began + 3'600'000'000'000, 9003);  // by an hour
  EXPECT_LE(ahead, now_ns());
  const auto notes = there_->notes();
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_NE(notes[0].find("count from their arrival"), std::string::npos) << notes[0];
}

TEST_F(Dds, PublisherNeverWaitsAndTheOldestIsLost) {
  const auto spec = *detail::topic_spec(Topic<std::string>("flood"));
  const auto publisher = *here_->publish(spec, {});
  here_->stop();  // as if DDS took nothing any more
  for (std::uint64_t k = 0; k < 100; ++k)
    publisher->publish({std::make_shared<const std::string>("x"), now_ns(), k});
  EXPECT_EQ(publisher->unsent(), 100 - kBridgeQueue);
  EXPECT_NE(here_->notes().at(0).find("96 messages were lost"), std::string::npos);
}

TEST_F(Dds, NameThatRos2ForbidsIsRefused) {
  for (const char* name : {"", "a b", "1st", "a//b", "a/", "\xc3\xa4"}) {
    const auto refused = here_->publish(*detail::topic_spec(Topic<std::string>(name)), {});
    ASSERT_FALSE(refused) << name;
    EXPECT_EQ(refused.error().what, "is no name that ROS 2 allows");
  }
  EXPECT_TRUE(here_->publish(*detail::topic_spec(Topic<std::string>("front/camera_1")), {}));
}

TEST_F(Dds, DomainOutOfRangeIsRefused) {
  EXPECT_FALSE(open_bridge("cyclonedds", {.domain = 233, .largest_bytes = 1}));
  EXPECT_FALSE(open_bridge("cyclonedds", {.domain = -1, .largest_bytes = 1}));
}

}  // namespace
}  // namespace xauto::transport
