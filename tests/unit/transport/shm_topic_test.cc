// SPDX-License-Identifier: Apache-2.0
// Topics between processes: order, loss, sharing, death; publisher and readers map the memory
// separately, as processes do.
#include "transport/shm_topic.h"

#include <array>
#include <atomic>
#include <random>
#include <thread>

#include <gtest/gtest.h>

#include "base/memory_file.h"
#include "transport/receiver.h"

#include "../no_more_threads.h"

namespace xauto::transport {
namespace {

struct Frame {
  std::array<std::uint64_t, 64> words;
};

Frame frame(std::uint64_t k) {
  Frame f;
  f.words.fill(k);
  return f;
}

struct World {
  explicit World(std::uint32_t subscribers = 1, std::uint32_t depth = 4, std::uint32_t keep = 3)
      : shape{sizeof(Frame), subscribers, depth, keep} {
    auto made = make_topic(shape);
    EXPECT_TRUE(made) << made.error().to_string();
    fds = std::move(*made);
    publisher = open_publisher();
    for (std::uint32_t s = 0; s < subscribers; ++s) readers.push_back(open_reader(s));
  }
  std::shared_ptr<ShmPublisher> open_publisher() {
    auto opened = ShmPublisher::open(spec, fds.control.get(), fds.data.get(), nullptr);
    EXPECT_TRUE(opened) << opened.error().to_string();
    return *opened;
  }
  std::shared_ptr<ShmSubscriber> open_reader(std::uint32_t index) {
    const auto fd = read_only(fds.data.get());
    EXPECT_TRUE(fd);
    auto opened = ShmSubscriber::open(spec, fds.control.get(), fd->get(), index);
    EXPECT_TRUE(opened) << opened.error().to_string();
    return *opened;
  }
  void publish(std::uint64_t k) {
    auto message = detail::make_message<Frame>(publisher.get(), [&] { return frame(k); });
    publisher->publish({std::move(message), static_cast<std::int64_t>(1000 + k), k});
  }
  std::uint64_t held() {
    auto control = *TopicControl::map(fds.control.get());
    std::uint64_t count = 0;
    for (std::uint32_t c = 0; c < control->chunks(); ++c) count += control->held(c).load() != 0;
    return count;
  }

