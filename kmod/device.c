// SPDX-License-Identifier: GPL-2.0-only
/*
 * Devices, found by their nodes. device.h tells why they are kept apart.
 */
#include <linux/fs.h>
#include <linux/spinlock.h>
#include <linux/workqueue.h>

#include <uapi/xauto/netlink.h>

#include "device.h"

static struct xauto_device xauto_devices[XAUTO_DEVICES];
static DEFINE_SPINLOCK(xauto_devices_lock); /* their nodes */

struct xauto_device *xauto_device_at(unsigned int index)
{
	return &xauto_devices[index];
}

struct xauto_device *xauto_device_of(u32 type, struct file *file)
{
	dev_t node = file_inode(file)->i_rdev;
	unsigned int i;

	if (type == XAUTO_QUEUE_GPU_TSG)
		return &xauto_devices[0];
	spin_lock(&xauto_devices_lock);
	for (i = 1; i < XAUTO_DEVICES - 1; i++)
		if (!xauto_devices[i].node || xauto_devices[i].node == node)
			break;
	xauto_devices[i].node = node;
	spin_unlock(&xauto_devices_lock);
	return &xauto_devices[i];
}

void xauto_device_flush(void)
{
	int i;

	for (i = 0; i < XAUTO_DEVICES; i++)
		flush_workqueue(xauto_devices[i].works);
}

void xauto_device_exit(void)
{
	int i;

	for (i = 0; i < XAUTO_DEVICES; i++)
		if (xauto_devices[i].works)
			destroy_workqueue(xauto_devices[i].works);
}

int xauto_device_init(void)
{
	int i;

	for (i = 0; i < XAUTO_DEVICES; i++) {
		xauto_devices[i].index = i;
		/* Freezable: a driver whose device sleeps is not called. */
		xauto_devices[i].works = alloc_workqueue(
			"xauto/%d", WQ_UNBOUND | WQ_HIGHPRI | WQ_MEM_RECLAIM | WQ_FREEZABLE, 0, i);
		if (!xauto_devices[i].works) {
			xauto_device_exit();
			return -ENOMEM;
		}
	}
	return 0;
}
