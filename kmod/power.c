// SPDX-License-Identifier: GPL-2.0-only
/*
 * Power for what is suspended.
 *
 * Both drivers forget a suspension with the power: nvgpu enables every channel when the GPU comes
 * back, and a DLA's firmware starts anew. So the device stays powered while something of it is
 * suspended. No public way leads from an anonymous file to its device, so it is all platform
 * devices of the driver that made the file. A driver that is built in cannot be told from the
 * others; there it is the one whose child the file's node is.
 * (A system sleep asks nobody; queue.c suspends again after it.)
 */
#include <linux/device.h>
#include <linux/fs.h>
#include <linux/platform_device.h>
#include <linux/pm_runtime.h>

#include "compat.h"
#include "power.h"
#include "queue.h"

struct xauto_power_search {
	const struct file *file;
	struct device **devices;
	int found;
};

static int xauto_power_take(struct device *dev, void *data)
{
	struct xauto_power_search *search = data;

	if (search->found < XAUTO_MAX_POWER)
		search->devices[search->found++] = get_device(dev);
	return 0;
}

/* The bus holds the driver meanwhile. A device's own is safe to read under its lock only. */
static int xauto_power_look_at_driver(struct device_driver *driver, void *data)
{
	struct xauto_power_search *search = data;

	if (driver->owner != search->file->f_op->owner)
		return 0;
	return driver_for_each_device(driver, NULL, search, xauto_power_take);
}

static int xauto_power_is_node(struct device *child, XAUTO_CHILD_CONST void *node)
{
	return child->devt == *(const dev_t *)node;
}

static int xauto_power_look_at_device(struct device *dev, void *data)
{
	struct xauto_power_search *search = data;
	dev_t node = file_inode(search->file)->i_rdev;
	struct device *child = device_find_child(dev, &node, xauto_power_is_node);

	if (child)
		xauto_power_take(dev, search);
	put_device(child);
	return 0;
}

void xauto_power_find(const struct file *file, struct device **devices)
{
	struct xauto_power_search search = { .file = file, .devices = devices };

	if (file->f_op->owner)
		bus_for_each_drv(&platform_bus_type, NULL, &search, xauto_power_look_at_driver);
	else if (file_inode(file)->i_rdev)
		bus_for_each_dev(&platform_bus_type, NULL, &search, xauto_power_look_at_device);
}

void xauto_power_forget(struct device **devices)
{
	int i;

	for (i = 0; i < XAUTO_MAX_POWER; i++) {
		put_device(devices[i]);
		devices[i] = NULL;
	}
}

int xauto_power_get(struct device **devices)
{
	int i, err;

	for (i = 0; i < XAUTO_MAX_POWER && devices[i]; i++) {
		err = pm_runtime_get_sync(devices[i]);
		if (err < 0 && err != -EACCES) { /* EACCES: it has no runtime power management */
			pm_runtime_put_noidle(devices[i]);
			while (i-- > 0)
				pm_runtime_put(devices[i]);
			return err;
		}
	}
	return 0;
}

void xauto_power_put(struct device **devices)
{
	int i;

	for (i = 0; i < XAUTO_MAX_POWER && devices[i]; i++)
		pm_runtime_put(devices[i]);
}
