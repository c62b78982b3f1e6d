// SPDX-License-Identifier: Apache-2.0
// One message from a process to another: from before it is published until the reader has it; the
// payload's pages are touched before. Beside the floor: one buffer, one futex. And inside a
// process.
#include <atomic>
#include <memory>
#include <thread>

#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/futex.h"
#include "transport/receiver.h"
#include "transport/shm_topic.h"
#include "transport/topic.h"

#include "bench.h"
#include "pair.h"
#include "peers.h"

namespace xauto::bench {
namespace {

template <std::size_t Bytes>
struct Payload {
  std::byte bytes[Bytes];
};

struct OneDoorbell final : transport::Ringer {
  explicit OneDoorbell(transport::Doorbell& d) : doorbell(d) {}
  void ring(std::uint32_t) override { doorbell.ring(); }
  transport::Doorbell& doorbell;
};

template <std::size_t Bytes>
void size(const Options& options, Table& table, const std::string& name) {
  using Message = Payload<Bytes>;
  const std::uint64_t rounds = std::min<std::uint64_t>(options.rounds, 500);
  auto* shared = static_cast<Shared*>(
      mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  const auto reset = [&] { new (shared) Shared; };

  {  // the floor
    reset();
    volatile std::uint64_t sink = 0;
    auto* buffer = static_cast<std::byte*>(
        mmap(nullptr, Bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
    auto floor = measure(
        options, *shared, rounds,
        [&](std::uint32_t k) {
          std::fill(buffer, buffer + Bytes, static_cast<std::byte>(k));
          const std::int64_t start = now_ns();
          shared->word.store(k + 1);
          futex_wake(shared->word, 1);
          return start;
        },
        [&] {
          return [&, seen = std::uint32_t{0}]() mutable {
            if (shared->word.load() == seen) futex_wait(shared->word, seen);
            if (shared->word.load() == seen) return false;
            seen = shared->word.load();
            sink = sink + touch(buffer, Bytes);
            shared->arrived.store(now_ns());
            return true;
          };
        });
    table.add("transfer", name + " between processes", "own-shm-futex", floor);
    munmap(buffer, Bytes);
  }
  {
    reset();
    detail::TopicSpec spec = *detail::make_topic("t", typeid(Message));
    detail::set_plain_bytes(spec, sizeof(Message));  // apps have Buffers for the largest of them
    const auto fds = transport::make_topic({Bytes, 1, 8, 8});
    OneDoorbell ringer(shared->doorbell);
    const auto publisher =
        *transport::ShmPublisher::open(spec, fds->control.get(), fds->data.get(), &ringer);
    volatile std::uint64_t sink = 0;
    auto ours = measure(
        options, *shared, rounds,
        [&](std::uint32_t k) {
          auto room = publisher->loan(Bytes);
          auto* bytes = static_cast<std::byte*>(room.get());
          std::fill(bytes, bytes + Bytes, static_cast<std::byte>(k));
          const std::int64_t start = now_ns();
          publisher->publish({std::move(room), start, k});
          return start;
        },
        [&] {
          auto subscriber =
              *transport::ShmSubscriber::open(spec, fds->control.get(), fds->data.get(), 0);
          return [&, subscriber] {
            shared->doorbell.wait([&] { return subscriber->empty(); });
            const auto envelope = subscriber->take();
            if (!envelope) return false;
            sink = sink + touch(static_cast<const std::byte*>(envelope->message.get()), Bytes);
            shared->arrived.store(now_ns());
            return true;
          };
        });
    table.add("transfer", name + " between processes", "xauto", ours);
  }
  {  // as a buffer of a pool, whose descriptor passed once
    reset();
    const detail::TopicSpec spec = *detail::topic_spec(Topic<Buffered<std::uint64_t>>("t"));
    const auto link = *transport::make_link({transport::chunk_bytes_of(spec), 1, 8, 8, true});
    OneDoorbell ringer(shared->doorbell);
    const auto publisher = *link->publisher(spec, &ringer);
    const auto pool = *BufferPool::make(10, Bytes);
    volatile std::uint64_t sink = 0;
    auto ours = measure(
        options, *shared, rounds,
        [&](std::uint32_t k) {
          auto message = std::make_shared<Buffered<std::uint64_t>>();
          message->buffer = pool.acquire().value();
          {
            const auto to = message->buffer.write();
            std::fill(to->bytes().begin(), to->bytes().end(), static_cast<std::byte>(k));
          }
          const std::int64_t start = now_ns();
          publisher->publish({std::move(message), start, k});
          return start;
        },
        [&] {
          auto subscriber = *link->subscriber(spec, 0);
          return [&, subscriber] {
            shared->doorbell.wait([&] { return subscriber->empty(); });
            const auto envelope = subscriber->take();
            if (!envelope) return false;
            const auto* frame =
                static_cast<const Buffered<std::uint64_t>*>(envelope->message.get());
            sink = sink + touch(frame->buffer.read()->bytes().data(), Bytes);
            shared->arrived.store(now_ns());
            return true;
          };
        });
    table.add("transfer", name + " between processes", "xauto-buffer", ours);
  }
  for (const Peer& peer : peers())
    if (peer.transfer != nullptr)
      add_peer(table, "transfer", name + " between processes", peer.name,
               [&] { return peer.transfer(options, Bytes, rounds); });
  {  // inside: a pointer, to the subscriber's callback
    transport::Channel channel;
    std::int64_t arrived = 0;
    volatile std::uint64_t sink = 0;
    channel.subscribe([&](const detail::Envelope& envelope) {
      sink = sink + touch(static_cast<const std::byte*>(envelope.message.get()), Bytes);
      arrived = now_ns();
    });
    Samples inside;
    auto message = std::shared_ptr<Message>(new Message);
    for (std::uint64_t k = 0; k < rounds; ++k) {
      std::fill(message->bytes, message->bytes + Bytes, static_cast<std::byte>(k));
      const std::int64_t start = now_ns();
      channel.publish({message, start, k});
      inside.add(arrived - start);
    }
    table.add("transfer", name + " inside", "xauto", inside);
  }
  munmap(shared, sizeof(Shared));
}

}  // namespace

void images(const Options& options, Table& table) {
#ifdef XAUTO_BENCH_CYCLONE
  // In turns: whatever else the machine does is in both.
  constexpr std::size_t kBytes = std::size_t{6} << 20;
  constexpr int kTurns = 5;
  const std::uint64_t rounds = std::min<std::uint64_t>(options.rounds, 500) / kTurns;
  Samples own, ours;
  const auto turn = [&](Samples& into, const char* what, auto transfer) {
    const Samples more = in_process(what, [&] { return transfer(options, kBytes, rounds); });
    for (const std::int64_t ns : more.ns()) into.add(ns);
  };
  for (int i = 0; i < kTurns; ++i) {
    turn(own, "image of Cyclone's own type", cyclone_image);
    turn(ours, "image over DDS", native_image);
  }
  table.add("image", "6 MB image over DDS", "cyclone-own-type", own);
  table.add("image", "6 MB image over DDS", "xauto", ours);
#else
  (void)options, (void)table;
#endif
}

void transfers(const Options& options, Table& table) {
  size<1024>(options, table, "1 KB");
  size<std::size_t{1} << 20>(options, table, "1 MB");
  size<std::size_t{6} << 20>(options, table, "6 MB");
  images(options, table);
}

}  // namespace xauto::bench
