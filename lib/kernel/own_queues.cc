// SPDX-License-Identifier: Apache-2.0
#include "kernel/own_queues.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include <sys/ioctl.h>
#include <time.h>
#include <uapi/xauto/nvdla.h>
#include <uapi/xauto/nvgpu.h>

#include "base/clock.h"
#include "base/pi_mutex.h"
#include "base/unique_fd.h"

namespace xauto::kernel {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kDlaAgainNs = 250 * kMs;

/// How TSGs have behaved. nvgpu counts for their whole life, whichever backend has them.
struct Memory {
  PiMutex mutex;
  std::map<std::pair<int, std::string>, Patience> patience XAUTO_GUARDED_BY(mutex);
};

Memory& memory() {
  static Memory memory;
  return memory;
}

Patience patience_with(const QueueFile& file) {
  const Guard lock(memory().mutex);
  const auto it = memory().patience.find({file.fd, file.target});
  return it == memory().patience.end() ? Patience() : it->second;
}

/// 0, or a positive errno. EBADF: it is closed.
template <class Argument>
int call(int file, unsigned long request, Argument* argument) {
  if (file < 0) return EBADF;
  int result;
  do result = ioctl(file, request, argument);
  while (result < 0 && errno == EINTR);
  return result < 0 ? errno : 0;
}
int call(int file, unsigned long request) {
  return call(file, request, static_cast<void*>(nullptr));
}

std::string name_of(const QueueFile& file) {
  return "descriptor " + std::to_string(file.fd) + " (" + file.target + ")";
}

tl::unexpected<Error> failed(const QueueFile& file, const char* what, int error) {
  if (error == EBADF) return fail(ErrorCode::kUnavailable, "is closed", name_of(file));
  return fail(error == ENODEV ? ErrorCode::kUnavailable : ErrorCode::kIo,
              std::string(what) + ": " + std::strerror(error), name_of(file),
              error == ENODEV ? "the driver has lost the device: see the kernel's log" : "");
}

/// Which of the DLA's queues the file has; ENODATA: none.
int ask_slot(int file, std::uint32_t& slot) {
  nvdev_fence fence{};
  nvdla_get_q_status_args args{};
  args.fence = reinterpret_cast<std::uintptr_t>(&fence);
  const int error = call(file, NVDLA_IOCTL_GET_QUEUE_STATUS, &args);
  slot = args.id;
  return error == EINVAL ? ENODATA : error;
}

int set_status(int file, std::uint64_t status) {
  nvdla_set_queue_status_args args{status};
  return call(file, NVDLA_IOCTL_SET_QUEUE_STATUS, &args);
}

/// nvgpu says EBUSY, with an interrupt pending EAGAIN, after 100 ms for each unit that is not left.
int preempt(int fd, const QueueFile& file) {
  const std::int64_t begin = now_ns();
  const int error = call(fd, NVGPU_IOCTL_TSG_PREEMPT);
  const std::int64_t end = now_ns();
  const bool stayed = error == EBUSY || error == EAGAIN;
  const Guard lock(memory().mutex);
  memory().patience[{file.fd, file.target}].waited(begin, end, stayed);
  return stayed ? ETIMEDOUT : error;
}

}  // namespace

/// What was counted of those that are closed by now: a new TSG may have the number and the name.
OwnQueues::OwnQueues() {
  const Guard lock(memory().mutex);
  std::erase_if(memory().patience, [](const auto& entry) {
    return !Duplicate(entry.first.first, entry.first.second);
  });
}

Result<OwnQueues::Handle> OwnQueues::take(const QueueFile& file) {
  for (const auto& [handle, queue] : queues_)
    if (queue.file == file) return handle;
  const Duplicate copy(file.fd, file.target);
  if (file.type == QueueType::kGpuTsg) {
    nvgpu_timeslice_args args{};  // what only a TSG answers, of all that nvgpu has
    if (const int error = call(copy.get(), NVGPU_IOCTL_TSG_GET_TIMESLICE, &args))
      return error == EBADF || error == ENODEV
                 ? failed(file, "GET_TIMESLICE", error)
                 : fail(ErrorCode::kInvalid,
                        std::string("is no TSG of nvgpu's: GET_TIMESLICE: ") + std::strerror(error),
                        name_of(file));
  } else {
    std::uint32_t slot = 0;
    if (const int error = ask_slot(copy.get(), slot))
      return error == ENODATA ? fail(ErrorCode::kInvalid, "the DLA driver's file has no queue",
                                     name_of(file), "allocate it in `init`")
                              : failed(file, "GET_QUEUE_STATUS", error);
    if (const int error = set_status(copy.get(), NVDLA_SET_QUEUE_RESUME))
      return failed(file, "SET_QUEUE_STATUS", error);
  }
  queues_.emplace(++last_, Queue{.file = file});
  return last_;
}

