/* SPDX-License-Identifier: GPL-2.0-only */
#ifndef XAUTO_UARG_H
#define XAUTO_UARG_H

#include <linux/types.h>

struct file;

/**
 * xauto_ioctl() - call a driver's ioctl that takes no argument
 * @file: the file, with a reference
 * @cmd: the number
 *
 * May sleep. Return: what the driver answered.
 */
long xauto_ioctl(struct file *file, unsigned int cmd);

/**
 * xauto_ioctl_arg() - call a driver's ioctl with an argument in kernel memory
 * @file: the file, with a reference
 * @cmd: the number; its size field says how long @arg is, at most 64 bytes
 * @arg: in, and out where @cmd reads
 *
 * May sleep, from any thread, with any mm or none. Return: what the driver answered.
 */
long xauto_ioctl_arg(struct file *file, unsigned int cmd, void *arg);

int xauto_uarg_init(void);
void xauto_uarg_exit(void);

#endif /* XAUTO_UARG_H */
