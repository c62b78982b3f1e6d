// SPDX-License-Identifier: Apache-2.0
// The drivers' ioctls as CUDA and cuDLA call them, without this project's classes: what an app does
// behind XAuto's back.
#pragma once

#include <cerrno>
#include <cstdint>

#include <fcntl.h>
#include <kselftest.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <uapi/xauto/emu.h>
#include <uapi/xauto/nvdla.h>
#include <uapi/xauto/nvgpu.h>
#include <unistd.h>

#include "base/unique_fd.h"

#include "guest.h"

namespace raw {

using xauto::UniqueFd;

/// 0, or the errno.
template <class T>
int call(int fd, unsigned long command, T* argument) {
  return ioctl(fd, command, argument) == 0 ? 0 : errno;
}
inline int call(int fd, unsigned long command) {
  return ioctl(fd, command, 0) == 0 ? 0 : errno;
}

inline UniqueFd node(const char* path) {
  UniqueFd fd(open(path, O_RDWR | O_CLOEXEC));
  if (!fd) ksft_exit_fail_msg("cannot open %s\n", path);
  return fd;
}
inline UniqueFd ctrl() {
  return node("/dev/nvgpu/igpu0/ctrl");
}
inline UniqueFd dla(int instance = 0) {
  return node(instance == 0 ? "/dev/nvhost-ctrl-nvdla0" : "/dev/nvhost-ctrl-nvdla1");
}

inline UniqueFd tsg() {
  nvgpu_gpu_open_tsg_args args{};
  if (call(ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG, &args) != 0 &&
      call(ctrl().get(), NVGPU_GPU_IOCTL_OPEN_TSG_R35, &args) != 0)
    ksft_exit_fail_msg("no TSG\n");
  return UniqueFd(static_cast<int>(args.tsg_fd));
}
/// @runlist 0: graphics and compute, 1: asynchronous copies.
inline UniqueFd channel(int runlist = 0) {
  nvgpu_gpu_open_channel_args args{};
  args.in.runlist_id = runlist;
  if (call(ctrl().get(), NVGPU_GPU_IOCTL_OPEN_CHANNEL, &args) != 0)
    ksft_exit_fail_msg("no channel\n");
  return UniqueFd(args.out.channel_fd);
}
inline int bind(const UniqueFd& tsg, const UniqueFd& channel) {
  int fd = channel.get();
  return call(tsg.get(), NVGPU_TSG_IOCTL_BIND_CHANNEL, &fd);
}
inline int work(const UniqueFd& channel, int ms) {
  xauto_emu_work work{static_cast<__u64>(ms) * 1000000, 0};
  return call(channel.get(), XAUTO_EMU_IOCTL_SUBMIT, &work);
}
inline int task(const UniqueFd& dla, int ms) {
  xauto_emu_work work{static_cast<__u64>(ms) * 1000000, 0};
  nvdla_submit_args args{};
  args.tasks = reinterpret_cast<std::uintptr_t>(&work);
  args.num_tasks = 1;
  args.version = XAUTO_EMU_TASK_VERSION;
  return call(dla.get(), NVDLA_IOCTL_EMU_TASK_SUBMIT, &args);
}
inline int set_status(const UniqueFd& dla, std::uint64_t status) {
  nvdla_set_queue_status_args args{status};
  return call(dla.get(), NVDLA_IOCTL_SET_QUEUE_STATUS, &args);
}
/// The slot, or -errno.
inline int slot(const UniqueFd& dla) {
  nvdev_fence fence{};
  nvdla_get_q_status_args args{0, 0, reinterpret_cast<std::uintptr_t>(&fence)};
  const int error = call(dla.get(), NVDLA_IOCTL_GET_QUEUE_STATUS, &args);
  return error != 0 ? -error : static_cast<int>(args.id);
}
/// All that was submitted has finished, now or within the time.
inline bool idle(const UniqueFd& fd, int timeout_ms = 0) {
  pollfd ready{fd.get(), POLLIN, 0};
  return poll(&ready, 1, timeout_ms) == 1;
}

/// The "sched" node's answer, or the errno as a negative number.
inline int tsgs_of(const UniqueFd& sched, std::uint64_t pid) {
  std::uint64_t ids[64] = {};
  nvgpu_sched_get_tsgs_by_pid_args args{pid, sizeof ids, reinterpret_cast<std::uintptr_t>(ids)};
  const int error = call(sched.get(), NVGPU_SCHED_IOCTL_GET_TSGS_BY_PID, &args);
  int count = 0;
  for (const std::uint64_t word : ids) count += __builtin_popcountll(word);
  return error != 0 ? -error : count;
}
inline UniqueFd sched() {
  return node("/dev/nvgpu/igpu0/sched");
}

inline void gpu_parameter(const std::string& name, const std::string& value) {
  guest::write("/sys/module/xauto_nvgpu_emu/parameters/" + name, value);
}
inline void dla_parameter(const std::string& name, const std::string& value) {
  guest::write("/sys/module/xauto_nvdla_emu/parameters/" + name, value);
}

}  // namespace raw
