// SPDX-License-Identifier: Apache-2.0
#include "transport/shm_topic.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cstring>
#include <string>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/memory_file.h"
#include "base/socket.h"

namespace xauto::transport {
namespace {

constexpr std::uint64_t kAlignment = 4096;  ///< of chunks: SIMD, GPU mappings, and no shared page

std::uint64_t round_up(std::uint64_t bytes, std::uint64_t to) {
  return (bytes + to - 1) / to * to;
}

std::uint32_t chunks_of(const TopicShape& s) {
  return s.subscribers * (s.depth + s.keep) + s.keep + 2;
}

/// Small messages lie close together, large ones on pages of their own.
std::uint64_t stride_of(const TopicShape& s) {
  return s.chunk_bytes >= kAlignment ? round_up(s.chunk_bytes, kAlignment)
                                     : round_up(std::max<std::uint64_t>(s.chunk_bytes, 1), 64);
}

std::size_t control_bytes(const TopicShape& s) {
  return sizeof(TopicHeader) + s.subscribers * (sizeof(TopicQueue) + s.depth * sizeof(QueuePlace)) +
         chunks_of(s) * sizeof(std::uint64_t);
}

Status check(const TopicShape& s) {
  if (s.subscribers == 0 || s.subscribers > kMaxTopicSubscribers || s.depth == 0 ||
      s.depth > kMaxQueueDepth || s.keep > kMaxKeep || s.chunk_bytes > kMaxChunkBytes)
    return fail(ErrorCode::kInvalid, "topic of " + std::to_string(s.subscribers) +
                                         " subscribers, queue " + std::to_string(s.depth) +
                                         ", keep " + std::to_string(s.keep) + ", messages of " +
                                         std::to_string(s.chunk_bytes) +
                                         " bytes is beyond the limits");
  return {};
}

static_assert(BufferSender::Reached().size() >= kMaxTopicSubscribers);
static_assert(kMaxPassedFds >= 2 + kMaxTopicSubscribers);  // what a publisher is invited with

/// A buffer's number, then what its message has besides.
constexpr std::size_t kNumberBytes = sizeof(std::uint64_t);

Status check(const TopicControl& control, const detail::TopicSpec& spec, std::size_t ends,
             std::size_t wanted) {
  const bool buffered = spec.buffered.make != nullptr;
  if (control.shape().passes_buffers != buffered || ends != (buffered ? wanted : 0))
    return fail(ErrorCode::kInvalid, "a topic of " + spec.type_name + " came with " +
                                         std::to_string(ends) + " ways for buffers");
  return {};
}

Result<std::byte*> map_data(const TopicControl& control, int fd, int protection) {
  const std::size_t bytes = control.chunks() * control.stride();
  struct stat status {};
  if (fstat(fd, &status) != 0 || static_cast<std::size_t>(status.st_size) < bytes)
    return fail(ErrorCode::kInvalid, "a topic's data is cut short");
  void* memory = mmap(nullptr, bytes, protection, MAP_SHARED, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map a topic's data: ") + strerror(errno));
  return static_cast<std::byte*>(memory);
}

}  // namespace

std::uint64_t chunk_bytes_of(const detail::TopicSpec& spec) {
  if (spec.buffered.make != nullptr) return kNumberBytes + spec.buffered.info_bytes;
  return spec.plain_bytes > 0 ? spec.plain_bytes : spec.max_bytes;
}

Result<TopicFds> make_topic(const TopicShape& shape) {
  XAUTO_TRY(check(shape));
  TopicFds fds;
  XAUTO_ASSIGN(fds.control, sealed_memory("xauto-topic", control_bytes(shape)));
  XAUTO_ASSIGN(fds.data, sealed_memory("xauto-topic-data", chunks_of(shape) * stride_of(shape)));
  TopicHeader header;
  header.magic = kTopicMagic;
  header.subscribers = shape.subscribers;
  header.depth = shape.depth;
  header.keep = shape.keep;
  header.chunks = chunks_of(shape);
  header.passes_buffers = shape.passes_buffers ? 1 : 0;
  header.chunk_bytes = shape.chunk_bytes;
  // All else starts as zeros.
  if (pwrite(fds.control.get(), static_cast<const void*>(&header), sizeof header, 0) !=
      static_cast<ssize_t>(sizeof header))
    return fail(ErrorCode::kIo, std::string("cannot write shared memory: ") + strerror(errno));
  return fds;
}

// ---- control -----------------------------------------------------------------------------------

Result<std::shared_ptr<TopicControl>> TopicControl::map(int fd) {
  struct stat status {};
  if (fstat(fd, &status) != 0 || static_cast<std::size_t>(status.st_size) < sizeof(TopicHeader))
    return fail(ErrorCode::kInvalid, "a topic's shared memory is cut short");
  auto control = std::shared_ptr<TopicControl>(new TopicControl);
  TopicControl& c = *control;
  c.bytes_ = static_cast<std::size_t>(status.st_size);
  void* memory = mmap(nullptr, c.bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map a topic: ") + strerror(errno));
  c.memory_ = memory;
  c.header_ = static_cast<TopicHeader*>(memory);
  const TopicHeader& h = *c.header_;
  c.shape_ = {h.chunk_bytes, h.subscribers, h.depth, h.keep, h.passes_buffers != 0};
  if (h.magic != kTopicMagic || !check(c.shape_) || h.chunks != chunks_of(c.shape_) ||
      c.bytes_ < control_bytes(c.shape_))
    return fail(ErrorCode::kInvalid, "a topic's shared memory has no valid header", {},
                "all processes of an app must be of one build");
  c.chunks_ = h.chunks;
  c.stride_ = stride_of(c.shape_);
  auto* at = reinterpret_cast<std::byte*>(c.header_ + 1);
  for (std::uint32_t s = 0; s < c.shape_.subscribers; ++s) {
    c.queues_.push_back(reinterpret_cast<TopicQueue*>(at));
    at += sizeof(TopicQueue);
    c.slots_.push_back(reinterpret_cast<QueuePlace*>(at));
    at += c.shape_.depth * sizeof(QueuePlace);
  }
  c.held_ = reinterpret_cast<std::atomic<std::uint64_t>*>(at);
  return control;
}

TopicControl::~TopicControl() {
  if (memory_ != nullptr) munmap(memory_, bytes_);
}

void TopicControl::release_all(std::uint32_t subscriber) {
  for (std::uint32_t c = 0; c < chunks_; ++c)
    held_[c].fetch_and(~(std::uint64_t{1} << subscriber), std::memory_order_seq_cst);
}

// ---- publishing --------------------------------------------------------------------------------

Result<std::shared_ptr<ShmPublisher>> ShmPublisher::open(const detail::TopicSpec& spec,
                                                         int control_fd, int data_fd,
                                                         Ringer* ringer,
                                                         std::vector<UniqueFd> ends) {
  auto publisher = std::shared_ptr<ShmPublisher>(new ShmPublisher);
  publisher->spec_ = spec;
  publisher->ringer_ = ringer;
  XAUTO_ASSIGN(publisher->control_, TopicControl::map(control_fd));
  TopicControl& control = *publisher->control_;
  XAUTO_TRY(check(control, spec, ends.size(), control.shape().subscribers));
  XAUTO_ASSIGN(publisher->data_, map_data(control, data_fd, PROT_READ | PROT_WRITE));
  const Guard lock(publisher->mutex_);
  publisher->queued_.resize(control.chunks());
  publisher->loaned_ = std::make_unique<std::atomic<std::uint32_t>[]>(control.chunks());
  if (!ends.empty()) {
    publisher->kept_.resize(control.chunks());
    publisher->buffers_ =
        std::make_unique<BufferSender>(spec.name, std::move(ends), control.header().buffers);
  }
  for (std::uint32_t s = 0; s < control.shape().subscribers; ++s) {
    // A predecessor that died between its last slot and `tail`.
    TopicQueue& queue = control.queue(s);
    const std::uint64_t tail = queue.tail.load();
    if (control.slot(s, tail).word.load() == tail + 1) queue.tail.store(tail + 1);
  }
  return publisher;
}

ShmPublisher::~ShmPublisher() {
  if (data_ != nullptr) munmap(data_, control_->chunks() * control_->stride());
}

void ShmPublisher::mark_queued() {
  TopicControl& c = *control_;
  std::fill(queued_.begin(), queued_.end(), std::uint8_t{0});
  for (std::uint32_t s = 0; s < c.shape().subscribers; ++s)
    for (std::uint32_t i = 0; i < c.shape().depth; ++i) {
      QueuePlace& slot = c.slot(s, i);
      if (slot.word.load(std::memory_order_seq_cst) == 0) continue;
      const std::uint32_t chunk = slot.chunk.load(std::memory_order_relaxed);
      if (chunk < c.chunks()) queued_[chunk] = 1;
    }
}

/// Queues before `held`: see the top of shm_topic.h.
std::uint32_t ShmPublisher::find_free() {
  mark_queued();
  return first_free();
}

/// Nobody else queues chunks, so that marks of earlier under the same lock err to the safe side.
std::uint32_t ShmPublisher::first_free() {
  TopicControl& c = *control_;
  // Lowest first: few chunks are ever touched, and they stay in the cache.
  for (std::uint32_t i = 0; i < c.chunks(); ++i)
    if (queued_[i] == 0 && loaned_[i].load(std::memory_order_acquire) == 0 &&
        c.held(i).load(std::memory_order_seq_cst) == 0)
      return i;
  return kNoChunk;
}

/// Messages whose buffers nobody reads any more; their ends are not for a holder of the mutex.
ShmPublisher::Messages ShmPublisher::through() {
  Messages done;
  mark_queued();
  for (std::uint32_t i = 0; i < kept_.size(); ++i)
    if (kept_[i] != nullptr && queued_[i] == 0 &&
        control_->held(i).load(std::memory_order_seq_cst) == 0)
      done.push_back(std::move(kept_[i]));
  return done;
}

void ShmPublisher::let_go() {
  Messages done;
  const Guard lock(mutex_);
  done = through();
}

std::uint32_t ShmPublisher::store_buffered(const detail::Envelope& envelope, std::uint64_t& bytes,
                                           BufferSender::Reached& reached) {
  const void* message = envelope.message.get();
  const auto& memory = detail::BufferAccess::memory(spec_.buffered.buffer(message));
  BufferSender::Told told;
  told.reached.set();  // a message without a buffer
  if (memory != nullptr) {
    auto heard = buffers_->tell(memory, [&](std::size_t reader) {
      return control_->queue(static_cast<std::uint32_t>(reader)).asks.load();
    });
    if (!heard) return kNoChunk;
    told = *heard;
    memory->kept_by(weak_from_this());
  }
  const std::uint32_t chunk = first_free();
  if (chunk == kNoChunk) return kNoChunk;
  std::byte* at = data_ + chunk * control_->stride();
  std::memcpy(at, &told.number, kNumberBytes);
  std::memcpy(at + kNumberBytes, spec_.buffered.info(message), spec_.buffered.info_bytes);
  bytes = kNumberBytes + spec_.buffered.info_bytes;
  reached = told.reached;
  kept_[chunk] = envelope.message;
  return chunk;
}

std::shared_ptr<void> ShmPublisher::loan(std::size_t bytes) {
  if (bytes > control_->shape().chunk_bytes) return nullptr;
  std::uint32_t chunk;
  {
    const Guard lock(mutex_);
    // Our own process keeps too many: the others must not starve for it.
    std::uint32_t kept = 0;
    for (std::uint32_t i = 0; i < control_->chunks(); ++i)
      kept += loaned_[i].load(std::memory_order_relaxed) != 0 ? 1 : 0;
    if (kept > control_->shape().keep) return nullptr;
    chunk = find_free();
    if (chunk == kNoChunk) return nullptr;
    loaned_[chunk].store(1, std::memory_order_relaxed);
  }
  return {data_ + chunk * control_->stride(), [self = shared_from_this(), chunk](void*) {
            self->loaned_[chunk].store(0, std::memory_order_release);
          }};
}

std::uint32_t ShmPublisher::chunk_of(const void* message) const {
  const auto at = reinterpret_cast<std::uintptr_t>(message);
  const auto start = reinterpret_cast<std::uintptr_t>(data_);
  if (at < start || at >= start + control_->chunks() * control_->stride()) return kNoChunk;
  return static_cast<std::uint32_t>((at - start) / control_->stride());
}

std::uint32_t ShmPublisher::store(const void* message, std::uint64_t& bytes) {
  const std::uint32_t chunk = find_free();
  if (chunk == kNoChunk) return kNoChunk;
  std::byte* at = data_ + chunk * control_->stride();
  if (spec_.plain_bytes > 0) {
    bytes = spec_.plain_bytes;
    if (bytes > control_->shape().chunk_bytes) return kNoChunk;
    std::memcpy(at, message, bytes);
    return chunk;
  }
  if (spec_.encode == nullptr) return kNoChunk;
  try {
    if (spec_.encode_into != nullptr) {
      bytes = spec_.encoded_bytes(message);
      if (bytes > control_->shape().chunk_bytes) return kNoChunk;
      spec_.encode_into(message, {at, bytes});
      return chunk;
    }
    const std::vector<std::byte> encoded = spec_.encode(message);
    bytes = encoded.size();
    if (bytes > control_->shape().chunk_bytes) return kNoChunk;
    if (bytes > 0) std::memcpy(at, encoded.data(), bytes);
  } catch (...) {
    return kNoChunk;
  }
  return chunk;
}

void ShmPublisher::publish(const detail::Envelope& envelope) {
  TopicControl& c = *control_;
  Messages done;
  {
    const Guard lock(mutex_);
    std::uint32_t chunk = kNoChunk;
    std::uint64_t bytes = 0;
    BufferSender::Reached reached;
    reached.set();
    if (buffers_ != nullptr) done = through();
    if (envelope.message != nullptr && buffers_ != nullptr) {
      chunk = store_buffered(envelope, bytes, reached);
      if (chunk == kNoChunk) unsent_.fetch_add(1, std::memory_order_relaxed);
    } else if (envelope.message != nullptr) {
      chunk = chunk_of(envelope.message.get());
      bytes = spec_.plain_bytes;
      if (chunk == kNoChunk) chunk = store(envelope.message.get(), bytes);
      if (chunk == kNoChunk) unsent_.fetch_add(1, std::memory_order_relaxed);
    }
    std::array<std::uint32_t, kMaxTopicSubscribers> kept{};
    if (chunk != kNoChunk)
      for (std::uint32_t i = 0; i < c.chunks(); ++i)
        for (std::uint64_t readers = c.held(i).load(std::memory_order_relaxed); readers != 0;
             readers &= readers - 1)
          ++kept[static_cast<std::size_t>(std::countr_zero(readers))];
    for (std::uint32_t s = 0; s < c.shape().subscribers; ++s) {
      const bool refused = (kept[s] > 0 && kept[s] >= c.shape().keep) || !reached.test(s);
      if (refused) c.queue(s).dropped.fetch_add(1, std::memory_order_relaxed);
      push(s, envelope, refused ? kNoChunk : chunk, bytes);
    }
    c.header().next_sequence.store(envelope.sequence + 1, std::memory_order_release);
  }
  if (ringer_ != nullptr)
    for (std::uint32_t s = 0; s < c.shape().subscribers; ++s) ringer_->ring(s);
}

void ShmPublisher::push(std::uint32_t s, const detail::Envelope& envelope, std::uint32_t chunk,
                        std::uint64_t bytes) {
  TopicQueue& queue = control_->queue(s);
  const std::uint64_t tail = queue.tail.load(std::memory_order_relaxed);
  QueuePlace& slot = control_->slot(s, tail);
  // The oldest message, if nobody has taken it: lost for this subscriber.
  if (slot.word.exchange(0, std::memory_order_seq_cst) != 0)
    queue.dropped.fetch_add(1, std::memory_order_relaxed);
  slot.sequence.store(envelope.sequence, std::memory_order_relaxed);
  slot.origin_ns.store(envelope.origin_ns, std::memory_order_relaxed);
  slot.chunk.store(chunk, std::memory_order_relaxed);
  slot.bytes.store(bytes, std::memory_order_relaxed);
  slot.rates.store(
      (envelope.origins != nullptr ? kHasOrigins : 0) | (envelope.urgent ? kIsUrgent : 0),
      std::memory_order_relaxed);
  if (envelope.origins != nullptr)
    for (std::size_t i = 0; i < detail::kMaxOrigins; ++i)
      slot.origins[i].store((*envelope.origins)[i], std::memory_order_relaxed);
  slot.word.store(tail + 1, std::memory_order_seq_cst);
  queue.tail.store(tail + 1, std::memory_order_seq_cst);
}

// ---- subscribing -------------------------------------------------------------------------------

Result<std::shared_ptr<ShmSubscriber>> ShmSubscriber::open(const detail::TopicSpec& spec,
                                                           int control_fd, int data_fd,
                                                           std::uint32_t index, UniqueFd end) {
  auto subscriber = std::shared_ptr<ShmSubscriber>(new ShmSubscriber);
  subscriber->spec_ = spec;
  XAUTO_ASSIGN(subscriber->control_, TopicControl::map(control_fd));
  if (index >= subscriber->control_->shape().subscribers)
    return fail(ErrorCode::kInvalid, "subscriber " + std::to_string(index) + " of a topic with " +
                                         std::to_string(subscriber->control_->shape().subscribers));
  XAUTO_TRY(check(*subscriber->control_, spec, end ? 1 : 0, 1));
  XAUTO_ASSIGN(subscriber->data_, map_data(*subscriber->control_, data_fd, PROT_READ));
  subscriber->index_ = index;
  subscriber->bit_ = std::uint64_t{1} << index;
  subscriber->head_ = subscriber->control_->queue(index).head.load();
  if (end) {
    subscriber->buffers_ = std::make_unique<BufferReceiver>(spec.name, std::move(end));
    subscriber->buffers_->drain();  // what a predecessor has not taken
    subscriber->buffers_->give_away();
    subscriber->control_->queue(index).asks.fetch_add(1);
  }
  return subscriber;
}

ShmSubscriber::~ShmSubscriber() {
  if (data_ != nullptr)
    munmap(const_cast<std::byte*>(data_), control_->chunks() * control_->stride());
}

bool ShmSubscriber::empty() const {
  return control_->queue(index_).tail.load(std::memory_order_seq_cst) <= head_;
}

void ShmSubscriber::free_chunk(std::uint32_t chunk) {
  control_->held(chunk).fetch_and(~bit_, std::memory_order_seq_cst);
}

std::optional<ShmSubscriber::Taken> ShmSubscriber::next() {
  TopicQueue& queue = control_->queue(index_);
  const std::uint64_t depth = control_->shape().depth;
  for (;;) {
    QueuePlace& slot = control_->slot(index_, head_);
    std::uint64_t word = slot.word.load(std::memory_order_seq_cst);
    if (word != head_ + 1) {
      const std::uint64_t tail = queue.tail.load(std::memory_order_seq_cst);
      if (tail <= head_) return std::nullopt;
      // Overwritten, or just being overwritten: the oldest that may still be there.
      const std::uint64_t oldest = tail > depth ? tail - depth : 0;
      const std::uint64_t next = std::max(head_ + 1, oldest);
      // Its word may be there although this look came too early for it.
      if (slot.word.load(std::memory_order_seq_cst) == head_ + 1) continue;
      lost_ += next - head_;
      head_ = next;
      queue.head.store(head_, std::memory_order_relaxed);
      continue;
    }
    Taken taken{slot.chunk.load(std::memory_order_relaxed),
                slot.bytes.load(std::memory_order_relaxed),
                slot.sequence.load(std::memory_order_relaxed),
                slot.origin_ns.load(std::memory_order_relaxed), nullptr};
    const std::uint32_t rates = slot.rates.load(std::memory_order_relaxed);
    taken.urgent = (rates & kIsUrgent) != 0;
    if ((rates & kHasOrigins) != 0) {
      auto origins = std::make_shared<detail::Origins>();
      for (std::size_t i = 0; i < detail::kMaxOrigins; ++i)
        (*origins)[i] = slot.origins[i].load(std::memory_order_relaxed);
      taken.origins = std::move(origins);
    }
    const bool message = taken.chunk < control_->chunks();
    if (message) control_->held(taken.chunk).fetch_or(bit_, std::memory_order_seq_cst);
    if (!slot.word.compare_exchange_strong(word, 0, std::memory_order_seq_cst)) {
      if (message) free_chunk(taken.chunk);
      continue;
    }
    queue.head.store(++head_, std::memory_order_relaxed);
    return taken;
  }
}

std::optional<detail::Envelope> ShmSubscriber::take_blank() {
  const auto taken = next();
  if (!taken) return std::nullopt;
  if (taken->chunk < control_->chunks()) free_chunk(taken->chunk);
  return detail::Envelope{nullptr, taken->origin_ns, taken->sequence, taken->origins,
                          taken->urgent};
}

/// The chunk is this reader's as long as somebody has the buffer.
std::shared_ptr<const void> ShmSubscriber::with_buffer(const std::byte* at, std::uint32_t chunk) {
  std::uint64_t number;
  std::memcpy(&number, at, kNumberBytes);
  std::shared_ptr<detail::BufferMemory> memory;
  if (number != 0) {
    memory = buffers_->find(number);
    if (memory == nullptr) {
      control_->queue(index_).asks.fetch_add(1);
      return nullptr;
    }
  }
  std::shared_ptr<void> turn(
      this, [self = shared_from_this(), chunk](void*) { self->free_chunk(chunk); });
  try {
    return spec_.buffered.make(at + kNumberBytes,
                               detail::BufferAccess::make(std::move(memory), std::move(turn)));
  } catch (...) {  // as if it had been lost on the way
    return nullptr;
  }
}

std::optional<detail::Envelope> ShmSubscriber::take() {
  const auto taken = next();
  if (!taken) return std::nullopt;
  detail::Envelope envelope{nullptr, taken->origin_ns, taken->sequence, taken->origins,
                            taken->urgent};
  if (taken->chunk >= control_->chunks()) {
    if (buffers_ != nullptr) buffers_->drain();  // it may be one that could not be told of
    return envelope;
  }
  const std::byte* at = data_ + taken->chunk * control_->stride();
  const bool fits = taken->bytes <= control_->shape().chunk_bytes;
  if (buffers_ != nullptr) {
    if (fits && taken->bytes == kNumberBytes + spec_.buffered.info_bytes)
      envelope.message = with_buffer(at, taken->chunk);
    if (envelope.message != nullptr) return envelope;
    ++lost_;
    free_chunk(taken->chunk);
    return envelope;
  }
  if (spec_.plain_bytes > 0 && fits && taken->bytes == spec_.plain_bytes) {
    envelope.message = {static_cast<const void*>(at),
                        [self = shared_from_this(), chunk = taken->chunk](const void*) {
                          self->free_chunk(chunk);
                        }};
    return envelope;
  }
  if (spec_.plain_bytes == 0 && fits && spec_.decode != nullptr) {
    try {
      envelope.message = kept_->decode(spec_, {at, static_cast<std::size_t>(taken->bytes)});
    } catch (...) {  // as if it had been lost on the way
    }
  }
  free_chunk(taken->chunk);
  return envelope;
}

// ---- as a Link ---------------------------------------------------------------------------------

namespace {

Result<UniqueFd> duplicate(int fd) {
  UniqueFd second(fcntl(fd, F_DUPFD_CLOEXEC, 0));
  if (!second) return fail(ErrorCode::kIo, std::string("cannot share a topic: ") + strerror(errno));
  return second;
}

/// `ends`: of a topic that passes buffers. Who made it has those of all; who joined it has its own.
class ShmLink final : public Link {
 public:
  ShmLink(TopicFds fds, std::vector<BufferEnds> ends)
      : fds_(std::move(fds)), all_(std::move(ends)) {}
  ShmLink(TopicFds fds, std::vector<UniqueFd> ends) : fds_(std::move(fds)), own_(std::move(ends)) {}

  Result<std::shared_ptr<Publisher>> publisher(const detail::TopicSpec& topic,
                                               Ringer* ringer) override {
    XAUTO_ASSIGN(std::vector<UniqueFd> ends, ends_of(-1));
    return ShmPublisher::open(topic, fds_.control.get(), fds_.data.get(), ringer, std::move(ends));
  }
  Result<std::shared_ptr<Subscriber>> subscriber(const detail::TopicSpec& topic,
                                                 std::uint32_t reader) override {
    XAUTO_ASSIGN(std::vector<UniqueFd> ends, ends_of(static_cast<int>(reader)));
    if (ends.size() > 1)
      return fail(ErrorCode::kInvalid, "a reader's end is asked of a topic's publisher");
    return ShmSubscriber::open(topic, fds_.control.get(), fds_.data.get(), reader,
                               ends.empty() ? UniqueFd() : std::move(ends[0]));
  }
  Result<std::vector<UniqueFd>> invite(int reader) const override {
    std::vector<UniqueFd> fds(2);
    XAUTO_ASSIGN(fds[0], duplicate(fds_.control.get()));
    XAUTO_ASSIGN(fds[1], reader < 0 ? duplicate(fds_.data.get()) : read_only(fds_.data.get()));
    XAUTO_ASSIGN(std::vector<UniqueFd> ends, ends_of(reader));
    for (UniqueFd& end : ends) fds.push_back(std::move(end));
    return fds;
  }
  std::uint64_t next_sequence() const override {
    const auto control = TopicControl::map(fds_.control.get());
    return control ? (*control)->next_sequence() : 0;
  }
  void release_all(std::uint32_t reader) override {
    if (auto control = TopicControl::map(fds_.control.get())) (*control)->release_all(reader);
  }

 private:
  /// The publisher's (-1), or a reader's.
  [[nodiscard]] Result<std::vector<UniqueFd>> ends_of(int reader) const {
    std::vector<UniqueFd> ends;
    const auto add = [&](const UniqueFd& fd) -> Status {
      XAUTO_ASSIGN(UniqueFd end, duplicate(fd.get()));
      ends.push_back(std::move(end));
      return {};
    };
    for (const UniqueFd& end : own_) XAUTO_TRY(add(end));
    for (std::size_t r = 0; r < all_.size(); ++r)
      if (reader < 0)
        XAUTO_TRY(add(all_[r].publisher));
      else if (r == static_cast<std::size_t>(reader))
        XAUTO_TRY(add(all_[r].reader));
    return ends;
  }

  TopicFds fds_;
  std::vector<BufferEnds> all_;  ///< [reader]
  std::vector<UniqueFd> own_;
};

}  // namespace

Result<std::unique_ptr<Link>> make_link(const TopicShape& shape) {
  XAUTO_ASSIGN(TopicFds fds, make_topic(shape));
  std::vector<BufferEnds> ends(shape.passes_buffers ? shape.subscribers : 0);
  for (BufferEnds& pair : ends) {
    XAUTO_ASSIGN(pair, make_buffer_ends());
  }
  return std::make_unique<ShmLink>(std::move(fds), std::move(ends));
}

Result<std::unique_ptr<Link>> join_link(std::vector<UniqueFd> fds) {
  if (fds.size() < 2 || fds.size() > 2 + kMaxTopicSubscribers)
    return fail(ErrorCode::kInvalid,
                "a topic came with " + std::to_string(fds.size()) + " descriptors, not 2 or more");
  std::vector<UniqueFd> ends(std::make_move_iterator(fds.begin() + 2),
                             std::make_move_iterator(fds.end()));
  return std::make_unique<ShmLink>(TopicFds{std::move(fds[0]), std::move(fds[1])}, std::move(ends));
}

}  // namespace xauto::transport
