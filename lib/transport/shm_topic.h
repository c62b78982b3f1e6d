// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 1, between processes: one topic in shared memory. Messages lie in chunks of
// fixed size and are read where they were written; what travels is the number of a chunk.
//
//   control memfd (all map it read-write)
//   ┌ Header ┬ queue of subscriber 0 ┬ queue of subscriber 1 ┬ ... ┬ held ┐
//
//   data memfd (the publisher maps it read-write, subscribers read-only)
//   ┌ chunk 0 ┬ chunk 1 ┬ ... ┐
//
// A queue is a ring of slots with one writer and one reader. The publisher never waits: it
// overwrites the oldest slot of a queue that is full (its message is lost for that subscriber only,
// who sees the gap). `held` has a word per chunk with a bit per subscriber who reads it just now:
//
//   publisher: slot.word := 0, fields, slot.word := position + 1, tail := position + 1
//   reader:    reads word and fields, sets its bit in `held`, then CAS(word, -> 0): if that
//              succeeds the message is its own, else the publisher was faster: bit off, look again
//
// A chunk is free when it is in no queue and nobody holds it, and the publisher looks in this order
// (a reader holds before it takes out of the queue), so a chunk in transit is never taken for free.
// No lock is shared. Who dies holds up nobody: a dead reader's bits are cleared by whoever saw its
// end (`release_all`); a dead publisher leaves whole messages, and its successor goes on at `tail`.
// A reader that keeps messages for itself gets no more of them beyond `keep`, and the others are
// not affected: chunks = subscribers * (depth + keep) + own keep + 2.
//
// A message with a Buffer (xauto/buffer.h) has the buffer's number and its other part in the chunk; the descriptors come beside
// (buffer_passing.h). The publisher keeps such a message until its chunk is free: then nobody reads the buffer any more.
//
// Who writes: [P] the publisher, [R] the reader of the queue, [*] both by the protocol above.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"
#include "model/message.h"
#include "transport/buffer_passing.h"
#include "transport/kept_messages.h"
#include "transport/transport.h"

namespace xauto::transport {

inline constexpr std::uint32_t kTopicMagic = 0x58544f50;  // "XTOP"
inline constexpr std::uint32_t kMaxTopicSubscribers = 64;
inline constexpr std::uint32_t kMaxQueueDepth = 256;
inline constexpr std::uint32_t kMaxKeep = 256;
inline constexpr std::uint64_t kMaxChunkBytes = std::uint64_t{1} << 30;

struct TopicShape {
  std::uint64_t chunk_bytes = 0;  ///< largest message, encoded
  std::uint32_t subscribers = 0;  ///< processes that read it
  std::uint32_t depth = 8;        ///< messages that wait for one of them; then the oldest is lost
  std::uint32_t keep = 8;         ///< messages that each of them (and the publisher) may keep
  bool passes_buffers = false;    ///< buffer_passing.h
};
/// Of the largest message.
[[nodiscard]] std::uint64_t chunk_bytes_of(const detail::TopicSpec& spec);

inline constexpr std::uint32_t kHasOrigins = 1;  ///< `origins` belongs to this message
inline constexpr std::uint32_t kIsUrgent = 2;    ///< see detail::Envelope

struct QueuePlace {
  std::atomic<std::uint64_t> word{};  ///< [*] position + 1, or 0: empty
  std::atomic<std::uint64_t> sequence{};
  std::atomic<std::int64_t> origin_ns{};
  std::atomic<std::uint64_t> bytes{};
  std::atomic<std::uint32_t> chunk{};  ///< kNoChunk: a tombstone
  std::atomic<std::uint32_t> rates{};  ///< kHasOrigins, kIsUrgent
  std::uint32_t pad[6] = {};
  std::atomic<std::int64_t> origins[detail::kMaxOrigins] = {};
};
static_assert(sizeof(QueuePlace) == 256);

struct alignas(64) TopicQueue {
  std::atomic<std::uint64_t> tail{};              ///< [P] positions written
  std::atomic<std::uint64_t> dropped{};           ///< [P] overwritten, or refused beyond `keep`
  alignas(64) std::atomic<std::uint64_t> head{};  ///< [R] positions read or lost; for a successor
  std::atomic<std::uint32_t> asks{};              ///< [R] how often to be told of all buffers again
};
static_assert(sizeof(TopicQueue) == 128);

struct alignas(64) TopicHeader {
  std::uint32_t magic = 0;
  std::uint32_t subscribers = 0, depth = 0, keep = 0, chunks = 0;
  std::uint32_t passes_buffers = 0;
  std::uint64_t chunk_bytes = 0;
  std::atomic<std::uint64_t> next_sequence{};  ///< [P] one beyond the last release that went out
  std::atomic<std::uint64_t> buffers{};        ///< [P] told of so far, by all publishers
};
static_assert(sizeof(TopicHeader) == 64);

inline constexpr std::uint32_t kNoChunk = UINT32_MAX;

/// The two memfds of one topic.
struct TopicFds {
  UniqueFd control, data;
};
[[nodiscard]] Result<TopicFds> make_topic(const TopicShape& shape);

/// The mapped control part, checked; shared by publisher, reader and reaper.
class TopicControl {
 public:
  [[nodiscard]] static Result<std::shared_ptr<TopicControl>> map(int control_fd);
  ~TopicControl();
  TopicControl(const TopicControl&) = delete;
  TopicControl& operator=(const TopicControl&) = delete;

