/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Every difference between kernel versions, and nowhere else. 5.10 is L4T 35's kernel.
 */
#ifndef XAUTO_COMPAT_H
#define XAUTO_COMPAT_H

#include <linux/version.h>

#if LINUX_VERSION_CODE < KERNEL_VERSION(5, 10, 0)
#error "xauto needs Linux 5.10 or later"
#endif

#include <linux/device.h>
#include <linux/fs.h>
#include <linux/hrtimer.h>
#include <linux/kthread.h>
#include <net/genetlink.h>

/* Since 6.1: the number of the first command that checks reserved header bytes. */
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 1, 0)
#define XAUTO_GENL_RESV_START_OP(nr) .resv_start_op = (nr),
#else
#define XAUTO_GENL_RESV_START_OP(nr)
#endif

/*
 * A multicast group can ask for CAP_NET_ADMIN of those who join since 5.12, 5.10.204 too, and by
 * another name since 6.7, some older ones too. Elsewhere there is no group: any user could hear
 * whose queues are suspended when.
 */
#ifdef GENL_MCAST_CAP_NET_ADMIN
#define XAUTO_MCGRP_NEEDS_NET_ADMIN .flags = GENL_MCAST_CAP_NET_ADMIN
#define XAUTO_MCGRP_IS_GUARDED true
#elif LINUX_VERSION_CODE >= KERNEL_VERSION(5, 12, 0) || \
	(LINUX_VERSION_CODE >= KERNEL_VERSION(5, 10, 204) && \
	 LINUX_VERSION_CODE < KERNEL_VERSION(5, 11, 0))
#define XAUTO_MCGRP_NEEDS_NET_ADMIN .flags = GENL_UNS_ADMIN_PERM
#define XAUTO_MCGRP_IS_GUARDED true
#else
#define XAUTO_MCGRP_NEEDS_NET_ADMIN
#define XAUTO_MCGRP_IS_GUARDED false
#endif

/* Since 6.3 a policy's range is const. */
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 3, 0)
#define XAUTO_RANGE_CONST const
#else
#define XAUTO_RANGE_CONST
#endif

/* Since 6.4 a class belongs to no module. */
static inline struct class *xauto_class_create(const char *name)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 4, 0)
	return class_create(name);
#else
	return class_create(THIS_MODULE, name);
#endif
}

/* Since 6.2 the device that devnode() names is const. */
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 2, 0)
#define XAUTO_DEVNODE_CONST const
#else
#define XAUTO_DEVNODE_CONST
#endif

/* Since 6.14 what a child is compared with is const. */
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 14, 0)
#define XAUTO_CHILD_CONST const
#else
#define XAUTO_CHILD_CONST
#endif

/* 6.13 has hrtimer_setup(); 6.15 removed hrtimer_init(). */
static inline void xauto_hrtimer_setup(struct hrtimer *timer,
				       enum hrtimer_restart (*function)(struct hrtimer *),
				       enum hrtimer_mode mode)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 13, 0)
	hrtimer_setup(timer, function, CLOCK_MONOTONIC, mode);
#else
	hrtimer_init(timer, CLOCK_MONOTONIC, mode);
	timer->function = function;
#endif
}

/*
 * Since 6.14 a worker that is only created sleeps uninterruptibly until its first work: after two
 * minutes the kernel says that it hangs, and may panic for that.
 */
#ifdef kthread_run_worker
#define xauto_kthread_run_worker kthread_run_worker
#else
#define xauto_kthread_run_worker kthread_create_worker
#endif

/* Since 6.12 seeking is refused by leaving llseek out. */
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 12, 0)
#define XAUTO_NO_LLSEEK
#else
#define XAUTO_NO_LLSEEK .llseek = no_llseek,
#endif

#endif /* XAUTO_COMPAT_H */
