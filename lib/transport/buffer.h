// SPDX-License-Identifier: Apache-2.0
// What include/xauto/buffer.h hides: the memory behind a descriptor, checked when it comes in and mapped when somebody looks.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include <xauto/buffer.h>

#include "base/pi_mutex.h"
#include "base/unique_fd.h"

namespace xauto::transport {

/// Buffers of one topic that are known at a time, and so of a pool: a camera has 4 to 32. The descriptors of each reader are
/// bounded by it.
inline constexpr std::size_t kMaxKnownBuffers = 64;

/// Keeps messages because other processes read their buffers.
class BufferKeeper {
 public:
  virtual ~BufferKeeper() = default;
  /// Lets go of those that nobody reads any more. Threads: any.
  virtual void let_go() = 0;
};

}  // namespace xauto::transport

namespace xauto::detail {

/// Threads: any.
class BufferMemory {
 public:
  [[nodiscard]] static Result<std::shared_ptr<BufferMemory>> make(std::size_t bytes);
  /// A dmabuf, or a memfd that cannot shrink: whoever maps anything else can be killed by its owner with SIGBUS. `received`:
  /// from another process, so it is read only.
  [[nodiscard]] static Result<std::shared_ptr<BufferMemory>> adopt(UniqueFd fd, bool received);
  ~BufferMemory();
  BufferMemory(const BufferMemory&) = delete;
  BufferMemory& operator=(const BufferMemory&) = delete;

  [[nodiscard]] int fd() const { return fd_.get(); }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] bool is_dmabuf() const { return is_dmabuf_; }
  [[nodiscard]] bool is_writable() const { return is_writable_; }
  /// Of no other in this process, ever.
  [[nodiscard]] std::uint64_t serial() const { return serial_; }
  /// Mapped at the first call, for writing if it is writable.
  [[nodiscard]] Result<std::byte*> map();
  /// DMA_BUF_IOCTL_SYNC; nothing of a memfd.
  [[nodiscard]] Status sync(bool begin, bool write) const;

  /// `keeper` is asked by let_go from now on.
  void kept_by(std::weak_ptr<transport::BufferKeeper> keeper);
  void let_go();

 private:
  BufferMemory() = default;
  UniqueFd fd_;
  std::size_t size_ = 0;
  bool is_dmabuf_ = false, is_writable_ = false;
  std::uint64_t serial_ = 0;
  PiMutex mutex_;
  std::byte* mapped_ XAUTO_GUARDED_BY(mutex_) = nullptr;
  std::vector<std::weak_ptr<transport::BufferKeeper>> keepers_ XAUTO_GUARDED_BY(mutex_);
};

/// A Buffer from inside.
struct BufferAccess {
  [[nodiscard]] static const std::shared_ptr<BufferMemory>& memory(const Buffer& buffer) {
    return buffer.memory_;
  }
  [[nodiscard]] static Buffer make(std::shared_ptr<BufferMemory> memory,
                                   std::shared_ptr<void> turn = nullptr);
};

}  // namespace xauto::detail