  TopicShape shape;
  detail::TopicSpec spec = *detail::topic_spec(Topic<Frame>("frames"));
  TopicFds fds;
  std::shared_ptr<ShmPublisher> publisher;
  std::vector<std::shared_ptr<ShmSubscriber>> readers;
};

std::uint64_t number(const detail::Envelope& envelope) {
  return static_cast<const Frame*>(envelope.message.get())->words[63];
}

TEST(ShmTopic, MessageArrivesWholeWithItsStamps) {
  World world;
  world.publish(7);
  const auto envelope = world.readers[0]->take();
  ASSERT_TRUE(envelope && envelope->message);
  EXPECT_EQ(number(*envelope), 7u);
  EXPECT_EQ(envelope->sequence, 7u);
  EXPECT_EQ(envelope->origin_ns, 1007);
  EXPECT_FALSE(world.readers[0]->take());
}

TEST(ShmTopic, OriginsBySourceTravelWithTheirMessageOnly) {
  World world;
  detail::Origins origins{};
  for (std::size_t i = 0; i < origins.size(); ++i) origins[i] = static_cast<std::int64_t>(100 + i);
  for (std::uint64_t k = 0; k < 2 * world.shape.depth; ++k) {  // every slot is used for both
    const bool with = (k + k / world.shape.depth) % 2 == 0;
    world.publisher->publish({std::make_shared<const Frame>(frame(k)), 0, k,
                              with ? std::make_shared<const detail::Origins>(origins) : nullptr,
                              k % 3 == 0});
    const auto envelope = world.readers[0]->take();
    ASSERT_TRUE(envelope);
    ASSERT_EQ(envelope->origins != nullptr, with);
    EXPECT_EQ(envelope->urgent, k % 3 == 0);
    if (with) {
      EXPECT_EQ(*envelope->origins, origins);
    }
  }
}

TEST(ShmTopic, AMessageMadeInALoanedChunkIsNotCopied) {
  World world;
  auto message = detail::make_message<Frame>(world.publisher.get(), [] { return frame(1); });
  auto* made = const_cast<Frame*>(static_cast<const Frame*>(message.get()));
  world.publisher->publish({message, 0, 0});
  made->words[63] = 42;  // seen by the reader: it is the same memory
  EXPECT_EQ(number(*world.readers[0]->take()), 42u);
}

TEST(ShmTopic, AMessageOnTheHeapIsCopied) {
  World world;
  world.publisher->publish({std::make_shared<const Frame>(frame(5)), 0, 0});
  EXPECT_EQ(number(*world.readers[0]->take()), 5u);
}

TEST(ShmTopic, TombstonesTravelWithoutAChunk) {
  World world;
  world.publisher->publish({nullptr, 0, 9});
  const auto envelope = world.readers[0]->take();
  ASSERT_TRUE(envelope);
  EXPECT_EQ(envelope->message, nullptr);
  EXPECT_EQ(envelope->sequence, 9u);
}

TEST(ShmTopic, SlowReaderLosesTheOldestAndNobodyElseDoes) {
  World world(2, 4);
  for (std::uint64_t k = 0; k < 10; ++k) {
    world.publish(k);
    EXPECT_EQ(number(*world.readers[1]->take()), k);
  }
  for (std::uint64_t k = 6; k < 10; ++k) EXPECT_EQ(number(*world.readers[0]->take()), k);
  EXPECT_FALSE(world.readers[0]->take());
  EXPECT_EQ(world.readers[0]->lost(), 6u);
  EXPECT_EQ(world.readers[1]->lost(), 0u);
}

TEST(ShmTopic, ReaderThatKeepsTooManyGetsTombstonesAndTheOthersEverything) {
  World world(2, 4, 3);
  std::vector<detail::Envelope> kept;
  std::uint64_t messages = 0;
  for (std::uint64_t k = 0; k < 50; ++k) {
    world.publish(k);
    kept.push_back(*world.readers[0]->take());
    messages += kept.back().message != nullptr ? 1 : 0;
    EXPECT_EQ(number(*world.readers[1]->take()), k);
  }
  EXPECT_EQ(messages, 3u);
  EXPECT_EQ(number(kept[2]), 2u);  // and what it keeps is not written again
  kept.clear();
  world.publish(50);
  EXPECT_EQ(number(*world.readers[0]->take()), 50u);
}

TEST(ShmTopic, PublisherThatKeepsItsMessagesMakesFurtherOnesOnTheHeap) {
  World world(1, 4, 2);
  std::vector<std::shared_ptr<const void>> kept;
  for (std::uint64_t k = 0; k < 20; ++k) {
    kept.push_back(detail::make_message<Frame>(world.publisher.get(), [&] { return frame(k); }));
    world.publisher->publish({kept.back(), 0, k});
    EXPECT_EQ(number(*world.readers[0]->take()), k);
  }
}

TEST(ShmTopic, DeadReadersMessagesAreReclaimedAndItsSuccessorGoesOn) {
  World world;
  world.publish(0);
  world.publish(1);
  auto* leaked = new detail::Envelope(*world.readers[0]->take());  // killed while it reads
  EXPECT_EQ(world.held(), 1u);
  (*TopicControl::map(world.fds.control.get()))->release_all(0);
  EXPECT_EQ(world.held(), 0u);
  EXPECT_EQ(number(*world.open_reader(0)->take()), 1u);
  delete leaked;
}

TEST(ShmTopic, SuccessorOfADeadPublisherGoesOn) {
  World world;
  world.publish(0);
  // Killed after its slot and before its tail.
  auto control = *TopicControl::map(world.fds.control.get());
  world.publish(1);
  control->queue(0).tail.store(1);
  world.publisher = world.open_publisher();
  world.publish(2);
  for (std::uint64_t k = 0; k < 3; ++k) EXPECT_EQ(number(*world.readers[0]->take()), k);
}

TEST(ShmTopic, EncodedMessagesAndOversizeOnes) {
  detail::TopicSpec spec = *detail::topic_spec(Topic<std::string>("text"));
  auto fds = make_topic({16, 1, 4, 2});
  ASSERT_TRUE(fds);
  auto publisher = *ShmPublisher::open(spec, fds->control.get(), fds->data.get(), nullptr);
  auto reader = *ShmSubscriber::open(spec, fds->control.get(), fds->data.get(), 0);
  publisher->publish({std::make_shared<const std::string>("hello"), 0, 0});
  publisher->publish({std::make_shared<const std::string>(17, 'x'), 0, 1});
  EXPECT_EQ(*static_cast<const std::string*>(reader->take()->message.get()), "hello");
  EXPECT_EQ(reader->take()->message, nullptr);
  EXPECT_EQ(publisher->unsent(), 1u);
}

TEST(ShmTopic, ReadersCannotWriteMessages) {
  World world;
  const auto fd = read_only(world.fds.data.get());
  ASSERT_TRUE(fd);
  EXPECT_FALSE(ShmPublisher::open(world.spec, world.fds.control.get(), fd->get(), nullptr));
}

TEST(ShmTopic, RefusesMemoryThatIsNoTopic) {
  World world;
  auto other = make_topic({sizeof(Frame), 2, 4, 3});
  ASSERT_TRUE(other);
  EXPECT_FALSE(TopicControl::map(world.fds.data.get()));
  EXPECT_FALSE(ShmSubscriber::open(world.spec, world.fds.control.get(), world.fds.data.get(), 1));
  EXPECT_FALSE(ShmPublisher::open(world.spec, other->control.get(), world.fds.data.get(), nullptr));
  EXPECT_FALSE(make_topic({0, 0, 4, 3}));
  EXPECT_FALSE(make_topic({0, 65, 4, 3}));
  EXPECT_FALSE(make_topic({0, 1, 0, 3}));
  EXPECT_FALSE(make_topic({kMaxChunkBytes + 1, 1, 4, 3}));
}

TEST(ShmTopic, HostileWordsNeitherCrashNorHangTheOthers) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 200; ++round) {
    World world(2, 4, 3);
    auto control = *TopicControl::map(world.fds.control.get());
    auto* first = reinterpret_cast<std::atomic<std::uint64_t>*>(&control->header());
    auto* last = &control->held(control->chunks() - 1);
    const auto words = static_cast<std::size_t>(last - first) + 1;
    for (std::uint64_t k = 0; k < 50; ++k) {
      for (int i = 0; i < 4; ++i)
        first[random() % words].store(random() % 3 == 0 ? random() : random() % 64);
      world.publish(k);
      for (const auto& reader : world.readers) {
        for (int taken = 0; taken < 8; ++taken) {
          const auto envelope = reader->take();
          if (!envelope) break;
          if (envelope->message != nullptr) (void)number(*envelope);  // inside the mapping
        }
      }
    }
  }
}