  [[nodiscard]] const TopicShape& shape() const { return shape_; }
  [[nodiscard]] std::uint32_t chunks() const { return chunks_; }
  [[nodiscard]] std::uint64_t stride() const { return stride_; }
  TopicHeader& header() { return *header_; }
  TopicQueue& queue(std::uint32_t subscriber) { return *queues_[subscriber]; }
  QueuePlace& slot(std::uint32_t subscriber, std::uint64_t position) {
    return slots_[subscriber][position % shape_.depth];
  }
  std::atomic<std::uint64_t>& held(std::uint32_t chunk) { return held_[chunk]; }

  /// `subscriber` is dead: nothing is held by it any more.
  void release_all(std::uint32_t subscriber);
  /// One beyond the last release that was published.
  [[nodiscard]] std::uint64_t next_sequence() const {
    return header_->next_sequence.load(std::memory_order_acquire);
  }
  /// Messages lost for `subscriber` because its queue was full or it keeps too many.
  [[nodiscard]] std::uint64_t dropped(std::uint32_t subscriber) const {
    return queues_[subscriber]->dropped.load(std::memory_order_relaxed);
  }

 private:
  TopicControl() = default;
  void* memory_ = nullptr;
  std::size_t bytes_ = 0;
  TopicShape shape_;
  std::uint32_t chunks_ = 0;
  std::uint64_t stride_ = 0;
  TopicHeader* header_ = nullptr;
  std::vector<TopicQueue*> queues_;
  std::vector<QueuePlace*> slots_;
  std::atomic<std::uint64_t>* held_ = nullptr;
};

/// The writing end. Threads: `loan` and `publish` from any thread of one process.
class ShmPublisher final : public Publisher,
                           public BufferKeeper,
                           public std::enable_shared_from_this<ShmPublisher> {
 public:
  /// `ends`: of a topic that passes buffers, by reader.
  [[nodiscard]] static Result<std::shared_ptr<ShmPublisher>> open(const detail::TopicSpec& spec,
                                                                  int control_fd, int data_fd,
                                                                  Ringer* ringer,
                                                                  std::vector<UniqueFd> ends = {});
  ~ShmPublisher() override;

  /// A chunk to make a message in; null if the message is too large or no chunk is free, and then a
  /// message is made on the heap: it is copied later, or lost for other processes.
  std::shared_ptr<void> loan(std::size_t bytes) override;
  /// Never waits. A message that lies in a loaned chunk travels as it is; any other one is copied
  /// (plain data) or encoded.
  void publish(const detail::Envelope& envelope) override;
  [[nodiscard]] Sender sender() override {
    return [this](const detail::Envelope& envelope) { publish(envelope); };
  }

  void let_go() override;

  [[nodiscard]] std::uint64_t next_sequence() const override { return control_->next_sequence(); }
  /// Messages that could not be sent to anybody: too large, no chunk, or encode threw.
  [[nodiscard]] std::uint64_t unsent() const override {
    return unsent_.load(std::memory_order_relaxed);
  }

 private:
  ShmPublisher() = default;
  using Messages = std::vector<std::shared_ptr<const void>>;
  void mark_queued() XAUTO_REQUIRES(mutex_);
  [[nodiscard]] std::uint32_t find_free() XAUTO_REQUIRES(mutex_);
  [[nodiscard]] std::uint32_t first_free() XAUTO_REQUIRES(mutex_);
  [[nodiscard]] Messages through() XAUTO_REQUIRES(mutex_);
  std::uint32_t store_buffered(const detail::Envelope& envelope, std::uint64_t& bytes,
                               BufferSender::Reached& reached) XAUTO_REQUIRES(mutex_);
  [[nodiscard]] std::uint32_t chunk_of(const void* message) const;
  std::uint32_t store(const void* message, std::uint64_t& bytes) XAUTO_REQUIRES(mutex_);
  void push(std::uint32_t subscriber, const detail::Envelope& envelope, std::uint32_t chunk,
            std::uint64_t bytes);

  detail::TopicSpec spec_;
  std::shared_ptr<TopicControl> control_;
  Ringer* ringer_ = nullptr;
  std::byte* data_ = nullptr;
  PiMutex mutex_;  ///< of this process only: publishing order, and the choice of a chunk
  std::vector<std::uint8_t> queued_ XAUTO_GUARDED_BY(mutex_);  ///< scratch of find_free
  std::unique_ptr<std::atomic<std::uint32_t>[]> loaned_;       ///< [chunk] this process uses it
  std::atomic<std::uint64_t> unsent_{0};
  std::unique_ptr<BufferSender> buffers_ XAUTO_GUARDED_BY(mutex_);  ///< null: it passes none
  Messages kept_ XAUTO_GUARDED_BY(mutex_);                          ///< [chunk] with a buffer
};

/// The reading end of one process. Threads: `take` from one; the messages from any.
class ShmSubscriber final : public Subscriber, public std::enable_shared_from_this<ShmSubscriber> {
 public:
  [[nodiscard]] static Result<std::shared_ptr<ShmSubscriber>> open(const detail::TopicSpec& spec,
                                                                   int control_fd, int data_fd,
                                                                   std::uint32_t index,
                                                                   UniqueFd end = {});
  ~ShmSubscriber() override;

