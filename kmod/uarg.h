/* SPDX-License-Identifier: GPL-2.0-only */
#ifndef XAUTO_UARG_H
#define XAUTO_UARG_H

#include <linux/types.h>

struct file;
struct xauto_device;

/**
 * xauto_ioctl() - call a driver's ioctl that takes no argument
 * @file: the file, with a reference
 * @cmd: the number
 *
 * May sleep. Return: what the driver answered, or the security module that was asked before. A
 * driver's ENODEV is EIO: here it means that a queue's process is gone.
 */
long xauto_ioctl(struct file *file, unsigned int cmd);

/**
 * xauto_ioctl_arg() - call a driver's ioctl with an argument in kernel memory
 * @device: whose memory for arguments is used; one call at a time
 * @file: the file, with a reference
 * @cmd: the number; its size field says how long @arg is, at most 64 bytes
 * @arg: in, and out where @cmd reads
 * @scratch: where in @arg the driver expects an address that it writes to, or NULL; what it writes,
 *   at most 64 bytes, is dropped
 *
 * May sleep, from any thread, with any mm or none. Return: as xauto_ioctl(); -EINTR when the caller
 * was killed while it waited for its turn.
 */
long xauto_ioctl_arg(struct xauto_device *device, struct file *file, unsigned int cmd, void *arg,
		     u64 *scratch);

int xauto_uarg_init(void);
void xauto_uarg_exit(void);

#endif /* XAUTO_UARG_H */
