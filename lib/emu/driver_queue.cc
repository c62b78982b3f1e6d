// SPDX-License-Identifier: Apache-2.0
#include "emu/driver_queue.h"

#include <cerrno>
#include <cstring>
#include <string>

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <uapi/xauto/emu.h>
#include <uapi/xauto/nvdla.h>
#include <uapi/xauto/nvgpu.h>
#include <unistd.h>

namespace xauto::emu {
namespace {

constexpr const char* kGpuCtrl = "/dev/nvgpu/igpu0/ctrl";

std::string dla_node(int instance) {
  return "/dev/nvhost-ctrl-nvdla" + std::to_string(instance);
}

tl::unexpected<Error> system_error(const std::string& what, const std::string& where) {
  return fail(errno == EACCES || errno == EPERM ? ErrorCode::kPermission : ErrorCode::kIo,
              what + ": " + std::strerror(errno), where);
}

Result<UniqueFd> open_node(const std::string& path) {
  UniqueFd fd(open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!fd) return system_error("cannot open", path);
  return fd;
}

}  // namespace

Result<DriverQueue> DriverQueue::open_gpu() {
  DriverQueue queue;
  queue.gpu_ = true;
  XAUTO_ASSIGN(const UniqueFd ctrl, open_node(kGpuCtrl));
  nvgpu_gpu_open_tsg_args tsg{};  // r35's is its beginning
  if (ioctl(ctrl.get(), NVGPU_GPU_IOCTL_OPEN_TSG, &tsg) != 0 &&
      (errno != ENOTTY || ioctl(ctrl.get(), NVGPU_GPU_IOCTL_OPEN_TSG_R35, &tsg) != 0))
    return system_error("OPEN_TSG", kGpuCtrl);
  queue.queue_.reset(static_cast<int>(tsg.tsg_fd));
  nvgpu_gpu_open_channel_args channel{};
  channel.in.runlist_id = -1;
  if (ioctl(ctrl.get(), NVGPU_GPU_IOCTL_OPEN_CHANNEL, &channel) != 0)
    return system_error("OPEN_CHANNEL", kGpuCtrl);
  queue.channel_.reset(channel.out.channel_fd);
  int bound = queue.channel_.get();
  if (ioctl(queue.queue_.get(), NVGPU_TSG_IOCTL_BIND_CHANNEL, &bound) != 0)
    return system_error("BIND_CHANNEL", kGpuCtrl);
  return queue;
}

Result<DriverQueue> DriverQueue::open_dla(int instance) {
  DriverQueue queue;
  XAUTO_ASSIGN(queue.queue_, open_node(dla_node(instance)));
  if (ioctl(queue.queue_.get(), NVDLA_IOCTL_ALLOC_QUEUE) != 0)
    return system_error("ALLOC_QUEUE", dla_node(instance));
  return queue;
}

Status DriverQueue::submit(std::chrono::nanoseconds duration) {
  xauto_emu_work work{static_cast<__u64>(duration.count()), 0};
  if (gpu_) {
    if (ioctl(channel_.get(), XAUTO_EMU_IOCTL_SUBMIT, &work) != 0)
      return system_error("cannot submit work", "GPU channel");
    return {};
  }
  nvdla_submit_args args{};
  args.tasks = reinterpret_cast<std::uintptr_t>(&work);
  args.num_tasks = 1;
  args.version = XAUTO_EMU_TASK_VERSION;
  if (ioctl(queue_.get(), NVDLA_IOCTL_EMU_TASK_SUBMIT, &args) != 0)
    return system_error("cannot submit work", "DLA queue");
  return {};
}

Result<bool> DriverQueue::wait(int timeout_ms) {
  pollfd ready{gpu_ ? channel_.get() : queue_.get(), POLLIN, 0};
  int status = 0;
  do {
    status = poll(&ready, 1, timeout_ms);
  } while (status < 0 && errno == EINTR);
  if (status < 0) return system_error("poll", gpu_ ? "GPU channel" : "DLA queue");
  return status > 0;
}

Result<std::uint64_t> DriverQueue::finished() const {
  std::uint64_t count = 0;
  if (read(gpu_ ? channel_.get() : queue_.get(), &count, sizeof count) != sizeof count)
    return system_error("read", gpu_ ? "GPU channel" : "DLA queue");
  return count;
}

}  // namespace xauto::emu
