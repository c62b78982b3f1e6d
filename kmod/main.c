// SPDX-License-Identifier: GPL-2.0-only
/*
 * xauto.ko: GPU TSGs and DLA queues of user processes, suspended and resumed by their schedulers.
 * Reading order, in which each calls only those after it: this ladder, netlink.c (the door),
 * owner.h and owner.c (who), queue.h and queue.c (what), event.c (what is told of it), tsg.c and
 * dla.c (how), uarg.c, device.c and power.c.
 */
#include <linux/module.h>
#include <net/genetlink.h>

#include "device.h"
#include "netlink.h"
#include "owner.h"
#include "queue.h"
#include "uarg.h"

static int __init xauto_init(void)
{
	int err;

	err = xauto_device_init();
	if (err)
		return err;
	err = xauto_uarg_init();
	if (err)
		goto err_device;
	err = xauto_queue_init();
	if (err)
		goto err_uarg;
	err = xauto_owner_init();
	if (err)
		goto err_queue;
	err = xauto_netlink_init();
	if (err)
		goto err_owner;
	return 0;

err_owner:
	xauto_owner_exit();
err_queue:
	xauto_queue_exit();
err_uarg:
	xauto_uarg_exit();
err_device:
	xauto_device_exit();
	return err;
}

static void __exit xauto_exit(void)
{
	xauto_owner_stop(); /* while listeners can still be told of what is resumed */
	xauto_netlink_exit();
	xauto_owner_exit();
	xauto_queue_exit();
	xauto_uarg_exit();
	xauto_device_exit();
}

module_init(xauto_init);
module_exit(xauto_exit);

MODULE_DESCRIPTION("Suspend and resume GPU TSGs and DLA queues");
MODULE_AUTHOR("The XAuto authors");
MODULE_LICENSE("GPL");
MODULE_ALIAS_GENL_FAMILY("xauto");
