// SPDX-License-Identifier: GPL-2.0-only
/*
 * DLA queues, through nvdla's ioctls. A file is a queue: suspending acts on the queue that is
 * allocated to it at that moment, which its process may release and allocate again. Then it has
 * another slot of the DLA's, and the old one may be another process's.
 */
#include <linux/fs.h>
#include <linux/netlink.h>

#include <uapi/xauto/nvdla.h>

#include "device.h"
#include "driver.h"
#include "queue.h"
#include "uarg.h"

/* "kernel": nvdla is built in on L4T 35. */
static char *xauto_dla_drivers = "nvhost_nvdla,nvdla,kernel,xauto_nvdla_emu";
module_param_named(dla_drivers, xauto_dla_drivers, charp, 0444);
MODULE_PARM_DESC(dla_drivers,
		 "modules whose nodes may be DLA queues (default: nvhost_nvdla,nvdla,kernel,xauto_nvdla_emu)");

/*
 * The slot of the file's queue, without a word to the firmware. -ENODATA: it has none; -EAGAIN: the
 * system sleeps.
 */
static int xauto_dla_ask_slot(struct file *file, u32 *slot)
{
	struct nvdla_get_q_status_args args = {};
	long err = xauto_ioctl_arg(xauto_device_of(XAUTO_QUEUE_DLA, file), file,
				   NVDLA_IOCTL_GET_QUEUE_STATUS, &args, &args.fence);

	*slot = args.id;
	return err == -EINVAL ? -ENODATA : err;
}

static int xauto_dla_verify(struct file *file, struct netlink_ext_ack *extack)
{
	char name[32];
	u32 slot;
	int err;

	xauto_file_name(file, name, sizeof(name));
	if (!xauto_file_is_of(file, xauto_dla_drivers) ||
	    !xauto_is_numbered(name, "nvhost-ctrl-nvdla")) {
		NL_SET_ERR_MSG(extack,
			       "the file is not of a DLA driver (module parameter dla_drivers)");
		return -EINVAL;
	}
	err = xauto_dla_ask_slot(file, &slot);
	if (err == -ENODATA)
		NL_SET_ERR_MSG(extack, "the DLA driver's file has no queue");
	else if (err)
		NL_SET_ERR_MSG(extack, "the DLA driver does not answer");
	return err ? -EINVAL : 0;
}

static int xauto_dla_slot(struct xauto_queue *queue, u32 *slot)
{
	return xauto_dla_ask_slot(queue->file, slot);
}

static int xauto_dla_set_status(struct xauto_queue *queue, u64 status)
{
	struct nvdla_set_queue_status_args args = { .status = status };

	return xauto_ioctl_arg(queue->device, queue->file, NVDLA_IOCTL_SET_QUEUE_STATUS, &args,
			       NULL);
}

/*
 * The driver takes no lock against a release. So the slot is asked for before and after: a command
 * that met another slot than the file's is no suspension.
 */
static int xauto_dla_suspend(struct xauto_queue *queue)
{
	u32 before, after;
	int err = xauto_dla_ask_slot(queue->file, &before);

	if (!err)
		err = xauto_dla_set_status(queue, NVDLA_SET_QUEUE_SUSPEND);
	if (!err)
		err = xauto_dla_ask_slot(queue->file, &after);
	if (!err && before != after)
		err = -ENODATA;
	if (!err)
		queue->slot = after;
	return err;
}

/* A file without a queue has nothing that could be resumed. */
static int xauto_dla_resume(struct xauto_queue *queue)
{
	int err = xauto_dla_set_status(queue, NVDLA_SET_QUEUE_RESUME);
	u32 slot;

	return err == -EINVAL && xauto_dla_ask_slot(queue->file, &slot) == -ENODATA ? 0 : err;
}

const struct xauto_queue_ops xauto_dla_ops = {
	.verify = xauto_dla_verify,
	.slot = xauto_dla_slot,
	.suspend = xauto_dla_suspend,
	.resume = xauto_dla_resume,
};
