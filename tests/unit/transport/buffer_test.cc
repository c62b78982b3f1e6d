// SPDX-License-Identifier: Apache-2.0
// Messages with buffers between processes: what arrives is the same memory, told once; who dies, keeps, has no descriptor left or
// lies hurts nobody else. Publisher and readers have descriptors of their own, as processes do.
#include <algorithm>
#include <atomic>
#include <cstring>
#include <thread>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/memory_file.h"
#include "base/socket.h"
#include "transport/buffer_passing.h"
#include "transport/shm_topic.h"

#include "tests/open_descriptors.h"

namespace xauto::transport {
namespace {

struct NumberInfo {
  std::uint64_t number;
};
using BufferFrame = Buffered<NumberInfo>;

/// Which memory it is, by the kernel's word: of two descriptors of one memfd it is the same.
std::pair<dev_t, ino_t> which_memory(int fd) {
  struct stat status {};
  EXPECT_EQ(fstat(fd, &status), 0);
  return {status.st_dev, status.st_ino};
}

void put_value(const Buffer& buffer, std::uint64_t value) {
  const auto to = buffer.write();
  ASSERT_TRUE(to) << to.error().to_string();
  std::memcpy(to->bytes().data(), &value, sizeof value);
}

std::uint64_t value_in(const Buffer& buffer) {
  const auto from = buffer.read();
  EXPECT_TRUE(from) << from.error().to_string();
  std::uint64_t value = 0;
  std::memcpy(&value, from->bytes().data(), sizeof value);
  return value;
}

struct BufferWorld {
  explicit BufferWorld(std::uint32_t subscribers = 1, std::uint32_t depth = 4,
                       std::uint32_t keep = 3)
      : link(*make_link({chunk_bytes_of(spec), subscribers, depth, keep, true})) {
    publisher = open_publisher();
    for (std::uint32_t s = 0; s < subscribers; ++s) readers.push_back(open_reader(s));
  }
  std::shared_ptr<Publisher> open_publisher() {
    auto there = join_link(*link->invite(-1));
    auto opened = (*there)->publisher(spec, nullptr);
    EXPECT_TRUE(opened) << opened.error().to_string();
    return *opened;
  }
  std::shared_ptr<Subscriber> open_reader(std::uint32_t s) {
    auto there = join_link(*link->invite(static_cast<int>(s)));
    auto opened = (*there)->subscriber(spec, s);
    EXPECT_TRUE(opened) << opened.error().to_string();
    return *opened;
  }
  void publish(std::uint64_t k, Buffer buffer) {
    auto message = std::make_shared<BufferFrame>();
    message->info.number = k;
    message->buffer = std::move(buffer);
    publisher->publish({std::move(message), 0, k});
  }
  std::shared_ptr<const BufferFrame> take(std::size_t reader = 0) {
    const auto envelope = readers[reader]->take();
    if (!envelope) return nullptr;
    return std::static_pointer_cast<const BufferFrame>(envelope->message);
  }

