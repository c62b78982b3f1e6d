/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Devices: the GPU, each DLA. A driver may take a second over a call, and its other calls for that
 * device wait behind it. So what calls a driver runs on that device's own work queue, and with its
 * own memory for arguments (uarg.h): no device waits for another's.
 */
#ifndef XAUTO_DEVICE_H
#define XAUTO_DEVICE_H

#include <linux/types.h>

struct file;
struct workqueue_struct;

#define XAUTO_DEVICES 4 /* the GPU, and up to three DLAs; more of them share the last one */

/**
 * struct xauto_device - what driver calls wait for
 * @index: among all, 0..%XAUTO_DEVICES - 1; 0 is the GPU
 * @node: a DLA's device number, 0: not seen yet
 * @works: urgent; what is suspended waits for it
 */
struct xauto_device {
	unsigned int index;
	dev_t node;
	struct workqueue_struct *works;
};

/* @type: enum xauto_queue_type */
struct xauto_device *xauto_device_of(u32 type, struct file *file);
struct xauto_device *xauto_device_at(unsigned int index);

/* Waits for all works of all devices that are queued now. */
void xauto_device_flush(void);
int xauto_device_init(void);
void xauto_device_exit(void);

#endif /* XAUTO_DEVICE_H */
