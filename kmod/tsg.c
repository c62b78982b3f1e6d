// SPDX-License-Identifier: GPL-2.0-only
/*
 * GPU TSGs, through nvgpu's ioctls.
 */
#include <linux/dcache.h>
#include <linux/fs.h>
#include <linux/netlink.h>

#include <uapi/xauto/nvgpu.h>

#include "driver.h"
#include "queue.h"
#include "uarg.h"

static char *xauto_gpu_drivers = "nvgpu,xauto_nvgpu_emu";
module_param_named(gpu_drivers, xauto_gpu_drivers, charp, 0444);
MODULE_PARM_DESC(gpu_drivers, "modules whose files may be TSGs (default: nvgpu,xauto_nvgpu_emu)");

static int xauto_tsg_get_timeslice(struct file *file, u32 *us)
{
	struct nvgpu_timeslice_args args = {};
	long err = xauto_ioctl_arg(file, NVGPU_IOCTL_TSG_GET_TIMESLICE, &args);

	*us = args.timeslice_us;
	return err;
}

/*
 * nvgpu's other files (channels, address spaces, ctrl) have another set of operations of the same
 * module. Their ioctls have other numbers, so a question that only a TSG answers tells them apart,
 * whatever the file is called.
 */
static int xauto_tsg_verify(struct file *file, struct netlink_ext_ack *extack)
{
	u32 us = 0;

	if (!xauto_file_is_of(file, xauto_gpu_drivers)) {
		NL_SET_ERR_MSG(extack,
			       "the file is not of a GPU driver (module parameter gpu_drivers)");
		return -EINVAL;
	}
	if (xauto_tsg_get_timeslice(file, &us) || !us) {
		NL_SET_ERR_MSG(extack, "the GPU driver's file is not a TSG");
		return -EINVAL;
	}
	return 0;
}

/* Disabled, it is not scheduled again; preempted, it has left the engine. */
static int xauto_tsg_suspend(struct file *file)
{
	long err = xauto_ioctl(file, NVGPU_IOCTL_TSG_DISABLE);

	return err ? err : xauto_ioctl(file, NVGPU_IOCTL_TSG_PREEMPT);
}

static int xauto_tsg_resume(struct file *file)
{
	return xauto_ioctl(file, NVGPU_IOCTL_TSG_ENABLE);
}

static int xauto_tsg_set_timeslice(struct file *file, u32 us)
{
	struct nvgpu_timeslice_args args = { .timeslice_us = us };

	return xauto_ioctl_arg(file, NVGPU_IOCTL_TSG_SET_TIMESLICE, &args);
}

static int xauto_tsg_set_interleave(struct file *file, u32 level)
{
	struct nvgpu_runlist_interleave_args args = { .level = level };

	return xauto_ioctl_arg(file, NVGPU_IOCTL_TSG_SET_RUNLIST_INTERLEAVE, &args);
}

const struct xauto_queue_ops xauto_tsg_ops = {
	.verify = xauto_tsg_verify,
	.suspend = xauto_tsg_suspend,
	.resume = xauto_tsg_resume,
	.set_timeslice = xauto_tsg_set_timeslice,
	.get_timeslice = xauto_tsg_get_timeslice,
	.set_interleave = xauto_tsg_set_interleave,
};