  /// The next message or tombstone; nullopt: none. A message that cannot be decoded comes as a
  /// tombstone.
  [[nodiscard]] std::optional<detail::Envelope> take() override;
  /// The same without ever touching the message: for whoever stands in for a dead reader.
  [[nodiscard]] std::optional<detail::Envelope> take_blank() override;
  [[nodiscard]] bool empty() const override;
  [[nodiscard]] std::uint64_t lost() const override { return lost_; }

 private:
  ShmSubscriber() = default;
  struct Taken {
    std::uint32_t chunk;
    std::uint64_t bytes, sequence;
    std::int64_t origin_ns;
    std::shared_ptr<const detail::Origins> origins;
    bool urgent = false;
  };
  std::optional<Taken> next();
  void free_chunk(std::uint32_t chunk);
  [[nodiscard]] std::shared_ptr<const void> with_buffer(const std::byte* at, std::uint32_t chunk);

  detail::TopicSpec spec_;
  std::shared_ptr<TopicControl> control_;
  const std::byte* data_ = nullptr;
  std::uint32_t index_ = 0;
  std::uint64_t bit_ = 0, head_ = 0, lost_ = 0;
  std::unique_ptr<BufferReceiver> buffers_;  ///< null: it passes none
  const std::shared_ptr<KeptMessages> kept_ = std::make_shared<KeptMessages>();
};

/// A topic in new shared memory.
[[nodiscard]] Result<std::unique_ptr<Link>> make_link(const TopicShape& shape);
/// The same in another process, with what it was invited with.
[[nodiscard]] Result<std::unique_ptr<Link>> join_link(std::vector<UniqueFd> fds);

}  // namespace xauto::transport
