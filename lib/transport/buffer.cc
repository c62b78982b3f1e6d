// SPDX-License-Identifier: Apache-2.0
#include "transport/buffer.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <string>

#include <fcntl.h>
#include <linux/dma-buf.h>
#include <linux/magic.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/vfs.h>

#include "base/memory_file.h"

namespace xauto {
namespace {

tl::unexpected<Error> io_error(const std::string& what, std::string hint = {}) {
  return fail(ErrorCode::kIo, what + ": " + strerror(errno), {}, std::move(hint));
}

tl::unexpected<Error> none() {
  return fail(ErrorCode::kInvalid, "there is no buffer");
}

Status check_size(std::uint64_t bytes) {
  if (bytes == 0 || bytes > kMaxBufferBytes)
    return fail(ErrorCode::kInvalid, "a buffer of " + std::to_string(bytes) +
                                         " bytes, not of 1 to " + std::to_string(kMaxBufferBytes));
  return {};
}

Status check_count(std::size_t buffers) {
  if (buffers == 0 || buffers > transport::kMaxKnownBuffers)
    return fail(ErrorCode::kInvalid, "a pool of " + std::to_string(buffers) +
                                         " buffers, not of 1 to " +
                                         std::to_string(transport::kMaxKnownBuffers));
  return {};
}

}  // namespace

namespace detail {

Result<std::shared_ptr<BufferMemory>> BufferMemory::make(std::size_t bytes) {
  XAUTO_TRY(check_size(bytes));
  XAUTO_ASSIGN(UniqueFd fd, sealed_memory("xauto-buffer", bytes));
  return adopt(std::move(fd), false);
}

Result<std::shared_ptr<BufferMemory>> BufferMemory::adopt(UniqueFd fd, bool received) {
  static std::atomic<std::uint64_t> serials{1};
  auto memory = std::shared_ptr<BufferMemory>(new BufferMemory);
  BufferMemory& m = *memory;
  struct statfs system {};
  struct stat status {};
  const int access = fcntl(fd.get(), F_GETFL);
  if (access < 0 || fstatfs(fd.get(), &system) != 0 || fstat(fd.get(), &status) != 0)
    return io_error("cannot look at a buffer's descriptor");
  // Dmabufs have a file system of their own since Linux 5.3, and never change their size.
  m.is_dmabuf_ = system.f_type == DMA_BUF_MAGIC;
  if (!m.is_dmabuf_) {
    const int seals = fcntl(fd.get(), F_GET_SEALS);
    if (seals < 0 || (seals & F_SEAL_SHRINK) == 0)
      return fail(ErrorCode::kInvalid,
                  seals < 0 ? "a buffer's descriptor is neither a dmabuf nor a memfd"
                            : "a buffer's memfd may shrink under those who read it",
                  {}, "memfd_create(2) with MFD_ALLOW_SEALING, then F_ADD_SEALS F_SEAL_SHRINK");
  }
  XAUTO_TRY(check_size(static_cast<std::uint64_t>(status.st_size)));
  m.size_ = static_cast<std::size_t>(status.st_size);
  m.is_writable_ = !received && (access & O_ACCMODE) == O_RDWR;
  m.serial_ = serials.fetch_add(1, std::memory_order_relaxed);
  m.fd_ = std::move(fd);
  return memory;
}

BufferMemory::~BufferMemory() {
  const Guard lock(mutex_);
  if (mapped_ != nullptr) munmap(mapped_, size_);
}

Result<std::byte*> BufferMemory::map() {
  const Guard lock(mutex_);
  if (mapped_ == nullptr) {
    void* at = mmap(nullptr, size_, is_writable_ ? PROT_READ | PROT_WRITE : PROT_READ, MAP_SHARED,
                    fd_.get(), 0);
    if (at == MAP_FAILED) return io_error("cannot map a buffer of " + std::to_string(size_));
    mapped_ = static_cast<std::byte*>(at);
  }
  return mapped_;
}

Status BufferMemory::sync(bool begin, bool write) const {
  if (!is_dmabuf_) return {};
  dma_buf_sync wanted{};
  wanted.flags = (begin ? DMA_BUF_SYNC_START : DMA_BUF_SYNC_END) |
                 (write ? DMA_BUF_SYNC_RW : DMA_BUF_SYNC_READ);
  int result;
  do {
    result = ioctl(fd_.get(), DMA_BUF_IOCTL_SYNC, &wanted);
  } while (result != 0 && (errno == EINTR || errno == EAGAIN));
  if (result != 0) return io_error("DMA_BUF_IOCTL_SYNC");
  return {};
}

void BufferMemory::kept_by(std::weak_ptr<transport::BufferKeeper> keeper) {
  const Guard lock(mutex_);
  std::erase_if(keepers_, [&](const auto& k) {
    return k.expired() || (!k.owner_before(keeper) && !keeper.owner_before(k));
  });
  keepers_.push_back(std::move(keeper));
}

void BufferMemory::let_go() {
  std::vector<std::shared_ptr<transport::BufferKeeper>> keepers;
  {
    const Guard lock(mutex_);
    for (const auto& keeper : keepers_)
      if (auto alive = keeper.lock()) keepers.push_back(std::move(alive));
  }
  for (const auto& keeper : keepers) keeper->let_go();
}

void end_access(const BufferMemory& memory, bool write) {
  (void)memory.sync(false, write);  // it was begun, so there is nothing to refuse
}

Buffer BufferAccess::make(std::shared_ptr<BufferMemory> memory, std::shared_ptr<void> turn) {
  Buffer buffer;
  buffer.memory_ = std::move(memory);
  buffer.turn_ = std::move(turn);
  return buffer;
}

/// Which of the pool's buffers somebody has.
class BufferPoolData {
 public:
  explicit BufferPoolData(std::vector<std::shared_ptr<BufferMemory>> memories)
      : memories_(std::move(memories)), taken_(memories_.size()) {}