void OwnQueues::give_back(Handle handle) {
  (void)resume(handle);
  queues_.erase(handle);
}

Status OwnQueues::tell_suspend(Queue& queue, bool first) {
  const QueueFile& file = queue.file;
  if (!queue.held) queue.held = Duplicate(file.fd, file.target);
  const int fd = queue.held.get();
  if (file.type == QueueType::kDla) {
    // The driver takes no lock against a release: a command that met another slot is no suspension.
    std::uint32_t before = 0, after = 0;
    int error = ask_slot(fd, before);
    if (!error && !first && before == queue.slot && now_ns() - queue.told_ns < kDlaAgainNs)
      return {};
    if (!error) error = set_status(fd, NVDLA_SET_QUEUE_SUSPEND);
    if (!error) error = ask_slot(fd, after);
    if (!error && before != after) error = ENODATA;
    if (error == ENODATA)
      return fail(ErrorCode::kUnavailable, "its queue was released", name_of(file));
    if (error) return failed(file, "SET_QUEUE_STATUS", error);
    queue.slot = after;
    queue.told_ns = now_ns();
    return {};
  }
  const bool may = patience_with(file).may(now_ns());
  if (first && !may)
    return fail(ErrorCode::kUnavailable,
                "did not leave its engine in time before, so it is not tried", name_of(file));
  if (const int error = call(fd, NVGPU_IOCTL_TSG_DISABLE)) return failed(file, "DISABLE", error);
  const int error = may ? preempt(fd, file) : 0;
  if (error == ETIMEDOUT)
    return fail(ErrorCode::kTimeout, "did not leave its engine in time", name_of(file),
                "split its kernels");
  if (error) return failed(file, "PREEMPT", error);
  return {};
}

Status OwnQueues::tell_resume(Queue& queue) {
  const QueueFile& file = queue.file;
  const bool gpu = file.type == QueueType::kGpuTsg;
  if (!queue.held) queue.held = Duplicate(file.fd, file.target);
  const int fd = queue.held.get();
  const int error = gpu ? call(fd, NVGPU_IOCTL_TSG_ENABLE) : set_status(fd, NVDLA_SET_QUEUE_RESUME);
  std::uint32_t slot = 0;
  const bool none = error == EBADF || (error == EINVAL && !gpu && ask_slot(fd, slot) == ENODATA);
  queue.owed = error != 0 && !none;
  if (!queue.owed) queue.held = {};
  if (queue.owed) return failed(file, gpu ? "ENABLE" : "SET_QUEUE_STATUS", error);
  return {};
}

Status OwnQueues::suspend(Handle handle) {
  Queue& queue = queues_.at(handle);
  Status done = tell_suspend(queue, !queue.suspended);
  if (!done && queue.suspended && done.error().code == ErrorCode::kTimeout)
    done = {};  // it is disabled, and was off
  queue.suspended = done.has_value();
  if (!done) (void)tell_resume(queue);  // half a suspension is none
  return done;
}

Status OwnQueues::resume(Handle handle) {
  Queue& queue = queues_.at(handle);
  queue.suspended = false;
  return tell_resume(queue);
}

void OwnQueues::again() {
  for (auto& [handle, queue] : queues_)
    if (queue.suspended)
      (void)tell_suspend(queue, false);
    else if (queue.owed)
      (void)tell_resume(queue);
}

bool OwnQueues::owes() const {
  return std::any_of(queues_.begin(), queues_.end(),
                     [](const auto& entry) { return entry.second.owed; });
}

bool OwnQueues::gated(Handle handle) const {
  return patience_with(queues_.at(handle).file).gated();
}

OwnQueues::~OwnQueues() {
  for (auto& [handle, queue] : queues_)
    if (queue.suspended) (void)resume(handle);
  for (const std::int64_t until = now_ns() + kLastMs * kMs; owes() && now_ns() < until; again()) {
    const timespec wait{0, 5 * kMs};
    nanosleep(&wait, nullptr);
  }
}

}  // namespace xauto::kernel
