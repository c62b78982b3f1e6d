// SPDX-License-Identifier: Apache-2.0
// Memory behind a descriptor, as cameras, GPUs and DLAs share it: a dmabuf or a sealed memfd. A message that has one passes from
// process to process without a copy; what travels is a number.
#pragma once

#include <cstddef>
#include <cstring>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <xauto/result.h>
#include <xauto/topic.h>

namespace xauto {

namespace detail {
class BufferMemory;
class BufferPoolData;
struct BufferAccess;
void end_access(const BufferMemory& memory, bool write);
}  // namespace detail

/// The most bytes of a Buffer.
inline constexpr std::size_t kMaxBufferBytes = std::size_t{1} << 30;

/// The bytes of a Buffer while the CPU reads (Byte: const std::byte) or writes (std::byte) them. Of a
/// dmabuf the kernel keeps caches and devices in step at its begin and its end (linux/dma-buf.h,
/// DMA_BUF_IOCTL_SYNC). So keep it no longer than the access. It keeps the memory, not the turn:
/// of a message, keep the message or its Buffer as well.
template <class Byte>
class BufferBytes {
 public:
  BufferBytes(BufferBytes&&) noexcept = default;  ///< leaves nothing to end there
  BufferBytes& operator=(BufferBytes&&) = delete;
  ~BufferBytes() {
    if (memory_ != nullptr) detail::end_access(*memory_, !std::is_const_v<Byte>);
  }
  /// Of the whole buffer.
  [[nodiscard]] std::span<Byte> bytes() const { return bytes_; }

 private:
  friend class Buffer;
  BufferBytes(std::shared_ptr<detail::BufferMemory> memory, std::span<Byte> bytes)
      : memory_(std::move(memory)), bytes_(bytes) {}
  std::shared_ptr<detail::BufferMemory> memory_;
  std::span<Byte> bytes_;
};

/// A handle: copies are the same memory, which is unmapped and closed with the last of them. Threads: any;
/// who writes while others read is the app's to arrange, and once published nobody writes.
class Buffer {
 public:
  /// None; what it is asked for is 0, and read() and write() fail.
  Buffer() = default;

  /// A new memfd, sealed against a change of its size, of zeros. kInvalid: no size from 1 to
  /// kMaxBufferBytes. kIo: no memory, or no descriptor left (RLIMIT_NOFILE).
  [[nodiscard]] static Result<Buffer> memory(std::size_t bytes);
  /// What a driver or another library made: a dmabuf, or a memfd with F_SEAL_SHRINK. A duplicate of
  /// `fd` is kept; `fd` stays the caller's. kInvalid: it is neither, or of no size from 1 to
  /// kMaxBufferBytes. kIo: no descriptor left.
  [[nodiscard]] static Result<Buffer> adopt(int fd);

  /// Whether there is one.
  explicit operator bool() const { return memory_ != nullptr; }
  /// The descriptor, for drivers and libraries that import it; valid as long as a handle is. -1: none.
  [[nodiscard]] int fd() const;
  /// Its size.
  [[nodiscard]] std::size_t size() const;
  /// A dmabuf, not a memfd.
  [[nodiscard]] bool is_dmabuf() const;
  /// Mapped at the first call, which is the one that costs. kIo: it cannot be mapped, or its
  /// exporter refuses the CPU.
  [[nodiscard]] Result<BufferBytes<const std::byte>> read() const;
  /// The same. kPermission: it came with a message from another process, or was opened to be read. In the
  /// process that published it, it is not refused.
  [[nodiscard]] Result<BufferBytes<std::byte>> write() const;

 private:
  friend struct detail::BufferAccess;
  std::shared_ptr<detail::BufferMemory> memory_;
  std::shared_ptr<void>
      turn_;  ///< ends with the last copy: back to its pool, or to who published it
};

/// Buffers of which each is used again when nobody has it any more, in whichever process; who died has
/// none. A handle. Threads: any.
class BufferPool {
 public:
  /// `count` (1 to 64) times Buffer::memory(bytes); its errors.
  [[nodiscard]] static Result<BufferPool> make(std::size_t count, std::size_t bytes);
  /// Those of a driver. kInvalid: not 1 to 64, or one that is none.
  [[nodiscard]] static Result<BufferPool> of(const std::vector<Buffer>& buffers);