  [[nodiscard]] const std::vector<std::shared_ptr<BufferMemory>>& memories() const {
    return memories_;
  }
  [[nodiscard]] std::optional<std::size_t> take() {
    const Guard lock(mutex_);
    const auto free = std::find(taken_.begin(), taken_.end(), false);
    if (free == taken_.end()) return std::nullopt;
    *free = true;
    return static_cast<std::size_t>(free - taken_.begin());
  }
  void give_back(std::size_t index) {
    const Guard lock(mutex_);
    taken_[index] = false;
  }

 private:
  const std::vector<std::shared_ptr<BufferMemory>> memories_;
  PiMutex mutex_;
  std::vector<bool> taken_ XAUTO_GUARDED_BY(mutex_);
};

}  // namespace detail

// ---- Buffer ------------------------------------------------------------------------------------

Result<Buffer> Buffer::memory(std::size_t bytes) {
  XAUTO_ASSIGN(auto memory, detail::BufferMemory::make(bytes));
  return detail::BufferAccess::make(std::move(memory));
}

Result<Buffer> Buffer::adopt(int fd) {
  UniqueFd own(fcntl(fd, F_DUPFD_CLOEXEC, 3));
  if (!own) return io_error("cannot duplicate a buffer's descriptor", "see `ulimit -n`");
  XAUTO_ASSIGN(auto memory, detail::BufferMemory::adopt(std::move(own), false));
  return detail::BufferAccess::make(std::move(memory));
}

int Buffer::fd() const {
  return memory_ == nullptr ? -1 : memory_->fd();
}

std::size_t Buffer::size() const {
  return memory_ == nullptr ? 0 : memory_->size();
}

bool Buffer::is_dmabuf() const {
  return memory_ != nullptr && memory_->is_dmabuf();
}

Result<BufferBytes<const std::byte>> Buffer::read() const {
  if (memory_ == nullptr) return none();
  XAUTO_ASSIGN(const std::byte* at, memory_->map());
  XAUTO_TRY(memory_->sync(true, false));
  return BufferBytes<const std::byte>(memory_, {at, memory_->size()});
}

Result<BufferBytes<std::byte>> Buffer::write() const {
  if (memory_ == nullptr) return none();
  if (!memory_->is_writable())
    return fail(ErrorCode::kPermission, "a buffer that was opened to be read is not written", {},
                "make a message of your own from it");
  XAUTO_ASSIGN(std::byte * at, memory_->map());
  XAUTO_TRY(memory_->sync(true, true));
  return BufferBytes<std::byte>(memory_, {at, memory_->size()});
}

// ---- BufferPool --------------------------------------------------------------------------------

Result<BufferPool> BufferPool::make(std::size_t count, std::size_t bytes) {
  XAUTO_TRY(check_count(count));
  std::vector<Buffer> buffers;
  for (std::size_t i = 0; i < count; ++i) {
    XAUTO_ASSIGN(Buffer buffer, Buffer::memory(bytes));
    buffers.push_back(std::move(buffer));
  }
  return of(buffers);
}

Result<BufferPool> BufferPool::of(const std::vector<Buffer>& buffers) {
  XAUTO_TRY(check_count(buffers.size()));
  std::vector<std::shared_ptr<detail::BufferMemory>> memories;
  for (const Buffer& buffer : buffers) {
    if (!buffer) return none();
    memories.push_back(detail::BufferAccess::memory(buffer));
  }
  return BufferPool(std::make_shared<detail::BufferPoolData>(std::move(memories)));
}

std::optional<Buffer> BufferPool::acquire() const {
  auto index = data_->take();
  if (!index) {  // those that readers elsewhere are through with since the last release
    for (const auto& memory : data_->memories()) memory->let_go();
    index = data_->take();
  }
  if (!index) return std::nullopt;
  return detail::BufferAccess::make(
      data_->memories()[*index],
      std::shared_ptr<void>(data_.get(),
                            [data = data_, i = *index](void*) { data->give_back(i); }));
}

std::optional<std::size_t> BufferPool::index_of(const Buffer& buffer) const {
  const auto& memories = data_->memories();
  const auto at = std::find(memories.begin(), memories.end(), detail::BufferAccess::memory(buffer));
  if (at == memories.end()) return std::nullopt;
  return static_cast<std::size_t>(at - memories.begin());
}

}  // namespace xauto
