// SPDX-License-Identifier: GPL-2.0-only
/*
 * DLA queues, through nvdla's ioctls. A file is a queue: suspending acts on the queue that was
 * allocated to it.
 */
#include <linux/fs.h>
#include <linux/netlink.h>

#include <uapi/xauto/nvdla.h>

#include "driver.h"
#include "queue.h"
#include "uarg.h"

static char *xauto_dla_drivers = "nvhost_nvdla,nvdla,xauto_nvdla_emu";
module_param_named(dla_drivers, xauto_dla_drivers, charp, 0444);
MODULE_PARM_DESC(
	dla_drivers,
	"modules whose files may be DLA queues (default: nvhost_nvdla,nvdla,xauto_nvdla_emu)");

static int xauto_dla_set_status(struct file *file, u64 status)
{
	struct nvdla_set_queue_status_args args = { .status = status };

	return xauto_ioctl_arg(file, NVDLA_IOCTL_SET_QUEUE_STATUS, &args);
}

/*
 * Only the ctrl node has a firmware version. It has none before the DLA is powered, which
 * suspending needs as well.
 */
static int xauto_dla_verify(struct file *file, struct netlink_ext_ack *extack)
{
	struct nvdla_get_fw_ver_args args = {};

	if (!xauto_file_is_of(file, xauto_dla_drivers)) {
		NL_SET_ERR_MSG(extack,
			       "the file is not of a DLA driver (module parameter dla_drivers)");
		return -EINVAL;
	}
	if (xauto_ioctl_arg(file, NVDLA_IOCTL_GET_FIRMWARE_VERSION, &args)) {
		NL_SET_ERR_MSG(
			extack,
			"the DLA driver's file is not its ctrl node, or its firmware does not answer");
		return -EINVAL;
	}
	return 0;
}

static int xauto_dla_suspend(struct file *file)
{
	return xauto_dla_set_status(file, NVDLA_SET_QUEUE_SUSPEND);
}

static int xauto_dla_resume(struct file *file)
{
	return xauto_dla_set_status(file, NVDLA_SET_QUEUE_RESUME);
}

const struct xauto_queue_ops xauto_dla_ops = {
	.verify = xauto_dla_verify,
	.suspend = xauto_dla_suspend,
	.resume = xauto_dla_resume,
};
