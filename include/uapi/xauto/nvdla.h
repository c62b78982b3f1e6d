/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * The part of nvdla's ioctl interface that XAuto wraps, written from its description: numbers and
 * layouts are the driver's. Used by kmod/, kmod/emu/ and lib/kernel/, as nvgpu.h is.
 *
 * The ctrl node is opened once per process and DLA; a queue is allocated to that file. Suspending
 * acts on the file's queue: the running task completes, none is started. A queue is a slot of a
 * fixed pool: once released, its number may be another process's.
 */
#ifndef _UAPI_XAUTO_NVDLA_H
#define _UAPI_XAUTO_NVDLA_H

#include <linux/ioctl.h>
#include <linux/types.h>

#define NVHOST_NVDLA_IOCTL_MAGIC 'D'

struct nvdla_ping_args {
	__u32 in_challenge;
	__u32 out_response;
};

/**
 * struct nvdla_submit_args - tasks for the file's queue
 * @tasks: address of an array of tasks; what a task is depends on the ioctl
 * @num_tasks: length of the array, 1..%NVDLA_MAX_TASKS_PER_SUBMIT
 * @flags: bit 0: all or none
 * @version: of the task's layout
 */
struct nvdla_submit_args {
	__u64 tasks;
	__u16 num_tasks;
	__u16 flags;
	__u32 version;
};

#define NVDLA_MAX_TASKS_PER_SUBMIT 16

#define NVDLA_SET_QUEUE_SUSPEND (1ull << 0)
#define NVDLA_SET_QUEUE_RESUME (1ull << 1)

/* Exactly one of the two bits: both or neither is EINVAL. */
struct nvdla_set_queue_status_args {
	__u64 status;
};

/**
 * struct nvdla_get_q_status_args - the file's queue; EINVAL where it has none
 * @id: out: its slot
 * @reserved: 0
 * @fence: address of a struct nvdev_fence, which the driver fills
 */
struct nvdla_get_q_status_args {
	__u32 id;
	__u32 reserved;
	__u64 fence;
};

struct nvdev_fence {
	__u32 type;
	__u32 action;
	__u32 syncpoint_index;
	__u32 syncpoint_value;
	__u32 sync_fd;
	__u32 semaphore_handle;
	__u32 semaphore_offset;
	__u32 semaphore_value;
};

/* Answers whether the file has a queue or not. */
struct nvdla_get_fw_ver_args {
	__u32 version;
};

#define NVDLA_IOCTL_PING _IOWR(NVHOST_NVDLA_IOCTL_MAGIC, 1, struct nvdla_ping_args)
#define NVDLA_IOCTL_SUBMIT _IOW(NVHOST_NVDLA_IOCTL_MAGIC, 4, struct nvdla_submit_args)
#define NVDLA_IOCTL_SET_QUEUE_STATUS \
	_IOW(NVHOST_NVDLA_IOCTL_MAGIC, 5, struct nvdla_set_queue_status_args)
#define NVDLA_IOCTL_GET_FIRMWARE_VERSION \
	_IOWR(NVHOST_NVDLA_IOCTL_MAGIC, 6, struct nvdla_get_fw_ver_args)
#define NVDLA_IOCTL_GET_QUEUE_STATUS \
	_IOWR(NVHOST_NVDLA_IOCTL_MAGIC, 7, struct nvdla_get_q_status_args)
#define NVDLA_IOCTL_EMU_TASK_SUBMIT \
	_IOWR(NVHOST_NVDLA_IOCTL_MAGIC, 8, struct nvdla_submit_args)
#define NVDLA_IOCTL_ALLOC_QUEUE _IO(NVHOST_NVDLA_IOCTL_MAGIC, 9)
#define NVDLA_IOCTL_RELEASE_QUEUE _IO(NVHOST_NVDLA_IOCTL_MAGIC, 10)

#endif /* _UAPI_XAUTO_NVDLA_H */