  detail::TopicSpec spec = *detail::topic_spec(Topic<BufferFrame>("frames"));
  std::unique_ptr<Link> link;
  std::shared_ptr<Publisher> publisher;
  std::vector<std::shared_ptr<Subscriber>> readers;
};

TEST(Buffer, IsSealedMemoryOfItsSize) {
  const auto buffer = Buffer::memory(6'000'000);
  ASSERT_TRUE(buffer);
  EXPECT_EQ(buffer->size(), 6'000'000u);
  EXPECT_FALSE(buffer->is_dmabuf());
  EXPECT_NE(ftruncate(buffer->fd(), 1), 0);
  EXPECT_NE(ftruncate(buffer->fd(), 7'000'000), 0);
  put_value(*buffer, 42);
  EXPECT_EQ(value_in(Buffer(*buffer)), 42u);
  EXPECT_FALSE(Buffer::memory(0));
  EXPECT_FALSE(Buffer::memory(kMaxBufferBytes + 1));
}

TEST(Buffer, NoneHasNothing) {
  const Buffer none;
  EXPECT_FALSE(none);
  EXPECT_EQ(none.fd(), -1);
  EXPECT_EQ(none.size(), 0u);
  EXPECT_FALSE(none.read());
  EXPECT_FALSE(none.write());
}

TEST(Buffer, WhatCanShrinkOrIsNoMemoryIsNotAdopted) {
  const auto refused = [](int fd) {
    const auto adopted = Buffer::adopt(fd);
    EXPECT_FALSE(adopted);
    return adopted ? std::string() : adopted.error().what;
  };
  const UniqueFd unsealed(memfd_create("test", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(ftruncate(unsealed.get(), 4096), 0);
  EXPECT_NE(refused(unsealed.get()).find("may shrink"), std::string::npos);
  ASSERT_EQ(fcntl(unsealed.get(), F_ADD_SEALS, F_SEAL_GROW), 0);
  EXPECT_NE(refused(unsealed.get()).find("may shrink"), std::string::npos);
  ASSERT_EQ(fcntl(unsealed.get(), F_ADD_SEALS, F_SEAL_SHRINK), 0);
  const auto adopted = Buffer::adopt(unsealed.get());
  ASSERT_TRUE(adopted) << adopted.error().to_string();
  EXPECT_NE(adopted->fd(), unsealed.get());
  EXPECT_EQ(which_memory(adopted->fd()), which_memory(unsealed.get()));

  const UniqueFd empty(memfd_create("test", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(fcntl(empty.get(), F_ADD_SEALS, F_SEAL_SHRINK), 0);
  EXPECT_NE(refused(empty.get()).find("0 bytes"), std::string::npos);
  const UniqueFd file(open("/proc/self/exe", O_RDONLY | O_CLOEXEC));
  EXPECT_NE(refused(file.get()).find("neither a dmabuf nor a memfd"), std::string::npos);
  const UniqueFd device(open("/dev/zero", O_RDWR | O_CLOEXEC));
  EXPECT_NE(refused(device.get()).find("neither a dmabuf nor a memfd"), std::string::npos);
  refused(-1);
  refused(1 << 20);
}

TEST(Buffer, OneOpenedToBeReadIsNotWritten) {
  const auto buffer = *Buffer::memory(4096);
  put_value(buffer, 5);
  const UniqueFd fd = *read_only(buffer.fd());
  const auto adopted = *Buffer::adopt(fd.get());
  EXPECT_EQ(value_in(adopted), 5u);
  const auto write = adopted.write();
  ASSERT_FALSE(write);
  EXPECT_EQ(write.error().code, ErrorCode::kPermission);
}

TEST(BufferPool, GivesEachBufferOnceUntilItsLastHandleIsGone) {
  const auto pool = *BufferPool::make(2, 4096);
  auto first = pool.acquire();
  auto second = pool.acquire();
  ASSERT_TRUE(first && second);
  EXPECT_NE(which_memory(first->fd()), which_memory(second->fd()));
  EXPECT_EQ(pool.index_of(*first), 0u);
  EXPECT_EQ(pool.index_of(*second), 1u);
  EXPECT_FALSE(pool.index_of(*Buffer::memory(1)));
  EXPECT_FALSE(pool.acquire());
  auto copy = std::optional<Buffer>(*first);
  first.reset();
  EXPECT_FALSE(pool.acquire());
  copy.reset();
  const auto again = pool.acquire();
  ASSERT_TRUE(again);
  EXPECT_EQ(pool.index_of(*again), 0u);
  EXPECT_FALSE(BufferPool::make(0, 4096));
  EXPECT_FALSE(BufferPool::make(65, 4096));
  EXPECT_FALSE(BufferPool::of({Buffer()}));
}

TEST(BufferTopic, TheReaderHasTheSameMemoryAndCannotWriteIt) {
  BufferWorld world;
  const Buffer buffer = *Buffer::memory(1 << 20);
  put_value(buffer, 1);
  world.publish(7, buffer);
  const auto frame = world.take();
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->info.number, 7u);
  EXPECT_EQ(frame->buffer.size(), buffer.size());
  EXPECT_NE(frame->buffer.fd(), buffer.fd());
  EXPECT_EQ(which_memory(frame->buffer.fd()), which_memory(buffer.fd()));
  EXPECT_EQ(value_in(frame->buffer), 1u);
  put_value(buffer, 2);
  EXPECT_EQ(value_in(frame->buffer), 2u) << "it was copied";
  EXPECT_FALSE(frame->buffer.write());
  EXPECT_EQ(mmap(nullptr, 4096, PROT_WRITE, MAP_SHARED, frame->buffer.fd(), 0), MAP_FAILED);
  EXPECT_FALSE(world.take());
}

TEST(BufferTopic, AMessageWithoutABufferArrives) {
  BufferWorld world;
  world.publish(3, Buffer());
  const auto frame = world.take();
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->info.number, 3u);
  EXPECT_FALSE(frame->buffer);
}

TEST(BufferTopic, ADescriptorPassesOncePerReader) {
  BufferWorld world(2);
  const auto pool = *BufferPool::make(3, 4096);
  const auto round = [&](std::uint64_t k) {
    auto buffer = pool.acquire();
    ASSERT_TRUE(buffer) << k;
    put_value(*buffer, k);
    world.publish(k, std::move(*buffer));
    for (const std::size_t reader : {0, 1}) {
      const auto frame = world.take(reader);
      ASSERT_TRUE(frame) << k;
      EXPECT_EQ(value_in(frame->buffer), k);
    }
  };
  for (std::uint64_t k = 0; k < 6; ++k) round(k);
  const std::size_t before = open_descriptors();
  for (std::uint64_t k = 6; k < 1000; ++k) round(k);
  EXPECT_EQ(open_descriptors(), before);
}

TEST(BufferTopic, ABufferIsFreeWhenItsLastReaderIsThroughOrDead) {
  BufferWorld world(2);
  const auto pool = *BufferPool::make(1, 4096);
  world.publish(0, *pool.acquire());
  EXPECT_FALSE(pool.acquire()) << "it waits for both";
  auto first = world.take(0);
  ASSERT_TRUE(first);
  const auto kept = std::make_unique<Buffer>(first->buffer);  // the buffer without its message
  first.reset();
  auto second = world.take(1);
  ASSERT_TRUE(second);
  second.reset();
  EXPECT_FALSE(pool.acquire()) << "reader 0 has it";
  world.link->release_all(0);  // ... and dies
  const auto free = pool.acquire();
  ASSERT_TRUE(free);
  EXPECT_EQ(pool.index_of(*free), 0u);
}

TEST(BufferTopic, AMessageThatIsOverwrittenGivesItsBufferBack) {
  BufferWorld world(1, 2);
  const auto pool = *BufferPool::make(4, 4096);
  for (std::uint64_t k = 0; k < 20; ++k) {
    auto buffer = pool.acquire();
    ASSERT_TRUE(buffer) << k;
    put_value(*buffer, k);
    world.publish(k, std::move(*buffer));
  }
  for (std::uint64_t k = 18; k < 20; ++k) {
    const auto frame = world.take();
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->info.number, k);
    EXPECT_EQ(value_in(frame->buffer), k);
  }
}

TEST(BufferTopic, AReaderThatKeepsThemAllGetsNoMoreAndTheOtherDoes) {
  BufferWorld world(2, 4, 2);
  const auto pool = *BufferPool::make(8, 4096);
  std::vector<std::shared_ptr<const BufferFrame>> kept;
  for (std::uint64_t k = 0; k < 10; ++k) {
    auto buffer = pool.acquire();
    ASSERT_TRUE(buffer) << k;
    world.publish(k, std::move(*buffer));
    if (auto frame = world.take(0)) kept.push_back(std::move(frame));
    ASSERT_TRUE(world.take(1)) << k;
  }
  EXPECT_EQ(kept.size(), 2u);
}

TEST(BufferTopic, AReaderThatIsStartedAgainIsToldAgain) {
  BufferWorld world;
  const Buffer buffer = *Buffer::memory(4096);
  world.publish(0, buffer);
  ASSERT_TRUE(world.take());
  world.readers[0].reset();
  world.link->release_all(0);
  world.publish(1, buffer);  // while it is dead: told to its predecessor
  world.readers[0] = world.open_reader(0);
  EXPECT_FALSE(world.take()) << "nobody can know what its number means";
  EXPECT_EQ(world.readers[0]->lost(), 1u);
  for (std::uint64_t k = 2; k < 10; ++k) {
    world.publish(k, buffer);
    const auto frame = world.take();
    ASSERT_TRUE(frame) << k;
    EXPECT_EQ(which_memory(frame->buffer.fd()), which_memory(buffer.fd()));
  }
}

TEST(BufferTopic, APublisherThatIsStartedAgainHasBuffersOfItsOwn) {
  BufferWorld world;
  const std::size_t before = open_descriptors();
  for (std::uint64_t death = 0; death < 200; ++death) {
    const Buffer old = *Buffer::memory(4096), fresh = *Buffer::memory(4096);
    put_value(old, 2 * death);
    put_value(fresh, 2 * death + 1);
    world.publish(2 * death, old);
    world.publisher.reset();
    world.publisher = world.open_publisher();
    world.publish(2 * death + 1, fresh);
    for (const std::uint64_t k : {2 * death, 2 * death + 1}) {  // what the dead one left, too
      const auto frame = world.take();
      ASSERT_TRUE(frame) << k;
      EXPECT_EQ(frame->info.number, k);
      EXPECT_EQ(value_in(frame->buffer), k);
    }
  }
  EXPECT_LE(open_descriptors(), before + 2) << "those of dead publishers are kept";
}

TEST(BufferTopic, BuffersThatAreGoneAreForgotten) {
  BufferWorld world;
  const std::size_t before = open_descriptors();
  for (std::uint64_t k = 0; k < 1000; ++k) {  // a new one each time: slow, not wrong
    const Buffer buffer = *Buffer::memory(4096);
    put_value(buffer, k);
    world.publish(k, buffer);
    const auto frame = world.take();
    ASSERT_TRUE(frame) << k;
    EXPECT_EQ(value_in(frame->buffer), k);
  }
  EXPECT_LE(open_descriptors(), before + 4);
}

TEST(BufferTopic, AReaderThatNeverLooksFillsItsOwnSocketOnly) {
  BufferWorld world(2, 2, 3);
  for (std::uint64_t k = 0; k < 2000; ++k) {
    const Buffer buffer = *Buffer::memory(4096);
    put_value(buffer, k);
    world.publish(k, buffer);
    const auto frame = world.take(1);
    ASSERT_TRUE(frame) << k;
    EXPECT_EQ(value_in(frame->buffer), k);
  }
  const Buffer buffer = *Buffer::memory(4096);  // reader 0 looks again
  for (std::uint64_t k = 2000; k < 2010; ++k) {
    put_value(buffer, k);
    world.publish(k, buffer);
    ASSERT_TRUE(world.take(1)) << k;
    while (world.readers[0]->take()) {
    }
  }
  world.publish(2010, buffer);
  const auto frame = world.take(0);
  ASSERT_TRUE(frame) << "it lives again";
  EXPECT_EQ(frame->info.number, 2010u);
  EXPECT_EQ(which_memory(frame->buffer.fd()), which_memory(buffer.fd()));
}

TEST(BufferTopic, AReaderThatNeverLooksDoesNotKeepGoneBuffersKnown) {
  BufferWorld world(2, 2, 3);
  std::uint64_t k = 0;
  for (int set = 0; set < 20; ++set) {  // a camera that is opened again and again
    std::vector<Buffer> buffers;
    for (std::size_t i = 0; i < kMaxKnownBuffers; ++i) {
      buffers.push_back(*Buffer::memory(4096));
      world.publish(k++, buffers.back());
      ASSERT_TRUE(world.take(1)) << set << " " << i;
    }
    buffers.clear();
    world.publish(k++, Buffer());  // two that the other's queue keeps
    world.publish(k++, Buffer());
    ASSERT_TRUE(world.take(1));
    ASSERT_TRUE(world.take(1));
  }
  EXPECT_EQ(world.publisher->unsent(), 0u);
  const Buffer buffer = *Buffer::memory(4096);
  std::shared_ptr<const BufferFrame> frame;
  for (int tries = 0; tries < 10 && (frame == nullptr || !frame->buffer); ++tries) {
    world.publish(k++, buffer);
    while (!world.readers[0]->empty()) frame = world.take(0);
  }
  ASSERT_TRUE(frame && frame->buffer) << "it lives again when it looks";
  EXPECT_EQ(which_memory(frame->buffer.fd()), which_memory(buffer.fd()));
}

TEST(BufferTopic, MoreBuffersThanAreKnownAtATimeLoseMessagesNotTheTopic) {
  BufferWorld world;
  std::vector<Buffer> buffers;
  for (std::uint64_t k = 0; k <= kMaxKnownBuffers; ++k) {
    buffers.push_back(*Buffer::memory(4096));
    world.publish(k, buffers.back());
    EXPECT_EQ(world.take() != nullptr, k < kMaxKnownBuffers) << k;
  }
  EXPECT_EQ(world.publisher->unsent(), 1u);
  buffers.erase(buffers.begin());
  world.publish(100, buffers.back());
  EXPECT_TRUE(world.take());
}

TEST(BufferTopic, AReaderWithoutDescriptorsLosesMessagesAndRecovers) {
  BufferWorld world;
  const Buffer buffer = *Buffer::memory(4096);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  // The sender needs one descriptor to hand on, and the reader finds no second one.
  std::vector<UniqueFd> filler;
  rlimit few = before;
  few.rlim_cur = std::max<rlim_t>(64, open_descriptors() + 8);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  for (;;) {
    UniqueFd fd(dup(buffer.fd()));
    if (!fd) break;
    filler.push_back(std::move(fd));
  }
  filler.pop_back();
  world.publish(0, buffer);  // the sender's second descriptor is closed again
  filler.emplace_back(dup(buffer.fd()));
  EXPECT_FALSE(world.take());
  filler.clear();
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_EQ(world.readers[0]->lost(), 1u);
  world.publish(1, buffer);
  const auto frame = world.take();
  ASSERT_TRUE(frame) << "told again";
  EXPECT_EQ(frame->info.number, 1u);
}

TEST(BufferTopic, ABufferPassesOnFromReaderToReader) {
  BufferWorld first, second;
  const auto pool = *BufferPool::make(1, 4096);
  auto buffer = pool.acquire();
  put_value(*buffer, 9);
  first.publish(0, std::move(*buffer));
  {
    const auto frame = first.take();
    ASSERT_TRUE(frame);
    second.publish(0, frame->buffer);
  }
  EXPECT_FALSE(pool.acquire()) << "it is on its way to the third";
  {
    const auto frame = second.take();
    ASSERT_TRUE(frame);
    EXPECT_EQ(value_in(frame->buffer), 9u);
    EXPECT_FALSE(pool.acquire());
  }
  EXPECT_FALSE(pool.acquire()) << "the second has not looked yet";
  second.publish(1, Buffer());
  EXPECT_TRUE(pool.acquire());
}

TEST(BufferTopic, NoFrameIsWrittenWhileSomebodyReadsIt) {
  constexpr std::uint64_t kFrames = 3000;
  constexpr std::size_t kWords = 4096;
  BufferWorld world(2, 2, 2);
  const auto pool = *BufferPool::make(5, kWords * sizeof(std::uint64_t));
  std::atomic<bool> end{false};
  std::atomic<std::uint64_t> seen{0}, torn{0};
  const auto read = [&](std::size_t reader) {
    std::shared_ptr<const BufferFrame> kept;  // the one before, too
    while (!end.load() || !world.readers[reader]->empty()) {
      auto frame = world.take(reader);
      if (frame == nullptr) continue;
      for (const auto& f : {frame, kept}) {
        if (f == nullptr) continue;
        const auto from = f->buffer.read();
        for (std::size_t i = 0; i < kWords; ++i) {
          std::uint64_t word;
          std::memcpy(&word, from->bytes().data() + i * sizeof word, sizeof word);
          if (word != f->info.number) torn.fetch_add(1);
        }
      }
      seen.fetch_add(1);
      kept = std::move(frame);
    }
  };
  std::thread first([&] { read(0); }), second([&] { read(1); });
  for (std::uint64_t k = 0; k < kFrames;) {
    auto buffer = pool.acquire();
    if (!buffer) continue;
    {
      const auto to = buffer->write();
      for (std::size_t i = 0; i < kWords; ++i)
        std::memcpy(to->bytes().data() + i * sizeof k, &k, sizeof k);
    }
    world.publish(k++, std::move(*buffer));
  }
  end.store(true);
  first.join();
  second.join();
  EXPECT_EQ(torn.load(), 0u);
  EXPECT_GT(seen.load(), 0u);
}

TEST(BufferTopic, ShapeAndTypeMustAgree) {
  const BufferWorld world;
  const auto plain = *make_link({chunk_bytes_of(world.spec), 1, 4, 3});
  EXPECT_FALSE(plain->publisher(world.spec, nullptr));
  EXPECT_FALSE(plain->subscriber(world.spec, 0));
  const auto numbers = *detail::topic_spec(Topic<std::uint64_t>("numbers"));
  EXPECT_FALSE(world.link->publisher(numbers, nullptr));
  EXPECT_FALSE(world.link->subscriber(numbers, 0));
  EXPECT_FALSE((*join_link(*world.link->invite(-1)))->subscriber(world.spec, 7));
}

// ---- what a publisher that lies may say ---------------------------------------------------------

struct Liar {
  Liar() : ends(*make_buffer_ends()), reader("frames", std::move(ends.reader)) {}
  void say(BufferPacket packet, const std::vector<int>& fds,
           std::size_t bytes = sizeof(BufferPacket)) {
    ASSERT_TRUE(send_packet(ends.publisher.get(), &packet, bytes, fds));
  }
  static BufferPacket known(std::uint64_t number, std::uint64_t size) {
    return {kBufferMagic, static_cast<std::uint32_t>(BufferPacket::Word::kKnown), number, size};
  }
  BufferEnds ends;
  BufferReceiver reader;
};

TEST(BufferReceiver, TakesOnlyWhatIsABufferOfTheSizeItIsSaidToHave) {
  Liar liar;
  const std::size_t before = open_descriptors();
  const Buffer good = *Buffer::memory(4096);
  const UniqueFd unsealed(memfd_create("test", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(ftruncate(unsealed.get(), 4096), 0);
  liar.say(Liar::known(1, 4096), {});
  liar.say(Liar::known(1, 4096), {good.fd(), good.fd()});
  liar.say(Liar::known(1, 4095), {good.fd()});
  liar.say(Liar::known(1, 4096), {unsealed.get()});
  liar.say(Liar::known(1, 4096), {liar.ends.publisher.get()});
  liar.say({0, 1, 1, 4096}, {good.fd()});
  liar.say(Liar::known(0, 4096), {good.fd()});
  liar.say({kBufferMagic, 99, 1, 4096}, {good.fd()});
  liar.say(Liar::known(1, 4096), {good.fd()}, 12);
  EXPECT_EQ(liar.reader.find(1), nullptr);
  EXPECT_EQ(open_descriptors(), before + 2) << "what it refused is closed";
  liar.say(Liar::known(1, 4096), {good.fd()});
  ASSERT_NE(liar.reader.find(1), nullptr);
  EXPECT_FALSE(liar.reader.find(1)->is_writable());
  liar.say(Liar::known(1, 4096), {Buffer::memory(4096)->fd()});  // a number is for one buffer
  liar.reader.drain();
  EXPECT_EQ(which_memory(liar.reader.find(1)->fd()), which_memory(good.fd()));
}

TEST(BufferReceiver, KnowsABoundedNumber) {
  Liar liar;
  const Buffer good = *Buffer::memory(4096);
  for (std::uint64_t k = 1; k <= 2 * kMaxKnownBuffers; ++k)
    liar.say(Liar::known(k, 4096), {good.fd()});
  liar.reader.drain();
  EXPECT_EQ(liar.reader.known(), kMaxKnownBuffers);
  liar.say({kBufferMagic, static_cast<std::uint32_t>(BufferPacket::Word::kAllForgotten), 0, 0}, {});
  liar.reader.drain();
  EXPECT_NE(liar.reader.find(1), nullptr) << "a message of the dead publisher may wait yet";
  liar.say(Liar::known(1000, 4096), {good.fd()});
  ASSERT_NE(liar.reader.find(1000), nullptr);
  EXPECT_EQ(liar.reader.known(), 1u) << "and none does when the first of the next one came";
}

TEST(BufferReceiver, APublisherThatIsGoneIsNoEnd) {
  Liar liar;
  liar.ends.publisher.reset();
  EXPECT_EQ(liar.reader.find(1), nullptr);
}

// ---- records -------------------------------------------------------------------------------------

TEST(BufferedCodec, IsItsInfoThenItsBytes) {
  BufferFrame frame;
  frame.info.number = 0x0102030405060708;
  frame.buffer = *Buffer::memory(16);
  put_value(frame.buffer, 77);
  const auto bytes = Codec<BufferFrame>::encode(frame);
  ASSERT_EQ(bytes.size(), 24u);
  EXPECT_EQ(std::memcmp(bytes.data(), &frame.info, 8), 0);
  const BufferFrame back = Codec<BufferFrame>::decode(bytes);
  EXPECT_EQ(back.info.number, frame.info.number);
  EXPECT_EQ(back.buffer.size(), 16u);
  EXPECT_EQ(value_in(back.buffer), 77u);
  EXPECT_FALSE(Codec<BufferFrame>::decode(std::span(bytes).first(8)).buffer);
  EXPECT_THROW((void)Codec<BufferFrame>::decode(std::span(bytes).first(7)), std::runtime_error);
}

}  // namespace
}  // namespace xauto::transport
