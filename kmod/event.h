/* SPDX-License-Identifier: GPL-2.0-only */
/* Every action is told twice: as a trace event and to the multicast group. netlink.c. */
#ifndef XAUTO_EVENT_H
#define XAUTO_EVENT_H

#include <linux/types.h>

struct pid;
struct xauto_queue;

/*
 * @kind: enum xauto_kevent; a driver's call is told with the queue's lock held; @err: 0 or a
 * negative errno.
 */
void xauto_event(u32 kind, struct xauto_queue *queue, u32 portid, u64 cost_ns, int err);
/* XAUTO_KEV_WATCHDOG, XAUTO_KEV_OWNER_GONE. */
void xauto_owner_event(u32 kind, u32 portid, struct pid *pid);

#endif /* XAUTO_EVENT_H */