TEST(Receiver, WhereThreadsEndItSaysSo) {
  Doorbell bell;
  Receiver receiver(bell);
  const NoMoreThreads none;
  const Status started = receiver.start([] {});
  ASSERT_FALSE(started);
  EXPECT_EQ(started.error().what.find("no more threads: "), 0u) << started.error().what;
}

TEST(ShmTopic, UnderLoadEveryMessageIsReadWholeInOrderOrCountedAsLost) {
  constexpr std::uint64_t kMessages = 20'000;
  World world(3, 4, 3);
  std::vector<Doorbell> bells(3);
  struct All : Ringer {
    explicit All(std::vector<Doorbell>& b) : bells(b) {}
    void ring(std::uint32_t s) override { bells[s].ring(); }
    std::vector<Doorbell>& bells;
  } ringer(bells);
  world.publisher =
      *ShmPublisher::open(world.spec, world.fds.control.get(), world.fds.data.get(), &ringer);
  std::vector<std::unique_ptr<Receiver>> receivers;
  std::array<std::atomic<std::uint64_t>, 3> got{}, torn{}, next{};
  for (std::size_t s = 0; s < 3; ++s) {
    receivers.push_back(std::make_unique<Receiver>(bells[s]));
    receivers[s]->add(0, world.readers[s], s == 2, [&, s](const detail::Envelope& e) {
      if (e.sequence < next[s].load()) ++torn[s];
      next[s].store(e.sequence + 1);
      ++got[s];
      if (e.message == nullptr) return;
      const auto& f = *static_cast<const Frame*>(e.message.get());
      for (const std::uint64_t word : f.words) torn[s] += word != e.sequence ? 1 : 0;
      if (s == 1 && e.sequence % 64 == 0) std::this_thread::yield();
    });
    ASSERT_TRUE(receivers[s]->start([] {}));
  }
  for (std::uint64_t k = 0; k < kMessages; ++k) world.publish(k);
  for (std::size_t s = 0; s < 3; ++s) {
    while (next[s].load() < kMessages) std::this_thread::yield();  // the last one is never lost
    receivers[s]->stop();
    EXPECT_EQ(got[s].load() + receivers[s]->lost(), kMessages) << s;
    EXPECT_EQ(torn[s].load(), 0u) << s;
  }
  EXPECT_EQ(world.held(), 0u);
}

TEST(ShmTopic, LinkIsJoinedWithWhatItInvitesWith) {
  const auto spec = *detail::topic_spec(Topic<Frame>("t"));
  auto here = *make_link({sizeof(Frame), 1, 4, 3});
  auto there = *join_link(*here->invite(0));
  const auto publisher = *here->publisher(spec, nullptr);
  const auto reader = *there->subscriber(spec, 0);
  publisher->sender()(
      {detail::make_message<Frame>(publisher.get(), [] { return frame(5); }), 1, 0});
  const auto envelope = reader->take();
  ASSERT_TRUE(envelope && envelope->message);
  EXPECT_EQ(static_cast<const Frame*>(envelope->message.get())->words[3], 5u);
  // Who is only invited to read cannot write.
  EXPECT_FALSE(there->publisher(spec, nullptr));
  EXPECT_FALSE(join_link({}));
}

}  // namespace
}  // namespace xauto::transport
