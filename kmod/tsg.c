// SPDX-License-Identifier: GPL-2.0-only
/*
 * GPU TSGs, through nvgpu's ioctls.
 */
#include <linux/fs.h>
#include <linux/netlink.h>

#include <uapi/xauto/nvgpu.h>

#include "device.h"
#include "driver.h"
#include "queue.h"
#include "uarg.h"

static char *xauto_gpu_drivers = "nvgpu,xauto_nvgpu_emu";
module_param_named(gpu_drivers, xauto_gpu_drivers, charp, 0444);
MODULE_PARM_DESC(gpu_drivers, "modules whose files may be TSGs (default: nvgpu,xauto_nvgpu_emu)");

static int xauto_tsg_get_timeslice(struct file *file, u32 *us)
{
	struct nvgpu_timeslice_args args = {};
	long err = xauto_ioctl_arg(xauto_device_of(XAUTO_QUEUE_GPU_TSG, file), file,
				   NVGPU_IOCTL_TSG_GET_TIMESLICE, &args, NULL);

	*us = args.timeslice_us;
	return err;
}

/* An anonymous file named nvgpu-<gpu>-tsg<N>, or a "tsg" node of either hierarchy. */
static bool xauto_tsg_is_named(const struct file *file)
{
	char name[64], *tail;

	xauto_file_name(file, name, sizeof(name));
	if (!strcmp(name, "tsg") || !strcmp(name, "nvhost-tsg-gpu"))
		return true;
	tail = strrchr(name, '-');
	return tail && !strncmp(name, "nvgpu-", 6) && xauto_is_numbered(tail, "-tsg");
}

/*
 * nvgpu's other files (channels, address spaces, ctrl) have another set of operations of the same
 * module. Their ioctls have other numbers, so a question that only a TSG answers tells them apart.
 */
static int xauto_tsg_verify(struct file *file, struct netlink_ext_ack *extack)
{
	u32 us = 0;

	if (!xauto_file_is_of(file, xauto_gpu_drivers)) {
		NL_SET_ERR_MSG(extack,
			       "the file is not of a GPU driver (module parameter gpu_drivers)");
		return -EINVAL;
	}
	if (!xauto_tsg_is_named(file) || xauto_tsg_get_timeslice(file, &us) || !us) {
		NL_SET_ERR_MSG(extack, "the GPU driver's file is not a TSG");
		return -EINVAL;
	}
	return 0;
}

/* It is not scheduled again. What is on the engine stays there until others want it. */
static int xauto_tsg_suspend(struct xauto_queue *queue)
{
	return xauto_ioctl(queue->file, NVGPU_IOCTL_TSG_DISABLE);
}

/* EBUSY, with a pending interrupt EAGAIN: nvgpu has waited 100 ms for each unit, and gave up. */
static int xauto_tsg_preempt(struct xauto_queue *queue)
{
	long err = xauto_ioctl(queue->file, NVGPU_IOCTL_TSG_PREEMPT);

	return err == -EBUSY || err == -EAGAIN ? -ETIMEDOUT : err;
}

static int xauto_tsg_resume(struct xauto_queue *queue)
{
	return xauto_ioctl(queue->file, NVGPU_IOCTL_TSG_ENABLE);
}

static int xauto_tsg_set_timeslice(struct xauto_queue *queue, u32 us)
{
	struct nvgpu_timeslice_args args = { .timeslice_us = us };

	return xauto_ioctl_arg(queue->device, queue->file, NVGPU_IOCTL_TSG_SET_TIMESLICE, &args,
			       NULL);
}

static int xauto_tsg_read_timeslice(struct xauto_queue *queue, u32 *us)
{
	return xauto_tsg_get_timeslice(queue->file, us);
}

static int xauto_tsg_set_interleave(struct xauto_queue *queue, u32 level)
{
	struct nvgpu_runlist_interleave_args args = { .level = level };

	return xauto_ioctl_arg(queue->device, queue->file, NVGPU_IOCTL_TSG_SET_RUNLIST_INTERLEAVE,
			       &args, NULL);
}

const struct xauto_queue_ops xauto_tsg_ops = {
	.verify = xauto_tsg_verify,
	.suspend = xauto_tsg_suspend,
	.preempt = xauto_tsg_preempt,
	.resume = xauto_tsg_resume,
	.set_timeslice = xauto_tsg_set_timeslice,
	.get_timeslice = xauto_tsg_read_timeslice,
	.set_interleave = xauto_tsg_set_interleave,
	.outlives_file = true, /* while a channel is bound to it */
};
