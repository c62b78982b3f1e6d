// SPDX-License-Identifier: Apache-2.0
#include "kernel/kfd_queues.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <optional>
#include <string>

#include <sys/syscall.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/unique_fd.h"
#include "kernel/kfd.h"
#include "kernel/watched.h"

namespace xauto::kernel {
namespace {

auto* list_queues() {
  static auto* const list =
      watch_function<decltype(xauto_watched_kfd_queues_1)>("xauto_watched_kfd_queues_1");
  return list;
}

std::vector<xauto_watched_kfd_queue> watched_queues() {
  return all_watched(list_queues());
}

QueueFile file_of(const xauto_watched_kfd_queue& queue) {
  return {queue.fd, QueueType::kKfdQueue, -1,
          "kfd:" + std::to_string(queue.queue) + ":" + std::to_string(queue.made)};
}

std::optional<xauto_watched_kfd_queue> find(const QueueFile& file) {
  for (const xauto_watched_kfd_queue& queue : watched_queues())
    if (file_of(queue) == file) return queue;
  return std::nullopt;
}

/// 0, or a positive errno. Not through libxauto_watch.so: it tells what the process wants.
int update(const xauto_watched_kfd_queue& queue, std::uint32_t percentage) {
  const Duplicate copy(queue.fd, kfd::kNode);
  if (!copy) return EBADF;
  kfd::UpdateQueue args{.ring_address = queue.ring_address,
                        .queue = queue.queue,
                        .ring_size = static_cast<std::uint32_t>(queue.ring_size),
                        .percentage = percentage,
                        .priority = queue.priority};
  long result;
  do result = syscall(SYS_ioctl, copy.get(), kfd::kUpdateQueueCall, &args);
  while (result < 0 && errno == EINTR);
  return result < 0 ? errno : 0;
}

/// amdkfd says EFAULT of a queue that it does not know.
bool is_gone(int error) {
  return error == EBADF || error == EFAULT;
}

/// It waits for the queue to leave, and resets the GPU if it does not.
bool did_stay(int error) {
  return error == ETIME || error == ETIMEDOUT || error == EBUSY || error == EAGAIN;
}

tl::unexpected<Error> failed(const QueueFile& file, int error) {
  if (is_gone(error)) return fail(ErrorCode::kUnavailable, "is gone", file.target);
  if (did_stay(error))
    return fail(ErrorCode::kTimeout, "did not leave its engine in time", file.target,
                "split its kernels");
  const bool lost = error == ENODEV || error == EIO || error == EACCES;  // EACCES: it was reset
  return fail(lost ? ErrorCode::kUnavailable : ErrorCode::kIo,
              std::string("UPDATE_QUEUE: ") + std::strerror(error), file.target,
              lost ? "the GPU was reset or is gone: see the kernel's log" : "");
}

}  // namespace

bool kfd_is_watched() {
  return list_queues() != nullptr;
}

std::vector<QueueFile> find_kfd_queues() {
  std::vector<QueueFile> files;
  for (const xauto_watched_kfd_queue& queue : watched_queues()) files.push_back(file_of(queue));
  return files;
}

Result<KfdQueues::Handle> KfdQueues::take(const QueueFile& file) {
  for (const auto& [handle, known] : queues_)
    if (known.file == file) return handle;
  if (!find(file))
    return fail(ErrorCode::kUnavailable, "is no amdkfd queue of this process", file.target);
  queues_.emplace(++last_, Queue{.file = file});
  return last_;
}

void KfdQueues::give_back(Handle handle) {
  (void)resume(handle);
  queues_.erase(handle);
}

Status KfdQueues::suspend(Handle handle) {
  Queue& queue = queues_.at(handle);
  const std::int64_t begin = now_ns();
  if (!queue.suspended && !queue.patience.may(begin))
    return fail(ErrorCode::kUnavailable,
                "did not leave its engine in time before, so it is not tried", queue.file.target);
  const auto now = find(queue.file);
  const int error = now ? update(*now, 0) : EBADF;
  queue.suspended = error == 0;
  if (error == 0 || did_stay(error)) queue.patience.waited(begin, now_ns(), did_stay(error));
  if (error == 0) {
    queue.updates = now->updates;
    return {};
  }
  (void)resume(handle);
  return failed(queue.file, error);
}

Status KfdQueues::resume(Handle handle) {
  Queue& queue = queues_.at(handle);
  queue.suspended = false;
  const auto now = find(queue.file);
  const int error = now ? update(*now, now->percentage) : EBADF;
  queue.owed = error != 0 && !is_gone(error);
  if (queue.owed) return failed(queue.file, error);
  return {};
}

void KfdQueues::again() {
  for (auto& [handle, queue] : queues_) {
    const auto now = find(queue.file);
    if (queue.suspended && now && now->updates != queue.updates) {
      if (update(*now, 0) == 0) queue.updates = now->updates;
    } else if (queue.owed) {
      (void)resume(handle);
    }
  }
}

bool KfdQueues::owes() const {
  return std::any_of(queues_.begin(), queues_.end(),
                     [](const auto& entry) { return entry.second.owed; });
}

KfdQueues::~KfdQueues() {
  for (const auto& [handle, queue] : queues_)
    if (queue.suspended) (void)resume(handle);
  for (int i = 0; owes() && i < 3; ++i) again();
}

}  // namespace xauto::kernel
