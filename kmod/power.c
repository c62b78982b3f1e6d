// SPDX-License-Identifier: GPL-2.0-only
/*
 * Power for what is suspended.
 *
 * A disabled TSG has no work on the engine, so runtime power management may gate the GPU while the
 * TSG's context is off it; boards were wedged that way. From a TSG's file no public way leads to
 * its device, so all platform devices of the driver that made the file (one GPU, two DLAs) stay
 * powered while something of that driver is suspended.
 */
#include <linux/device.h>
#include <linux/platform_device.h>
#include <linux/pm_runtime.h>

#include "power.h"
#include "queue.h"

struct xauto_power_search {
	struct module *driver;
	struct device **devices;
	int found;
};

static int xauto_power_look_at(struct device *dev, void *data)
{
	struct xauto_power_search *search = data;
	struct device_driver *driver = READ_ONCE(dev->driver);

	if (driver && driver->owner == search->driver && search->found < XAUTO_MAX_POWER)
		search->devices[search->found++] = get_device(dev);
	return 0;
}

void xauto_power_find(struct module *driver, struct device **devices)
{
	struct xauto_power_search search = { .driver = driver, .devices = devices };

	if (driver) /* a built-in driver cannot be told from the others */
		bus_for_each_dev(&platform_bus_type, NULL, &search, xauto_power_look_at);
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
