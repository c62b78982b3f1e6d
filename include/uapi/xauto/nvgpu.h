/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * The part of nvgpu's ioctl interface that XAuto wraps, written from its description: numbers and
 * layouts are the driver's. Used by kmod/ (xauto.ko calls these), kmod/emu/ (which answers them)
 * and lib/kernel/ (which recognises the files).
 *
 * A TSG (time slice group) is a file: the "tsg" node opened, or what OPEN_TSG on the "ctrl" node
 * returned, an anonymous inode named nvgpu-<gpu>-tsg<fd>. Holding the file is the right to use it.
 */
#ifndef _UAPI_XAUTO_NVGPU_H
#define _UAPI_XAUTO_NVGPU_H

#include <linux/ioctl.h>
#include <linux/types.h>

#define NVGPU_TSG_IOCTL_MAGIC 'T'
#define NVGPU_GPU_IOCTL_MAGIC 'G'
#define NVGPU_CHANNEL_IOCTL_MAGIC 'H'
#define NVGPU_SCHED_IOCTL_MAGIC 'S'

/* r35's, without what r36 needs to share a TSG: another size, so another number. */
struct nvgpu_gpu_open_tsg_args_r35 {
	__u32 tsg_fd;
	__u32 reserved;
};

/**
 * struct nvgpu_gpu_open_tsg_args - a new TSG (ctrl node), r36
 * @tsg_fd: out: the TSG
 * @flags: bit 0: open one that another process shares; without it the next two are 0
 * @source_device_instance_id: with bit 0: where the token comes from
 * @share_token: with bit 0: the token
 */
struct nvgpu_gpu_open_tsg_args {
	__u32 tsg_fd;
	__u32 flags;
	__u64 source_device_instance_id;
	__u64 share_token;
};

/**
 * struct nvgpu_gpu_open_channel_args - a new channel (ctrl node)
 * @in.runlist_id: in: -1: the graphics engine's, else that of another, e.g. for asynchronous
 *   copies; a TSG has channels of one runlist; out: the channel's file descriptor, in the same
 *   place
 */
struct nvgpu_gpu_open_channel_args {
	union {
		__s32 channel_fd;
		struct {
			__s32 runlist_id;
		} in;
		struct {
			__s32 channel_fd;
		} out;
	};
};

#define NVGPU_GPU_IOCTL_OPEN_TSG_FLAGS_SHARE (1u << 0)

#define NVGPU_GPU_IOCTL_OPEN_TSG_R35 \
	_IOWR(NVGPU_GPU_IOCTL_MAGIC, 9, struct nvgpu_gpu_open_tsg_args_r35)
#define NVGPU_GPU_IOCTL_OPEN_TSG \
	_IOWR(NVGPU_GPU_IOCTL_MAGIC, 9, struct nvgpu_gpu_open_tsg_args)
#define NVGPU_GPU_IOCTL_OPEN_CHANNEL \
	_IOWR(NVGPU_GPU_IOCTL_MAGIC, 11, struct nvgpu_gpu_open_channel_args)

#define NVGPU_RUNLIST_INTERLEAVE_LEVEL_LOW 0
#define NVGPU_RUNLIST_INTERLEAVE_LEVEL_MEDIUM 1
#define NVGPU_RUNLIST_INTERLEAVE_LEVEL_HIGH 2
#define NVGPU_RUNLIST_INTERLEAVE_NUM_LEVELS 3

struct nvgpu_runlist_interleave_args {
	__u32 level;
	__u32 reserved;
};

/* The driver's limits and defaults, microseconds. */
#define NVGPU_TSG_TIMESLICE_MIN_US 1000
#define NVGPU_TSG_TIMESLICE_MAX_US 50000
#define NVGPU_TSG_TIMESLICE_DEFAULT_US 1024

struct nvgpu_timeslice_args {
	__u32 timeslice_us;
	__u32 reserved;
};

/* r36: what another process opens the same TSG with. */
struct nvgpu_tsg_get_share_token_args {
	__u64 source_device_instance_id;
	__u64 target_device_instance_id;
	__u64 share_token;
};

struct nvgpu_preemption_mode_args {
	__u32 graphics_preempt_mode;
	__u32 compute_preempt_mode;
};

/* On a channel. Like all that needs the TSG off for a moment it ends with the TSG enabled. */
#define NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE \
	_IOW(NVGPU_CHANNEL_IOCTL_MAGIC, 122, struct nvgpu_preemption_mode_args)

#define NVGPU_TSG_IOCTL_BIND_CHANNEL _IOW(NVGPU_TSG_IOCTL_MAGIC, 1, int)
#define NVGPU_TSG_IOCTL_UNBIND_CHANNEL _IOW(NVGPU_TSG_IOCTL_MAGIC, 2, int)
#define NVGPU_IOCTL_TSG_ENABLE _IO(NVGPU_TSG_IOCTL_MAGIC, 3)
#define NVGPU_IOCTL_TSG_DISABLE _IO(NVGPU_TSG_IOCTL_MAGIC, 4)
#define NVGPU_IOCTL_TSG_PREEMPT _IO(NVGPU_TSG_IOCTL_MAGIC, 5)
#define NVGPU_IOCTL_TSG_SET_RUNLIST_INTERLEAVE \
	_IOW(NVGPU_TSG_IOCTL_MAGIC, 8, struct nvgpu_runlist_interleave_args)
#define NVGPU_IOCTL_TSG_SET_TIMESLICE \
	_IOW(NVGPU_TSG_IOCTL_MAGIC, 9, struct nvgpu_timeslice_args)
#define NVGPU_IOCTL_TSG_GET_TIMESLICE \
	_IOR(NVGPU_TSG_IOCTL_MAGIC, 10, struct nvgpu_timeslice_args)
#define NVGPU_TSG_IOCTL_GET_SHARE_TOKEN \
	_IOWR(NVGPU_TSG_IOCTL_MAGIC, 20, struct nvgpu_tsg_get_share_token_args)

/*
 * The "sched" node: which TSGs there are. One may have it open at a time (EBUSY).
 *
 * @size: in: of the buffer, bytes; out: of the bitmap, also with ENOSPC: the buffer is too small
 * @buffer: out: bit n: TSG n is there; a TSG is there while it has a file or a bound channel
 */
struct nvgpu_sched_get_tsgs_args {
	__u32 size;
	__u64 buffer;
};

/* @pid: in: of the process that opened the TSGs, as the initial PID namespace knows it */
struct nvgpu_sched_get_tsgs_by_pid_args {
	__u64 pid;
	__u32 size;
	__u64 buffer;
};

#define NVGPU_SCHED_IOCTL_GET_TSGS \
	_IOWR(NVGPU_SCHED_IOCTL_MAGIC, 1, struct nvgpu_sched_get_tsgs_args)
#define NVGPU_SCHED_IOCTL_GET_TSGS_BY_PID \
	_IOWR(NVGPU_SCHED_IOCTL_MAGIC, 3, struct nvgpu_sched_get_tsgs_by_pid_args)

#endif /* _UAPI_XAUTO_NVGPU_H */