  /// The first that is free; nullopt: all are in use, so wait for a later release, or lose this one.
  [[nodiscard]] std::optional<Buffer> acquire() const;
  /// Which one it is, in the order of of(); nullopt: it is not of this pool.
  [[nodiscard]] std::optional<std::size_t> index_of(const Buffer& buffer) const;

 private:
  explicit BufferPool(std::shared_ptr<detail::BufferPoolData> data) : data_(std::move(data)) {}
  std::shared_ptr<detail::BufferPoolData> data_;
};

/// A message: what a Buffer has in it, and what is to be known of it (plain data: time, width, format).
///
///   xauto::Topic<xauto::Buffered<FrameInfo>> frames("frames");
template <class Info>
struct Buffered {
  static_assert(std::is_trivially_copyable_v<Info> && !std::is_pointer_v<Info>,
                "Info passes to other processes as its bytes");
  Info info{};    ///< travels as its bytes
  Buffer buffer;  ///< travels as its descriptor, once per buffer and reader; none is allowed
};

namespace detail {

using InfoOf = const void* (*)(const void* message);
using BufferOf = const Buffer& (*)(const void* message);
using MakeBuffered = std::shared_ptr<const void> (*)(const void* info, Buffer&& buffer);
/// How the parts of a Buffered pass to other processes.
void set_buffered(TopicSpec& topic, std::size_t info_bytes, InfoOf info, BufferOf buffer,
                  MakeBuffered make);

}  // namespace detail

/// For records and for other machines: Info's bytes, then the buffer's. Info::kMaxBytes, if there is
/// one, is the most of both; else 8 MiB.
template <class Info>
struct Codec<Buffered<Info>> {
  static constexpr bool kAvailable = true;  ///< yes
  /// The most bytes of both.
  static constexpr std::size_t kMaxBytes = [] {
    if constexpr (requires { Info::kMaxBytes; })
      return static_cast<std::size_t>(Info::kMaxBytes);
    else
      return std::size_t{8} << 20;
  }();
  /// Throws std::runtime_error when the buffer cannot be read.
  static std::vector<std::byte> encode(const Buffered<Info>& message) {
    std::vector<std::byte> bytes(sizeof(Info) + message.buffer.size());
    std::memcpy(bytes.data(), &message.info, sizeof(Info));
    if (message.buffer) {
      const auto from = message.buffer.read();
      if (!from) throw std::runtime_error(from.error().to_string());
      std::memcpy(bytes.data() + sizeof(Info), from->bytes().data(), from->bytes().size());
    }
    return bytes;
  }
  /// In a new memfd. Throws std::runtime_error when the bytes are fewer than an Info's, or there is none.
  static Buffered<Info> decode(std::span<const std::byte> bytes) {
    if (bytes.size() < sizeof(Info))
      throw std::runtime_error("message of " + std::to_string(bytes.size()) +
                               " bytes, expected at least " + std::to_string(sizeof(Info)));
    Buffered<Info> message;
    std::memcpy(&message.info, bytes.data(), sizeof(Info));
    const auto content = bytes.subspan(sizeof(Info));
    if (content.empty()) return message;
    auto buffer = Buffer::memory(content.size());
    if (!buffer) throw std::runtime_error(buffer.error().to_string());
    const auto to = buffer->write();
    if (!to) throw std::runtime_error(to.error().to_string());
    std::memcpy(to->bytes().data(), content.data(), content.size());
    message.buffer = std::move(*buffer);
    return message;
  }
  /// For detail::topic_spec.
  static void describe(detail::TopicSpec& topic) {
    using Message = Buffered<Info>;
    detail::set_buffered(
        topic, sizeof(Info),
        [](const void* m) -> const void* { return &static_cast<const Message*>(m)->info; },
        [](const void* m) -> const Buffer& { return static_cast<const Message*>(m)->buffer; },
        [](const void* info, Buffer&& buffer) -> std::shared_ptr<const void> {
          auto message = std::make_shared<Message>();
          std::memcpy(&message->info, info, sizeof(Info));
          message->buffer = std::move(buffer);
          return message;
        });
  }
};

}  // namespace xauto
